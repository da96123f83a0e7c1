"""Commands in their own processes: time-limited, measured, and ended together with everything that they started."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from oysterbench.core.disk_space import free_bytes
from oysterbench.core.errors import MachineError
from oysterbench.core.locks import SCRATCH
from oysterbench.core.places import MODELS, home, models
from oysterbench.methods.sandbox import Sandbox, can_hide
from oysterbench.methods.supervise import KILLING_S
from oysterbench.methods.weights import weights_names, weights_variable
from oysterbench.simulation.salt import SALT, SALT_FILE

SUPERVISOR = Path(__file__).with_name("supervise.py")
PACKAGE = str(Path(__file__).parent.parent)
DEVICES = "/dev"
STDOUT, STDERR = "stdout.txt", "stderr.txt"
MARGIN_S = 10.0
"""Time that a supervisor may take beyond its limit and KILLING_S."""
CONTINUED_S = KILLING_S + MARGIN_S
"""Time that it may take after it was stopped and continued."""
LEAST_FREE = 1 << 20
"""Free space, bytes, below which any failure is put down to a full disk."""
KILLED_STATUS = 128 + signal.SIGKILL
"""Exit status by which a shell reports that its command was killed by SIGKILL."""
THREADS = "OMP_NUM_THREADS"
"""Number of threads that libraries start to compute in parallel, such as PyTorch and those of linear algebra."""
WITHHELD = {
    *("OYSTERBENCH_HOME", "OYSTERBENCH_HUB", "OYSTERBENCH_HUB_KEY", "OYSTERBENCH_OFFLINE", "OYSTERBENCH_EXPORTS_GB"),
    *("OYSTERBENCH_BOARD", "OYSTERBENCH_BOARD_URL", "OYSTERBENCH_INDEX", "OYSTERBENCH_SUBMISSIONS"),
    *(SALT, SALT_FILE, "OYSTERBENCH_TOKEN"),
}
"""Variables of oysterbench that no method is told: where data is kept, secrets, and what else commands read."""
WEIGHTS = ".pt"
"""File suffix of trained weights: those of a user's own method may be named by any variable."""
CACHES = ("huggingface", "matplotlib", "numba", "torch", "torch_extensions")
"""Folders in the user's cache that libraries of methods fail or are slow without. All others are fixed: those of
installers have files that may be hard links to installed code."""
CACHES_AT_HOME = (".nv", ".ros", ".triton")
"""Folders in the user's home that are used in the same way, if they are there."""
TEMPORARY = "tmp"
"""Name of the temporary folder of a method's process."""
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
        fixed: Iterable[Path] = (),
        cores: int | None = None,
    ) -> Ended:
        """Run a command to its end; its output goes to stdout.txt and stderr.txt in a folder.

        hidden: paths that it cannot open, if the kernel can hide them (`sandbox`); its environment does not reveal them
        either, and its temporary folder is one inside the folder, which is deleted afterwards. visible: paths inside
        hidden ones that it can read. fixed: paths that it cannot write to; see `supervised_command` for others. cores:
        number of cores for it, where several commands share a machine (`threads`); None for all.
        Raises MachineError where it was killed from outside, by the kernel for lack of memory or by a person, and
        Stopped once `stop` was called.
        """
        hidden, temporary = tuple(hidden), folder / TEMPORARY
        env = dict(os.environ) | threads(cores)
        if hidden:
            temporary.mkdir(exist_ok=True)
            env = environment() | threads(cores) | {"TMPDIR": str(temporary)}
        with (
            tempfile.TemporaryFile() as report,
            open(folder / STDOUT, "wb") as out,
            open(folder / STDERR, "wb") as err,
        ):
            supervised = supervised_command(command, limit_s, report, hidden, visible, [folder], fixed)
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
                    pass_fds=[report.fileno()],
                    env=env,
                )
                self._running.add(process)
            try:
                _wait(process, limit_s)
            finally:
                with self._lock:
                    self._running.discard(process)
            said = report_of(report)
        if hidden:
            shutil.rmtree(temporary, ignore_errors=True)
        self.raise_if_stopped()
        if process.returncode != 0 or said is None:
            raise MachineError(
                f"the supervisor of {command[0]} was killed: {tail(folder / STDERR) or 'no word from it'}"
            )
        ended = _ended(said, limit_s, folder)
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
    command: Sequence[str],
    limit_s: float,
    report: IO[bytes],
    hidden: Iterable[Path],
    visible: Iterable[Path] = (),
    own: Iterable[Path] = (),
    fixed: Iterable[Path] = (),
) -> list[str]:
    """Command line that runs a command under the supervisor, unable to open what is hidden and not visible.

    If anything is hidden, it can write only to its own folders and, as far as they are neither hidden nor fixed, to
    temporary folders, devices and CACHES. Python and this package are always fixed. report: file that the supervisor
    inherits (see `supervise`), which `report_of` reads
    """
    places = [os.path.realpath(path) for path in hidden if path.exists()]
    if places and can_hide():
        places += _disks()
        names = {os.path.realpath(path or os.curdir) for path in [os.curdir, *sys.path]}
        folders = (tempfile.gettempdir(), "/tmp", "/var/tmp", DEVICES, *map(str, _caches()))
        shared = [os.path.realpath(path) for path in folders]
        sandbox = Sandbox(
            hidden=tuple(places),
            visible=tuple(map(str, visible)),
            listed=(*sorted(names), DEVICES),
            writable=(*map(str, own), *(path for path in shared if not _is_in(path, places))),
            fixed=(PACKAGE, sys.prefix, sys.base_prefix, *map(str, _scratches()), *map(str, fixed)),
        )
        command = sandbox.command(command)
    return [sys.executable, "-I", "-S", str(SUPERVISOR), repr(float(limit_s)), str(report.fileno()), *command]


