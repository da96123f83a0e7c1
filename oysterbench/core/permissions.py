"""Which users may read what is written."""

from __future__ import annotations

import os
from pathlib import Path


def umask() -> int:
    """Permissions that new files do not get. Temporary files do not follow it by themselves."""
    try:
        with open("/proc/self/status") as file:
            return next(int(line.split()[1], 8) for line in file if line.startswith("Umask:"))
    except (OSError, StopIteration):  # not Linux: the only other way changes it for a moment, for all threads
        found = os.umask(0o077)
        os.umask(found)
        return found


def closed_to_others(*paths: Path) -> str:
    """What to tell whoever made a tree for a web server, if other users cannot read these paths of it; else empty."""
    if all(path.stat().st_mode & 0o005 == (0o005 if path.is_dir() else 0o004) for path in paths):
        return ""
    return (
        f"{paths[0]}: other users cannot read all of it (umask {umask():03o}), a web server of another user neither: "
        f"`chmod -R a+rX {paths[0]}`"
    )
