"""Errors of the operating system in one line: which file, why, and what to do next."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from oysterbench.core.places import home, home_problem

FULL = (errno.ENOSPC, errno.EDQUOT)
NO_FOLDER = (errno.EEXIST, errno.ENOTDIR, errno.ENOENT)
FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


def told(error: OSError) -> str:
    """Describe an error of the operating system in one line.

    >>> told(OSError(28, "No space left on device", "/mnt/out/a.png"))
    '/mnt/out/a.png: No space left on device; make room there or choose another place, and run the same command again'
    """
    file = error.filename2 or error.filename  # with two files, the one being written
    path = Path(os.fsdecode(file)) if isinstance(file, str | bytes) else None
    place = "" if path is None else f"{path}: "
    return f"{place}{error.strerror or error}{_next_step(error.errno, path)}"


def _next_step(number: int | None, path: Path | None) -> str:
    at_home = path is not None and path.is_relative_to(home())
    where = "another home folder (OYSTERBENCH_HOME)" if at_home else "another place"
    if at_home and number in NO_FOLDER and (problem := home_problem()):
        return f"; {problem}: let OYSTERBENCH_HOME name a folder"
    if number in FULL:
        return f"; make room there or choose {where}, and run the same command again"
    if number not in FORBIDDEN or path is None:
        return ""
    if path.is_file() and not os.access(path, os.R_OK):
        if path.stat().st_uid != os.geteuid():
            return "; it belongs to another user: run the same command as that user"
        return f"; `chmod u+r {path}` lets its owner read it"
    return f"; choose {where} that you may write to"