def secrets() -> tuple[Path, ...]:
    """Paths that no method may open, whatever it runs on: rendered splits, and the file of the salt of hidden ones."""
    salt = os.environ.get(SALT_FILE)
    return (home() / "splits", *([Path(salt)] if salt else []))


def _disks() -> list[str]:
    """Disks as devices, in which root could read all files."""
    with os.scandir(DEVICES) as found:
        return [each.path for each in found if Path(each.path).is_block_device()]


def _scratches() -> Iterator[Path]:
    """Folders that runs of this and of other commands use."""
    return Path(tempfile.gettempdir()).glob(f"{SCRATCH}*")


def _caches() -> list[Path]:
    """Folders of CACHES, which are made where absent, and of CACHES_AT_HOME."""
    try:
        home_folder = Path.home()
    except RuntimeError:  # a user without a home, as in some containers
        return []
    cache = Path(os.environ.get("XDG_CACHE_HOME") or home_folder / ".cache")
    found = [cache / name for name in CACHES]
    for path in found:
        with suppress(OSError):
            path.mkdir(parents=True, exist_ok=True)
    return [*found, *(home_folder / name for name in CACHES_AT_HOME)]


def _is_in(path: str, places: Iterable[str]) -> bool:
    return any(Path(path).is_relative_to(place) for place in places)


def environment() -> dict[str, str]:
    """Environment of a method's process: this one's, without the variables that say where data is kept, and the salts.
    Trained weights remain known: OYSTERBENCH_MODELS is their folder, and other variables name files of weights; those
    that mean something to oysterbench do not, whatever weights are called."""
    named = {weights_variable(name) for name in weights_names()} - WITHHELD
    kept = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith("OYSTERBENCH_") or key in named or (value.endswith(WEIGHTS) and key not in WITHHELD)
    }
    return kept | {MODELS: str(models())}


def threads(cores: int | None) -> dict[str, str]:
    """Environment of a command with so many cores for itself, where several share a machine; None for all of them:
    libraries that compute in parallel start as many threads, unless the user has set OMP_NUM_THREADS. Threads that
    outnumber the cores wait for each other and take several times as long."""
    return {} if cores is None or THREADS in os.environ else {THREADS: str(cores)}


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
        cause = "out of memory?" if report["short"] else "by itself or from outside: memory was not short"
        failure = f"{failure} ({cause})"
    if failure is not None and (last := tail(folder / STDERR) or tail(folder / STDOUT)):
        failure = f"{failure}; last output: {last}"
        if any(os.strerror(denied) in last for denied in (errno.EACCES, errno.EROFS)):
            failure += (
                "; it can write only to the folder of {out}, to temporary folders such as TMPDIR, and to /dev/shm"
            )
    return Ended(report["wall_s"], report["cpu_s"], report["peak_bytes"], report["left_behind"], failure, killed)


def report_of(report: IO[bytes]) -> dict[str, Any] | None:
    """Read what a supervisor reported; None if it was killed before it did."""
    report.seek(0)
    try:
        said: dict[str, Any] = json.loads(report.read())
    except ValueError:
        return None
    return said


def ended_of(report: IO[bytes], limit_s: float, folder: Path) -> Ended:
    """How a supervised command ended, from its report and its output in a folder. Raises MachineError where it, or its
    supervisor, was killed from outside."""
    if (said := report_of(report)) is None:
        raise MachineError(f"its supervisor was killed: {tail(folder / STDERR) or 'no word from it'}")
    ended = _ended(said, limit_s, folder)
    if ended.killed:
        raise MachineError(ended.failure)
    return ended


def _wait(process: subprocess.Popen[bytes], limit_s: float) -> None:
    """Wait for a supervisor. One that is not done in time was stopped, by its command where the kernel does not prevent
    that, and is continued; then it is killed."""
    with suppress(subprocess.TimeoutExpired):
        process.wait(limit_s + KILLING_S + MARGIN_S)
        return
    process.send_signal(signal.SIGCONT)
    with suppress(subprocess.TimeoutExpired):
        process.wait(CONTINUED_S)
        return
    process.kill()
    process.wait()


FULL = os.strerror(errno.ENOSPC)


def raise_if_full(folder: Path) -> None:
    """Raise OSError where the disk of a folder is full."""
    if free_bytes(folder) < LEAST_FREE:
        raise OSError(errno.ENOSPC, FULL, str(folder))


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
