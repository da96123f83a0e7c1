"""Commands in their own processes: time-limited, measured, and ended together with everything that they started."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MachineError
from oysterbench.core.files import MODELS, free_bytes, models
from oysterbench.methods.sandbox import Sandbox, can_hide

SUPERVISOR = Path(__file__).with_name("supervise.py")
STDOUT, STDERR, REPORT = "stdout.txt", "stderr.txt", "process.json"
LEAST_FREE = 1 << 20
"""Free space, bytes, below which any failure is put down to a full disk."""
KILLED_STATUS = 128 + signal.SIGKILL
"""Exit status by which a shell reports that its command was killed by SIGKILL."""
WEIGHTS = ".pt"
"""File suffix of trained weights."""
TAIL_BYTES, TAIL_LINES, TAIL_CHARACTERS = 8192, 10, 2000


@dataclass(frozen=True)
class Ended:
    """How a command ended: what it cost (see `supervise`), and why it failed.

    failure: None if it ended with status 0; killed: whether it was killed from outside, neither by itself nor at its
    time limit
    """

    wall_s: float
    cpu_s: float
    peak_bytes: int
    left_behind: int
    failure: str | None
    killed: bool = False


class Stopped(Exception):
    """The command was ended because `Processes.stop` ended all of them."""


class Processes:
    """Starts commands from any number of threads, and ends all of them at once."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def run(
        self,
        command: Sequence[str],
        limit_s: float,
        folder: Path,
        hidden: Iterable[Path] = (),
        visible: Iterable[Path] = (),
    ) -> Ended:
        """Run a command to its end; its output goes to stdout.txt and stderr.txt in a folder.

        hidden: paths that it cannot open, if the kernel can hide them (`sandbox`); its environment does not reveal them
        either. visible: paths inside these that it can read but not write.
        Raises MachineError where it was killed from outside, by the kernel for lack of memory or by a person, and
        Stopped once `stop` was called.
        """
        report = folder / REPORT
        report.unlink(missing_ok=True)
        supervised = supervised_command(command, limit_s, report, hidden, visible)
        with open(folder / STDOUT, "wb") as out, open(folder / STDERR, "wb") as err:
            with self._lock:
                if self._stopped:
                    raise Stopped
                # In its own session: only `stop` handles Ctrl-C on the terminal.
                process = subprocess.Popen(
                    supervised,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    start_new_session=True,
                    env=environment() if hidden else None,
                )
                self._running.add(process)
            try:
                process.wait()
            finally:
                with self._lock:
                    self._running.discard(process)
        self.raise_if_stopped()
        if not report.is_file():
            raise MachineError(
                f"the supervisor of {command[0]} was killed: {tail(folder / STDERR) or 'no word from it'}"
            )
        ended = _ended(json.loads(report.read_text(encoding="utf-8")), limit_s, folder)
        if ended.killed:
            raise MachineError(ended.failure)
        return ended

    def raise_if_stopped(self) -> None:
        """Raise Stopped once `stop` was called."""
        if self._stopped:
            raise Stopped

    def stop(self) -> None:
        """End all commands, and let no more start."""
        with self._lock:
            self._stopped = True
            for process in self._running:
                process.terminate()


def supervised_command(
    command: Sequence[str], limit_s: float, report: Path, hidden: Iterable[Path], visible: Iterable[Path] = ()
) -> list[str]:
    """Command line that runs a command under the supervisor, unable to open what is hidden and not visible."""
    places = [os.path.realpath(path) for path in hidden if path.exists()]
    if places and can_hide():
        names = {os.path.realpath(path or os.curdir) for path in [os.curdir, *sys.path]}
        shown = tuple(os.path.realpath(path) for path in visible)
        command = Sandbox(hidden=tuple(places), visible=shown, listed=tuple(sorted(names))).command(command)
    return [sys.executable, "-I", "-S", str(SUPERVISOR), repr(float(limit_s)), str(report), *command]


def environment() -> dict[str, str]:
    """Environment of a method's process: this one's, without the variables that say where data is kept, and the salts.
    Trained weights remain known: OYSTERBENCH_MODELS is their folder, and other variables may name a weights file."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("OYSTERBENCH_") or v.endswith(WEIGHTS)}
    return kept | {MODELS: str(models())}


def _ended(report: dict[str, Any], limit_s: float, folder: Path) -> Ended:
    if report["error"]:
        return Ended(0.0, 0.0, 0, 0, f"could not be started: {report['error']}")
    failure, killed = None, False
    if report["timed_out"]:
        failure = f"time limit of {limit_s:g} s reached: killed"
    elif report["signal"] is not None:
        failure = f"killed by {signal_name(report['signal'])}"
        killed = report["signal"] == signal.SIGKILL
    elif report["stopped"]:
        failure, killed = "its supervisor was ended by SIGTERM", True
    elif report["status"]:
        failure, killed = f"exit status {report['status']}", report["status"] == KILLED_STATUS
    if killed:
        failure = f"{failure} (out of memory?)"
    if failure is not None and (last := tail(folder / STDERR) or tail(folder / STDOUT)):
        failure = f"{failure}; last output: {last}"
    return Ended(report["wall_s"], report["cpu_s"], report["peak_bytes"], report["left_behind"], failure, killed)


def failure_of(report: Path, limit_s: float, folder: Path) -> str | None:
    """Reason why a supervised command failed, from its report or else its output in a folder; None if none is known."""
    try:
        return _ended(json.loads(report.read_text(encoding="utf-8")), limit_s, folder).failure
    except (OSError, ValueError):
        return tail(folder / STDERR) or None


def raise_if_full(folder: Path, said: str) -> None:
    """Raise OSError where the disk of a folder is full, or where a process `said` that it was."""
    full = os.strerror(errno.ENOSPC)
    if full in said or free_bytes(folder) < LEAST_FREE:
        raise OSError(errno.ENOSPC, full, str(folder))


def signal_name(number: int) -> str:
    """Name of a signal, such as SIGSEGV for 11; real-time signals have only numbers."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def tail(path: Path) -> str:
    """Last lines of a log, joined into one line, however long it is and whatever it holds."""
    return " | ".join(_lines(_end_of(path))[-TAIL_LINES:])[-TAIL_CHARACTERS:]


def complete_lines(path: Path) -> list[str]:
    """Last lines of a log that is still being written, without an incomplete last line."""
    return _lines(_end_of(path).rpartition("\n")[0])


def _end_of(path: Path) -> str:
    """End of a log, empty if it does not exist; carriage returns become line ends."""
    try:
        with open(path, "rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - TAIL_BYTES))
            return file.read().decode(errors="replace").replace("\r", "\n")
    except OSError:
        return ""


def _lines(text: str) -> list[str]:
    """Lines that are not blank, with unprintable characters replaced by spaces."""
    printable = "".join(c if c.isprintable() or c == "\n" else " " for c in text)
    return [" ".join(line.split()) for line in printable.split("\n") if line.strip()]
