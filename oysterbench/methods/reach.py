"""What a method may open beside its input: a closed list, as ground truth may lie anywhere else on a disk."""

from __future__ import annotations

import json
import os
import re
import site
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import distributions
from pathlib import Path
from urllib.parse import unquote, urlsplit

from oysterbench.core.files import models

SETTING = "OYSTERBENCH_ALLOW"
"""Further folders and files, as in PATH."""

SYSTEM = (
    *("/bin", "/dev", "/etc", "/lib", "/lib32", "/lib64", "/opt", "/proc", "/run", "/sbin", "/sys", "/usr"),
    *("/var/cache", "/var/lib", "/gnu", "/nix", "/snap"),
)
"""Where an operating system keeps itself (Filesystem Hierarchy Standard 3.0; Nix, Guix, Snap), and nobody his data."""
PLACES = (
    "PATH",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "CONDA_PREFIX",
    "VIRTUAL_ENV",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
)
"""Variables that name where programs are."""
OF_USER = (".cache", ".config", ".nv", ".ros")
"""Folders in a user's home where programs expect to keep what they make again: compiled kernels, settings, logs."""
WORDS = re.compile(r"[=,\[\]]")
"""Between the words of --config=FILE and of method[weights=FILE]."""


def reach(command: Sequence[str], given: Sequence[str] = ()) -> tuple[str, ...]:
    """Folders and files that a command may open: the system's; those of Python and of installed packages; the working
    folder; the folders of all programs and files that its words name; caches; weights; what OYSTERBENCH_ALLOW names.

    given: what its words name and it may only read. Neither the user's home nor a folder above it is ever among them as
    a whole, unless OYSTERBENCH_ALLOW says so.
    """
    home = os.path.realpath(Path.home())
    found = [*SYSTEM, *_of_python(), *(os.path.join(home, name) for name in OF_USER), str(models()), os.getcwd()]
    for name in PLACES:
        found += [_installed(path) for path in os.environ.get(name, "").split(os.pathsep) if os.path.isabs(path)]
    for word in (part for whole in command for part in [whole, *WORDS.split(whole)] if part):
        if os.path.exists(word) and not any(_holds(one, os.path.realpath(word)) for one in given):
            # A program may be a link, and what belongs to it is beside the one or the other.
            found += [_folder_of(path, home) for path in (os.path.abspath(word), os.path.realpath(word))]
    found += [value for name, value in os.environ.items() if name.startswith("OYSTERBENCH_") and os.path.isfile(value)]
    places = {os.path.realpath(path) for path in found}
    asked = {os.path.realpath(os.path.expanduser(one)) for one in os.environ.get(SETTING, "").split(os.pathsep) if one}
    return tuple(sorted({path for path in places if not _holds(path, home)} | asked))


def _of_python() -> Iterator[str]:
    """Of the interpreter, what it imports, and packages that are installed as links to their sources (PEP 610)."""
    yield from (
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        *map(os.path.abspath, sys.path),
        site.getusersitepackages(),
    )
    yield os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    for distribution in distributions():
        origin = json.loads(distribution.read_text("direct_url.json") or "{}")
        if origin.get("dir_info", {}).get("editable"):
            yield unquote(urlsplit(origin["url"]).path)


def _folder_of(path: str, home: str) -> str:
    """Where what belongs to a file is, or the file alone where that is a whole home; of a folder, itself."""
    if os.path.isdir(path):
        return path
    folder = _installed(os.path.dirname(path))
    return path if _holds(folder, home) else folder


def _installed(folder: str) -> str:
    """Of a folder `bin`, that which has `lib` and `share` too."""
    return os.path.dirname(folder) if os.path.basename(folder) == "bin" else folder


def _holds(folder: str, path: str) -> bool:
    """Whether a folder is that path, or holds it."""
    return os.path.join(path, "").startswith(os.path.join(os.path.realpath(folder), ""))
