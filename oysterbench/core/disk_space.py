"""Disk space: what is free, whether what is being written will fit, and files under a second name without a copy."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from oysterbench.core.errors import MachineError

FIRST = 16
"""Images after which the total size is first predicted; then again whenever their number has doubled."""


def free_bytes(folder: Path) -> int:
    """Free bytes on the disk of a folder, which need not exist yet."""
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    return shutil.disk_usage(there).free


def link(source: str, target: str) -> None:
    """Make a file available under a second name: by a hard link, or by a copy where that is impossible, as between
    disks."""
    try:
        os.link(os.path.realpath(source), target)
    except OSError:
        shutil.copy(source, target)


class SpaceCheck:
    """Whether a folder that is filled image by image fits on its disk: predicted early, so nobody waits for the end.

    folder: where the images are written; shown: the path under which the user knows it
    """

    def __init__(self, folder: Path, shown: Path) -> None:
        self._folder, self._shown, self._next = folder, shown, FIRST

    def check(self, done: int, total: int) -> None:
        """Predict the size of all images from those written so far. Raises MachineError where the rest will not fit.

        done: images written; total: images there will be
        """
        if done < self._next or done >= total:
            return
        self._next = 2 * done
        written = sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())
        self.need(written / done * (total - done), written)

    def need(self, more: float, written: float = 0) -> None:
        """Raise MachineError where `more` bytes do not fit. written: bytes that are there already."""
        free = free_bytes(self._folder)
        if more > free:
            raise MachineError(
                f"{self._shown}: not enough room: this needs some {(written + more) / 1e6:.0f} MB, and "
                f"{(written + free) / 1e6:.0f} MB are free; nothing was left there: make room, or choose another place "
                "with --out"
            )
