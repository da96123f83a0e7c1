"""Server side of the sandbox (`oysterbench.methods.sandbox`) in which untrusted bytes are read and scored; see `run`.

The process has its own session, empty folder and environment, no network where the kernel permits that, no access to
the server's files except those named in its job, and limits on processor time, address space, file sizes, open files
and processes; it is killed when its time is up or the server dies. It receives a Job on its standard input, and answers
with JSON on its standard output. Its standard error goes to the private log.

Where bubblewrap is installed and permitted, all of this happens in separate namespaces (`namespaces`), and readers of
uploads are forked there instead of started (`fork_server`).
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import msgspec

from oysterbench.methods.sandbox import Sandbox, can_hide
from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.reading.archive import Limits
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.sandbox import namespaces
from oysterbench_leaderboard.submissions.sandbox.fork_server import UPLOAD, ForkServer
from oysterbench_leaderboard.submissions.settings import SubmissionSettings

WORKER = Path(__file__).with_name("sandbox_worker.py")
OPEN_FILES = 64
MOST_STDERR = 64_000
"""Maximum number of bytes of standard error that go to the log."""

OUT_OF_TIME = (-signal.SIGXCPU, 128 + signal.SIGXCPU)
"""Exit codes of a process that has used up its time, and of the process that waits for it in namespaces."""

POLL_S = 0.05
ENVIRONMENT = {
    "PATH": "/usr/bin:/bin",
    "LANG": "C.UTF-8",
    **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")},
}


@dataclass(frozen=True)
class Job:
    """What to do with an upload: read and check it, or score it where there is ground truth (sequence -> file).

    hidden: folders of the server that the process cannot open, except for `path` and `truth` in them
    created: when the submission was made, UTC
    """

    path: str
    wanted: Wanted
    limits: Limits
    hidden: tuple[str, ...] = ()
    truth: Mapping[str, str] | None = None
    method: str = ""
    created: str = ""


@dataclass(frozen=True)
class Ended:
    """How the process ended. answer: None where it gave none; cause: in that case one of "time", "memory" and "crash";
    stderr: for the private log."""

    answer: dict[str, Any] | None
    cause: str
    stderr: str


@dataclass(frozen=True)
class Allowance:
    """Limits of the process: wall-clock and processor time in s, address space and size of a file in bytes."""

    wall_s: float
    cpu_s: int
    memory_bytes: int
    file_bytes: int


class Stopped(Exception):
    """Raised where the process was killed because its caller is to stop."""


def checking(settings: SubmissionSettings) -> Allowance:
    """Allowance for reading an upload."""
    return Allowance(settings.check_wall_s, settings.check_cpu_s, settings.check_memory_bytes, settings.file_bytes + 1)


def scoring(settings: SubmissionSettings) -> Allowance:
    """Allowance for scoring an upload."""
    return Allowance(settings.score_wall_s, settings.score_cpu_s, settings.memory_bytes, settings.file_bytes + 1)


def never() -> bool:
    """Never stop a job: the default `stopped` of `run`."""
    return False


def run(
    job: Job,
    allowance: Allowance,
    stopped: Callable[[], bool] = never,
    forks: ForkServer | None = None,
) -> Ended:
    """Run a job in a sandbox. stopped: polled many times a second; where it returns True, raises Stopped.

    forks: fork server from which the process is forked where namespaces are available; such a process is never stopped,
    and raises OSError where it cannot be forked
    """
    namespaced = not namespaces.missing()
    with (
        tempfile.TemporaryDirectory(prefix="oysterbench-") as folder,
        tempfile.TemporaryFile() as asked,
        tempfile.TemporaryFile() as answer,
        tempfile.TemporaryFile() as stderr,
    ):
        home = namespaces.FOLDER if namespaced else folder
        sandbox = Sandbox(
            hidden=job.hidden,
            visible=(job.path, *(job.truth or {}).values()),
            writable=(home, *namespaces.DEVICES),
            network=False,
            memory_bytes=allowance.memory_bytes,
            file_bytes=allowance.file_bytes,
            open_files=OPEN_FILES,
            cpu_s=allowance.cpu_s,
        )
        forked = forks if namespaced else None
        asked.write(msgspec.json.encode(replace(job, path=UPLOAD) if forked else job))
        asked.seek(0)
        if forked:
            code = forked.run(replace(sandbox, visible=()), job.path, (asked, answer, stderr), allowance.wall_s)
            return _ended(code, answer, stderr)
        command = sandbox.command([sys.executable, "-IB", str(WORKER)])
        if namespaced:
            command = namespaces.inside(command, (str(WORKER), *sandbox.visible), 2 * allowance.file_bytes)
        process = subprocess.Popen(
            command,
            stdin=asked,
            stdout=answer,
            stderr=stderr,
            cwd=folder,
            env={**ENVIRONMENT, "HOME": home, "TMPDIR": home},
            start_new_session=True,
        )
        try:
            in_time = _wait(process, allowance.wall_s, stopped)
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        return _ended(process.returncode if in_time else None, answer, stderr)


def fork_server() -> ForkServer:
    """Fork server for reader processes, not started yet."""
    return ForkServer(WORKER, {**ENVIRONMENT, "HOME": namespaces.FOLDER, "TMPDIR": namespaces.FOLDER})


def in_force() -> str:
    """Describe the sandbox available on this machine, in one line."""
    why = namespaces.missing()
    if not why:
        return "separate namespaces (bubblewrap), Landlock and limits"
    hides = "Landlock and limits" if can_hide() else "limits only: the kernel has no Landlock"
    return f"{hides}; no namespaces: {why}"


def _wait(process: subprocess.Popen[bytes], wall_s: float, stopped: Callable[[], bool]) -> bool:
    """Wait for a process; return whether it ended within `wall_s`. Raises Stopped."""
    begun = time.monotonic()
    while time.monotonic() - begun <= wall_s:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(POLL_S)
            return True
        if stopped():
            raise Stopped
    return False


def _ended(code: int | None, answer: IO[bytes], stderr: IO[bytes]) -> Ended:
    """Outcome of a process. code: its exit code; None where its time was up."""
    stderr.seek(0)
    words = stderr.read(MOST_STDERR).decode(errors="replace")
    if code is None or code in OUT_OF_TIME:
        return Ended(None, "time", f"ended after its time (exit {code})\n{words}")
    if code == 0:
        answer.seek(0)
        with contextlib.suppress(ValueError):
            found = json.load(answer)
            if isinstance(found, dict):
                return Ended(found, "", words)
    cause = "memory" if "MemoryError" in words or "std::bad_alloc" in words else "crash"
    return Ended(None, cause, f"exit {code}\n{words}")


CHECK_ENDED = {
    "time": "reading the upload exceeded the time limit",
    "memory": "reading the upload exceeded the memory limit",
    "crash": "the upload cannot be read",
}
"""Cause -> message where a reader gave no answer."""


def check(
    settings: SubmissionSettings,
    path: Path,
    wanted: Wanted,
    hidden: Iterable[str],
    log: Callable[[str], None],
    forks: ForkServer | None = None,
) -> dict[str, Any]:
    """Read all of an upload in a sandbox, without access to ground truth; return what it holds. Raises Refusal with the
    reason.

    hidden: folders that the process cannot open; log: receives messages for the private log
    """
    job = Job(str(path), wanted, settings.limits, tuple(hidden))
    try:
        ended = run(job, checking(settings), never, forks)
    except OSError as error:
        log(f"check: in a process of its own: {error}")
        ended = run(job, checking(settings))
    if ended.stderr:
        log(f"check: {ended.stderr}")
    if ended.answer is None:
        raise Refusal("limit", CHECK_ENDED[ended.cause])
    if "refused" in ended.answer:
        raise Refusal(**ended.answer["refused"])
    return ended.answer
