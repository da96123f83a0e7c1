"""Cache of exported sequences, shared by all runs and all result folders: each export is made once, completely, and is
read-only from then on.

KEY/NAME:      an export, by the name of its sequence
KEY/made.json: digest and size of its files as they were made; its modification time is that of the last use
locks/KEY:     lock, exclusive for whoever makes or deletes an export, shared for those who use it

Only its owner can open the folder. All of it can be deleted while nothing is running.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError
from oysterbench.methods.interfaces import RunSequence
from oysterbench.version import VERSION

SETTING = "OYSTERBENCH_EXPORTS_GB"
MOST_GB = 20.0
"""Default limit on the total size of all exports, GB; 0 keeps none."""
MOST_DAYS, MOST_DAYS_REPLACED = 30.0, 1.0
"""Days that an export is kept after its last use, and one that has been replaced by an export of other code."""
MADE = "made.json"
LOOK_S = 0.2

Look = Callable[[], None]
"""Called repeatedly while waiting for a lock; raises to stop the wait."""


class Exports:
    """A folder of exports. most_bytes: limit on their total size; exports in use are kept even beyond it."""

    def __init__(self, folder: Path, most_bytes: float | None = None) -> None:
        self.folder, self.most_bytes = folder, most_gigabytes() * 1e9 if most_bytes is None else most_bytes

    @contextmanager
    def hold(self, key: str, make: Callable[[Path], None], look: Look = lambda: None) -> Iterator[Path]:
        """Yield the folder of an export, which stays unchanged until the block ends. make: fills it if it is absent."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with self._lock_file(key) as lock:
            _wait(lock, fcntl.LOCK_SH, look)
            while not self._is_whole(key):
                _wait(lock, fcntl.LOCK_EX, look)
                if not self._is_whole(key):
                    self._make(key, make)
                _wait(lock, fcntl.LOCK_SH, look)
            os.utime(self.folder / key / MADE)
            yield self.folder / key

    def tidy(self) -> None:
        """Delete exports unused for too long, then the least recently used ones while the total exceeds the limit."""
        uses = sorted((_used(path), path.parent.name) for path in self.folder.glob(f"*/{MADE}"))
        sizes = {key: int(_made(self.folder / key / MADE)["bytes"]) for _, key in uses}
        latest = {key.rpartition("-")[0]: key for _, key in uses}
        for used, key in uses:
            days = MOST_DAYS if latest[key.rpartition("-")[0]] == key else MOST_DAYS_REPLACED
            too_old = used < time.time() - days * 86400
            if (too_old or sum(sizes.values()) > self.most_bytes) and self._take_away(key):
                del sizes[key]
        for half in self.folder.glob(".*"):  # left by a process that was killed, unless it is being made right now
            self._take_away(half.name.removeprefix("."))

    def _make(self, key: str, make: Callable[[Path], None]) -> None:
        half = self.folder / f".{key}"
        for folder in (half, self.folder / key):
            shutil.rmtree(folder, ignore_errors=True)
        half.mkdir()
        try:
            make(half)
            write_atomically(half / MADE, json.dumps(_state(half)).encode())
            half.rename(self.folder / key)
        except BaseException:
            shutil.rmtree(half, ignore_errors=True)
            raise

    def _is_whole(self, key: str) -> bool:
        """Whether an export is there and unchanged: one that anybody has changed is made again."""
        folder = self.folder / key
        return (folder / MADE).is_file() and _made(folder / MADE) == _state(folder)

    def _take_away(self, key: str) -> bool:
        """Delete an export unless it is in use. Returns whether it was deleted."""
        with self._lock_file(key) as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
            for folder in (self.folder / f".{key}", self.folder / key):
                shutil.rmtree(folder, ignore_errors=True)
            return True

    def _lock_file(self, key: str) -> IO[bytes]:
        path = self.folder / "locks" / key
        path.parent.mkdir(exist_ok=True)
        return open(path, "wb")


def most_gigabytes() -> float:
    """Read the size limit, GB, from the environment. Raises MethodError where it is not a number."""
    text = os.environ.get(SETTING) or str(MOST_GB)
    try:
        return max(0.0, float(text))
    except ValueError:
        raise MethodError(f"{SETTING}: expected the maximum size of exports in GB, got {text!r}") from None


def key_of(sequence: RunSequence, form: str) -> str:
    """Key of an export, which depends on the sequence, its files as they are now and the form; the part after the last
    dash depends on the code that writes it."""
    states = [path.stat() for path in sequence.hidden if path.is_file()]
    files = [(state.st_size, state.st_mtime_ns) for state in states]
    made_of = json.dumps([sequence.origin, form, files])
    return f"{sequence.name}-{form}-{hashlib.sha256(made_of.encode()).hexdigest()[:12]}-{_code()[:8]}"


@cache
def _code() -> str:
    """SHA-256 of the code that writes exports."""
    here = Path(__file__).parent
    found = hashlib.sha256(VERSION.encode())
    for path in sorted([*(here / "interfaces").glob("*.py"), *(here.parent / "sequence" / "export").glob("*.py")]):
        found.update(path.read_bytes())
    return found.hexdigest()


def _state(folder: Path) -> dict[str, Any]:
    """Digest of the names, sizes and modification times of all files of a folder, and their total size in bytes."""
    found, total = hashlib.sha256(), 0
    for path in sorted(path for path in folder.rglob("*") if path.name != MADE and path.is_file()):
        state = path.stat()
        found.update(
            f"{path.relative_to(folder)}\0{state.st_size}\0{state.st_mtime_ns}\n".encode(errors="surrogateescape")
        )
        total += state.st_size
    return {"files": found.hexdigest(), "bytes": total}


def _made(path: Path) -> dict[str, Any]:
    try:
        held: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # deleted in the meantime, or corrupt
        return {"bytes": 0}
    return held


def _used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:  # deleted in the meantime
        return 0.0


def _wait(lock: IO[bytes], kind: int, look: Look) -> None:
    while True:
        try:
            fcntl.flock(lock, kind | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            look()
            time.sleep(LOOK_S)
