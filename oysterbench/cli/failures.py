"""What the system could not do, in one line: which file, why, and what to do next."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from oysterbench.core.files import home

FULL = (errno.ENOSPC, errno.EDQUOT)
FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


def told(error: OSError) -> str:
    """An error of the system in one line.

    >>> told(OSError(28, "No space left on device", "/mnt/out/a.png"))
    '/mnt/out/a.png: No space left on device; make room there or choose another place, and run the same command again'
    """
    file = error.filename2 or error.filename  # the one that is written, where one is read
    place = f"{os.fsdecode(file)}: " if isinstance(file, str | bytes) else ""
    return f"{place}{error.strerror or error}{_next_step(error.errno, place)}"


def _next_step(number: int | None, place: str) -> str:
    path = Path(place.removesuffix(": "))
    where = "another home folder (OYSTERBENCH_HOME)" if path.is_relative_to(home()) else "another place"
    if number in FULL:
        return f"; make room there or choose {where}, and run the same command again"
    if number in FORBIDDEN and path.is_file() and not os.access(path, os.R_OK):
        return f"; `chmod u+r {path}` lets its owner read it"
    if number in FORBIDDEN and place:
        return f"; choose {where} that you may write to"
    return ""
