"""A file that is not complete yet: it grows as a sparse `.part` next to its final name.

The part is its own journal: what is right is determined by hashing the pieces that are not holes, so nothing can get
out of step with it. Only pieces with the right hash are written to it, so that two processes that write the same part
write the same bytes; pieces in progress are next to it (`draft`), to be resumed after a kill.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from pathlib import Path

from oysterbench.hub.canonical import sha256
from oysterbench.hub.draft import remove_drafts, write_all
from oysterbench.hub.pieces import Pieced


class Part:
    """A file that is not complete yet."""

    def __init__(self, path: Path, entry: Pieced) -> None:
        self.path, self.entry = path, entry
        self._writing = threading.Lock()  # the system allows only one write at a time anyway, and waits less well
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        if os.fstat(self._file).st_size != entry.size:
            os.ftruncate(self._file, entry.size)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def duplicate(self) -> int:
        """Return a separate descriptor to write through, so that a `close` elsewhere cannot make it another file's."""
        return os.dup(self._file)

    def write(self, piece: int, data: memoryview, descriptor: int) -> None:
        """Write a verified piece. It may be written twice at once, with the same bytes."""
        with self._writing:
            write_all(descriptor, data, self.entry.span(piece)[0])

    def is_right(self, piece: int) -> bool:
        """Whether a piece is there with the right hash."""
        start, end = self.entry.span(piece)
        if self._is_hole(start, end):
            return False
        return sha256(os.pread(self._file, end - start, start)) == self.entry.pieces[piece]

    def _is_hole(self, start: int, end: int) -> bool:
        try:
            return os.lseek(self._file, start, os.SEEK_DATA) >= end
        except OSError as error:
            return error.errno == errno.ENXIO  # only a hole from here on; after other errors, it is unknown

    def install(self, target: Path) -> None:
        """Move the complete file to its final name, atomically and durably."""
        os.fsync(self._file)
        try:
            os.replace(self.path, target)
        except FileNotFoundError:  # another process was faster, with the same bytes
            if not (target.is_file() and target.stat().st_size == self.entry.size):
                raise
        remove_drafts(self.path)
        with contextlib.suppress(OSError):  # not every file system supports it
            folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
