"""Runs many jobs: in parallel where cores and memory allow, each once, going on where it was interrupted."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import Any

from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import write_npz
from oysterbench.methods.inputs import SENSORS
from oysterbench.methods.outcomes import OUTCOME, Job, Outcome, read_outcome
from oysterbench.methods.processes import Ended, Processes
from oysterbench.methods.worker import ESTIMATE

ASSUMED_BYTES = 2 * 2**30
"""What a method is taken to need as long as none of its runs has been measured."""
MARGIN = 1.2
"""Of a method's greatest peak so far, for the next of its runs."""
EXPORT_LIMIT_S = 24 * 3600.0

Announce = Callable[[str], None]


def default_limit_s(duration_s: float) -> float:
    """Ten times the sequence's duration, and ten minutes at least."""
    return max(10 * duration_s, 600.0)


def default_workers() -> int:
    """One for each core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_jobs(
    jobs: Sequence[Job],
    root: Path,
    workers: int = 1,
    again: bool = False,
    retry: bool = False,
    keep_inputs: bool = False,
    hardware: Mapping[str, Any] | None = None,
    announce: Announce = lambda text: None,
) -> Iterator[tuple[Job, Outcome]]:
    """Each job with its outcome, as they are finished; those that are finished already come first and are not run.

    root: folder of the results, which one runner at a time may work in. again: run the finished ones too; retry: those
    of them that failed. A job that ends badly has a `failure`; nothing that a method does raises here.
    Raises MethodError, before anything is run, where `root` holds outcomes of other jobs under the same names.
    """
    with _alone(root):
        todo = []
        for job in jobs:
            known = None if again else _finished(job, root)
            if known is None or (retry and known.failure is not None):
                todo.append(job)
            else:
                yield job, known
        if todo:
            yield from _run(todo, root, workers, keep_inputs, hardware or {}, announce)


def _finished(job: Job, root: Path) -> Outcome | None:
    folder = job.folder(root)
    outcome = read_outcome(folder)
    if outcome is not None and outcome.identity != job.identity:
        raise MethodError(
            f"{folder}: holds run {job.number + 1} of another {job.entrant.name} (method, command or recipe differ); "
            "it was left as it is: --again runs it anew, --out chooses another folder"
        )
    return outcome


def _run(
    jobs: list[Job], root: Path, workers: int, keep_inputs: bool, hardware: Mapping[str, Any], announce: Announce
) -> Iterator[tuple[Job, Outcome]]:
    processes = Processes()
    inputs = Inputs(root / "inputs", jobs, keep_inputs, processes)
    peaks = _known_peaks(jobs, root)
    budget = available_bytes()
    waiting, running = list(jobs), dict[Future[Outcome], Job]()
    pool = ThreadPoolExecutor(workers)
    try:
        while waiting or running:
            while waiting and len(running) < workers and _fits(waiting[0], running.values(), peaks, budget):
                job = waiting.pop(0)
                started = len(jobs) - len(waiting)
                announce(f"running {job.entrant.name} on {job.name}, run {job.number + 1} ({started} of {len(jobs)})")
                running[pool.submit(run_job, job, root, inputs, processes, hardware)] = job
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job, outcome = running.pop(future), future.result()
                peak = int(outcome.process["peak_bytes"])
                peaks[job.entrant.name] = max(peaks.get(job.entrant.name, 0), peak)
                yield job, outcome
    finally:
        # Also where the caller stops asking, or is interrupted: nothing goes on without being waited for.
        processes.stop()
        pool.shutdown(wait=True, cancel_futures=True)
        inputs.clear()


def run_job(
    job: Job, root: Path, inputs: Inputs, processes: Processes, hardware: Mapping[str, Any] | None = None
) -> Outcome:
    """Run one job and keep what became of it."""
    folder = job.folder(root)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    started, seed = _now(), job.entrant.seed(job.number)
    command: list[str] = []
    outcome = Outcome(
        identity=job.identity,
        failure=None,
        wall_s=0.0,
        cpu_s=0.0,
        process={"wall_s": 0.0, "cpu_s": 0.0, "peak_bytes": 0, "left_behind": 0},
        command=command,
        limit_s=job.limit_s,
        versions=job.entrant.versions(),
        hardware=dict(hardware or {}),
        started=started,
        ended=started,
    )
    try:
        given = inputs.of(job)
        command += job.entrant.command(given, folder.absolute(), job.number)
        ended = processes.run(command, job.limit_s, folder)
        outcome = _with_cost(outcome, ended)
        outcome = _with_answer(outcome, job, given, folder, ended)
    except MethodError as error:
        seeded = f" with seed {seed}" if seed is not None else ""
        outcome = replace(outcome, failure=f"method {job.entrant.name!r} on {job.name}{seeded}: {error}")
    finally:
        inputs.done(job)
    outcome = replace(outcome, ended=_now())
    outcome.write(folder)
    return outcome


def _with_cost(outcome: Outcome, ended: Ended) -> Outcome:
    process = {
        "wall_s": ended.wall_s,
        "cpu_s": ended.cpu_s,
        "peak_bytes": ended.peak_bytes,
        "left_behind": ended.left_behind,
    }
    return replace(outcome, wall_s=ended.wall_s, cpu_s=ended.cpu_s, process=process)


def _with_answer(outcome: Outcome, job: Job, given: Path, folder: Path, ended: Ended) -> Outcome:
    if ended.failure is not None:
        said = job.entrant.said_failure(folder)
        return replace(outcome, failure=said or f"method {job.entrant.name!r} on {job.name}: {ended.failure}")
    answer = job.entrant.answer(job.path, given, folder)
    if not (folder / ESTIMATE).is_file():
        write_npz(folder / ESTIMATE, answer.trajectory)
    notes = list(answer.trajectory.notes)
    if ended.left_behind:
        notes.append(f"{ended.left_behind} processes were still running when it had ended: they were killed")
    return replace(
        outcome,
        wall_s=ended.wall_s if answer.wall_s is None else answer.wall_s,
        cpu_s=ended.cpu_s if answer.cpu_s is None else answer.cpu_s,
        info=dict(answer.info),
        notes=notes,
        scored=answer.scored,
        alternatives=list(answer.alternatives),
        map=answer.map,
    )


class Inputs:
    """Sequences in the forms that programs read: each made once, kept as long as a job needs it."""

    def __init__(self, folder: Path, jobs: Sequence[Job], keep: bool, processes: Processes) -> None:
        self._folder, self._keep, self._processes = folder, keep, processes
        self._wanted = Counter((job.entrant.form, job.path) for job in jobs)
        self._locks = {key: Lock() for key in self._wanted}
        self._count = Lock()

    def of(self, job: Job) -> Path:
        """The sequence of a job in its form, made now if it is not there. MethodError where it cannot be."""
        form = job.entrant.form
        place = self._place(job)
        with self._locks[form, job.path]:
            if not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                module = "oysterbench.methods.inputs"
                command = [sys.executable, "-m", module, str(job.path.absolute()), form, str(place.absolute())]
                ended = self._processes.run(command, EXPORT_LIMIT_S, place.parent)
                if ended.failure is not None:
                    raise MethodError(f"its input {{{form}}} could not be made: {ended.failure}")
        return place.absolute()

    def done(self, job: Job) -> None:
        """A job needs its input no more; the last one takes it away."""
        key = (job.entrant.form, job.path)
        with self._count:
            self._wanted[key] -= 1
            last = self._wanted[key] == 0
        if last and not self._keep:
            shutil.rmtree(self._place(job).parent, ignore_errors=True)

    def clear(self) -> None:
        """Nothing runs any more: take all away."""
        if not self._keep:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _place(self, job: Job) -> Path:
        form = job.entrant.form
        origin = hashlib.sha256(job.origin.encode()).hexdigest()[:8]
        is_file = form == "mcap" or (form == SENSORS and job.path.is_file())
        return self._folder / f"{job.name}-{form}-{origin}" / (f"{job.name}.mcap" if is_file else job.name)


def available_bytes() -> int:
    """Memory that processes may still take: the system's, and what the control group leaves of it."""
    found = []
    try:
        rows = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        found.append(int(rows["MemAvailable"].split()[0]) * 1024)
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit != "max":
            found.append(int(limit) - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    except (OSError, KeyError, ValueError):
        pass  # not Linux, or no control group of the second version
    return min(found, default=2**62)


def _fits(job: Job, running: Any, peaks: Mapping[str, int], budget: int) -> bool:
    """Whether one more fits into the memory. The first always does: it may as well try."""
    others = list(running)
    return not others or sum(_need(each, peaks) for each in [job, *others]) <= budget


def _need(job: Job, peaks: Mapping[str, int]) -> float:
    peak = peaks.get(job.entrant.name)
    return ASSUMED_BYTES if peak is None else MARGIN * peak


def _known_peaks(jobs: Sequence[Job], root: Path) -> dict[str, int]:
    """By name of an entrant, the most memory that any of its runs in this folder took."""
    peaks: dict[str, int] = {}
    for name in {job.entrant.name for job in jobs}:
        for path in (root / "runs" / name).glob(f"*/*/{OUTCOME}"):
            try:
                outcome = read_outcome(path.parent)
            except MethodError:
                continue
            if outcome is not None and outcome.process["peak_bytes"]:
                peaks[name] = max(peaks.get(name, 0), int(outcome.process["peak_bytes"]))
    return peaks


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """Hold the folder. Raises MethodError where another runner does."""
    root.mkdir(parents=True, exist_ok=True)
    with open(root / ".runner", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise MethodError(f"{root}: another run is working in it; wait for it or choose another --out") from None
        yield
