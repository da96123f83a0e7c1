"""Untrusted bytes are read, and scored, in a process of its own that may do little: `run` is the server's side of it.

It has a session, an empty folder and an environment of its own, no network where the kernel lets it go, and limits to
its processor time, address space, file sizes, open files and processes; it is killed when its time is over or the
server dies. It is given paths on its standard input, and answers with JSON on its standard output. Whatever it says on
its standard error goes to the private log.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from oysterbench_leaderboard.submissions.archive import Limits
from oysterbench_leaderboard.submissions.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import Settings

CHILD = Path(__file__).with_name("child.py")
MOST_ANSWER = 64_000_000
MOST_SAID = 64_000
"""Bytes that are read of an answer, and of what it says to the log."""

LOOK_S = 0.05
ENVIRONMENT = {
    "PATH": "/usr/bin:/bin",
    "LANG": "C.UTF-8",
    **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")},
}


@dataclass(frozen=True)
class Ended:
    """How the process ended. answer: None where it gave none; cause: then, out of a closed list: "time", "memory" or
    "crash"; said: for the private log."""

    answer: dict[str, Any] | None
    cause: str
    said: str


@dataclass(frozen=True)
class Allowance:
    """Of the process."""

    wall_s: float
    cpu_s: int
    memory_bytes: int
    file_bytes: int


class Stopped(Exception):
    """The process was ended because whoever waited for it is to stop."""


def checking(settings: Settings) -> Allowance:
    """For reading what was sent."""
    return Allowance(settings.check_wall_s, settings.check_cpu_s, settings.memory_bytes, settings.file_bytes + 1)


def scoring(settings: Settings) -> Allowance:
    """For scoring it."""
    return Allowance(settings.score_wall_s, settings.score_cpu_s, settings.memory_bytes, settings.file_bytes + 1)


def limits_of(settings: Settings) -> Limits:
    """Of what it reads."""
    keys = ("file_bytes", "results_bytes", "entries", "unpacked_bytes", "ratio")
    return Limits(**{key: getattr(settings, key) for key in keys})


def run(
    job: dict[str, Any],
    allowance: Allowance,
    stop: threading.Event | None = None,
    beat: Callable[[], bool] | None = None,
    beat_s: float = 10.0,
) -> Ended:
    """Do a job in a limited process. stop: ends it, and raises Stopped; beat: called every beat_s seconds, and ends it
    with Stopped where it returns False."""
    with tempfile.TemporaryDirectory(prefix="oysterbench-") as folder:
        process = subprocess.Popen(
            [sys.executable, "-I", str(CHILD), json.dumps(asdict(allowance))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=folder,
            env={**ENVIRONMENT, "HOME": folder, "TMPDIR": folder},
            start_new_session=True,
            close_fds=True,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        answer, said = _Drain(process.stdout, MOST_ANSWER), _Drain(process.stderr, MOST_SAID)
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(job).encode())
                process.stdin.close()
            timed_out = not _wait(process, allowance.wall_s, stop, beat, beat_s)
        finally:
            _kill(process)
            answer.thread.join()
            said.thread.join()
        return _ended(process.returncode, timed_out, answer, said)


def _wait(
    process: subprocess.Popen[bytes],
    wall_s: float,
    stop: threading.Event | None,
    beat: Callable[[], bool] | None,
    beat_s: float,
) -> bool:
    """Whether it has ended within its time."""
    begun = last = time.monotonic()
    while True:
        try:
            process.wait(LOOK_S)
            return True
        except subprocess.TimeoutExpired:
            now = time.monotonic()
        if stop is not None and stop.is_set():
            raise Stopped
        if beat is not None and now - last >= beat_s:
            last = now
            if not beat():
                raise Stopped
        if now - begun > wall_s:
            return False


def _kill(process: subprocess.Popen[bytes]) -> None:
    """It and all that it may have started."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


class _Drain:
    """Reads a pipe to its end, keeping no more than so many bytes."""

    def __init__(self, pipe: IO[bytes], most: int) -> None:
        self.data = bytearray()
        self.whole = True
        self.thread = threading.Thread(target=self._read, args=(pipe, most), daemon=True)
        self.thread.start()

    def _read(self, pipe: IO[bytes], most: int) -> None:
        with pipe:
            while chunk := pipe.read1(1 << 16):  # type: ignore[attr-defined]
                self.whole = self.whole and len(self.data) + len(chunk) <= most
                if self.whole:
                    self.data += chunk


def _ended(code: int, timed_out: bool, answer: _Drain, said: _Drain) -> Ended:
    words = bytes(said.data).decode(errors="replace")
    if timed_out or code == -signal.SIGXCPU:
        return Ended(None, "time", f"ended after its time (exit {code})\n{words}")
    if code == 0 and answer.whole:
        try:
            found = json.loads(bytes(answer.data))
            if isinstance(found, dict):
                return Ended(found, "", words)
        except ValueError:
            pass
    cause = "memory" if "MemoryError" in words or "std::bad_alloc" in words else "crash"
    return Ended(None, cause, f"exit {code}\n{words}")


def check(settings: Settings, path: Path, wanted: dict[str, Any], log: Callable[[str], None]) -> dict[str, Any]:
    """Read what was sent, all of it, with no truth near: what it holds. Raises Refusal with the reason."""
    job = {"do": "check", "path": str(path), "wanted": wanted, "limits": asdict(limits_of(settings))}
    ended = run(job, checking(settings))
    if ended.said:
        log(f"check: {ended.said}")
    if ended.answer is None:
        raise Refusal("limit", CHECK_ENDED[ended.cause])
    if "refused" in ended.answer:
        refused = ended.answer["refused"]
        raise Refusal(refused["kind"], refused["reason"])
    return ended.answer


CHECK_ENDED = {
    "time": "what was sent takes longer to be read than is allowed",
    "memory": "what was sent takes more memory to be read than is allowed",
    "crash": "what was sent cannot be read: its reader gave up on it",
}
"""Why a reader gave no answer."""
