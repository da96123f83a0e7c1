"""Whether what is being written will fit on its disk: told from the first of it, so that nobody waits for the last."""

from __future__ import annotations

from pathlib import Path

from oysterbench.core.errors import MachineError
from oysterbench.core.files import free_bytes

FIRST = 16
"""Pictures from which the size of all is told for the first time; then whenever there are twice as many."""


class Room:
    """Of a folder that is filled picture by picture.

    folder: where it is filled; shown: the name that its user knows it by
    """

    def __init__(self, folder: Path, shown: Path) -> None:
        self._folder, self._shown, self._next = folder, shown, FIRST

    def check(self, done: int, total: int) -> None:
        """To be called with the pictures that are written, and those there will be. Raises MachineError where the rest
        will not fit, if it is like what is there."""
        if done < self._next or done >= total:
            return
        self._next = 2 * done
        written = sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())
        self.need(written / done * (total - done), written)

    def need(self, more: float, written: float = 0) -> None:
        """Raise MachineError where so many bytes more do not fit. written: bytes that are there already."""
        free = free_bytes(self._folder)
        if more > free:
            raise MachineError(
                f"{self._shown}: not enough room: this needs some {(written + more) / 1e6:.0f} MB, and "
                f"{(written + free) / 1e6:.0f} MB are free; nothing was left there: make room, or choose another place "
                "with --out"
            )
