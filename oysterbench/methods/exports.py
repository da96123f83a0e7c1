"""What programs are given of sequences, kept for all runs and all folders of results: each made once, whole, and read
only from then on.

KEY/NAME:      an export, by the name of its sequence
KEY/made.json: its files and bytes as they were made; changed since it was last used
locks/KEY:     held by who makes an export or takes it away, and shared by those who use it

Only its user can open the folder. All of it can be deleted while nothing is run.
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

from oysterbench.core.errors import MethodError
from oysterbench.core.files import write_atomically
from oysterbench.methods.interfaces import RunSequence
from oysterbench.version import VERSION

SETTING = "OYSTERBENCH_EXPORTS_GB"
MOST_GB = 20.0
"""Of all exports that are kept, where the setting says nothing; 0 keeps none."""
MOST_DAYS, MOST_DAYS_REPLACED = 30.0, 1.0
"""That an export is kept since it was last used, and one that other code has written anew."""
MADE = "made.json"
LOOK_S = 0.2

Look = Callable[[], None]
"""Called while a lock is waited for; raises where that is not wanted any more."""


class Exports:
    """A folder of them. most_bytes: of all together, as long as there are some that nobody uses."""

    def __init__(self, folder: Path, most_bytes: float | None = None) -> None:
        self.folder, self.most_bytes = folder, most_gigabytes() * 1e9 if most_bytes is None else most_bytes

    @contextmanager
    def hold(self, key: str, make: Callable[[Path], None], look: Look = lambda: None) -> Iterator[Path]:
        """The folder of an export, which stays as it is until the block ends. make: fills it where it is not there."""
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
        """Take away what has not been used for long, then the longest unused as long as all are too large."""
        uses = sorted((_used(path), path.parent.name) for path in self.folder.glob(f"*/{MADE}"))
        sizes = {key: int(_made(self.folder / key / MADE)["bytes"]) for _, key in uses}
        latest = {key.rpartition("-")[0]: key for _, key in uses}
        for used, key in uses:
            days = MOST_DAYS if latest[key.rpartition("-")[0]] == key else MOST_DAYS_REPLACED
            too_old = used < time.time() - days * 86400
            if (too_old or sum(sizes.values()) > self.most_bytes) and self._take_away(key):
                del sizes[key]
        for half in self.folder.glob(".*"):  # of a process that was killed, if nobody makes it now
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
        """Whether it is there as it was made: what was changed since, by whoever it was, is made anew."""
        folder = self.folder / key
        return (folder / MADE).is_file() and _made(folder / MADE) == _state(folder)

    def _take_away(self, key: str) -> bool:
        """If nobody uses it; whether that is so."""
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
    """As it is set. Raises MethodError for what is no number."""
    text = os.environ.get(SETTING) or str(MOST_GB)
    try:
        return max(0.0, float(text))
    except ValueError:
        raise MethodError(f"{SETTING}: expected the maximum size of exports in GB, got {text!r}") from None


def key_of(sequence: RunSequence, form: str) -> str:
    """Equal for exports with the same content: of one sequence and its files as they are, in one form; after the last
    dash, by one code."""
    states = [path.stat() for path in sequence.hidden if path.is_file()]
    files = [(state.st_size, state.st_mtime_ns) for state in states]
    made_of = json.dumps([sequence.origin, form, files])
    return f"{sequence.name}-{form}-{hashlib.sha256(made_of.encode()).hexdigest()[:12]}-{_code()[:8]}"


@cache
def _code() -> str:
    """SHA-256 of what writes exports."""
    here = Path(__file__).parent
    found = hashlib.sha256(VERSION.encode())
    for path in sorted([*(here / "interfaces").glob("*.py"), *(here.parent / "sequence" / "export").glob("*.py")]):
        found.update(path.read_bytes())
    return found.hexdigest()


def _state(folder: Path) -> dict[str, Any]:
    """Of all files of a folder: a digest of names, sizes and times, and their bytes."""
    found, total = hashlib.sha256(), 0
    for path in sorted(path for path in folder.rglob("*") if path.name != MADE and path.is_file()):
        state = path.stat()
        found.update(f"{path.relative_to(folder)}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
        total += state.st_size
    return {"files": found.hexdigest(), "bytes": total}


def _made(path: Path) -> dict[str, Any]:
    try:
        held: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # deleted meanwhile, or spoilt
        return {"bytes": 0}
    return held


def _used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:  # deleted meanwhile
        return 0.0


def _wait(lock: IO[bytes], kind: int, look: Look) -> None:
    while True:
        try:
            fcntl.flock(lock, kind | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            look()
            time.sleep(LOOK_S)
