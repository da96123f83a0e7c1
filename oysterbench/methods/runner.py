"""Runs many jobs, each once: in parallel as far as cores and memory allow, resuming after an interruption."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import LabelError, MachineError, MethodError, SequenceError
from oysterbench.core.locks import scratch
from oysterbench.methods.inputs import Announce, Inputs
from oysterbench.methods.interfaces import Predicted
from oysterbench.methods.outcomes import OUTCOME, Job, Outcome, differing, read_outcome
from oysterbench.methods.processes import FULL, Processes, raise_if_full, secrets
from oysterbench.methods.run_output import OnOutput, read_output
from oysterbench.methods.sandbox import can_hide
from oysterbench.methods.sharing import Sharing, default_workers, known_peaks

AGAIN = "again"
"""File in the folder of the results while their runs are being repeated."""
REPETITION_S = 24 * 3600.0
"""Time after its last run until which an interrupted repetition is gone on with, s."""
LOOK_S = 1.0
"""Interval at which the output of running jobs is read, s."""


def run_jobs(
    jobs: Sequence[Job],
    root: Path,
    workers: int | None = 1,
    again: bool = False,
    retry: Callable[[Job, Outcome], bool] | None = None,
    exports: Path | None = None,
    hardware: Callable[[], Mapping[str, Any]] = dict,
    announce: Announce = lambda text: None,
    scheduler: str | None = None,
    on_output: OnOutput | None = None,
) -> Iterator[tuple[Job, Outcome]]:
    """Yield each job with its outcome as it finishes; jobs that were finished before come first and are not run.

    root: folder of the results, which only one runner at a time may use. again: run finished jobs again, or
    go on with that where it was interrupted, unless that is REPETITION_S ago; retry: rerun what failed, and what it is
    true of, such as of a run that cannot be scored; None to keep these. What failed is rerun in any case if files of
    its sequence or method have changed.
    workers: jobs at a time; None for one per core. exports: folder where inputs are kept for other runs. hardware:
    describes a machine; scheduler: address of a Dask cluster to run the jobs on. on_output: called with the latest
    output of jobs that run here.
    A job that fails has a `failure`; nothing that a method does raises here. Raises MethodError, before anything is
    run, where `root` holds outcomes of other jobs under the same names or the options of a method fit none of its
    sequences, and OSError where a disk is full.
    """
    with _alone(root):
        todo, kept = [], []
        begun_ns = _begun_again(jobs, root) if again else 0
        for job in jobs:
            known = _finished(job, root, retry) if _written_ns(job.folder(root) / OUTCOME) >= begun_ns else None
            if known is None:
                todo.append(job)
            else:
                kept.append(known.ended)
                yield job, known
        if kept and again:
            announce(
                f"{root}: going on with the repetition begun {_time(begun_ns / 1e9)}, of which {len(kept)} of "
                f"{len(jobs)} runs are there; to begin anew, delete {root / AGAIN}"
            )
        elif kept:
            announce(
                f"{root}: kept {len(kept)} of {len(jobs)} runs from an earlier command, the last of {max(kept)}, "
                "and did not run them again; `oysterbench run` with --again reruns them"
            )
        _check(todo)
        if todo and scheduler is not None:
            from oysterbench.methods.remote import run_remotely

            yield from run_remotely(todo, root, scheduler, workers, hardware)
        elif todo:
            yield from _run(todo, root, workers or default_workers(), exports, hardware(), announce, on_output)
        # A run that the machine ended has none: the same command then repeats that alone.
        if all(_written_ns(job.folder(root) / OUTCOME) for job in jobs):
            (root / AGAIN).unlink(missing_ok=True)


def _begun_again(jobs: Sequence[Job], root: Path) -> int:
    """When these jobs began to be repeated, ns since the epoch: now or, where that was interrupted of late, then. What
    was finished since need not be run again."""
    marker, text = root / AGAIN, _digest_of(jobs)
    known = marker.is_file() and marker.read_text() == text
    last_ns = max(map(_written_ns, [marker, *(job.folder(root) / OUTCOME for job in jobs)]))
    if not known or time.time_ns() - last_ns > REPETITION_S * 1e9:
        write_atomically(marker, text.encode())
    return marker.stat().st_mtime_ns


def _digest_of(jobs: Sequence[Job]) -> str:
    return hashlib.sha256(json.dumps([job.identity for job in jobs], sort_keys=True).encode()).hexdigest()


def _written_ns(path: Path) -> int:
    """When a file was written, ns since the epoch; 0 where there is none."""
    return path.stat().st_mtime_ns if path.is_file() else 0


def _check(jobs: Sequence[Job]) -> None:
    """Refuse options that fit none of a method's sequences: a mistake. If they fit some, only the other jobs fail."""
    misfits: dict[str, list[MethodError | None]] = {}
    for job in jobs:
        try:
            job.adapter.check(job.sequence)
            misfit = None
        except MethodError as error:
            misfit = error
        misfits.setdefault(job.adapter.name, []).append(misfit)
    for found in misfits.values():
        if found[0] is not None and None not in found:
            raise found[0]


def _finished(job: Job, root: Path, retry: Callable[[Job, Outcome], bool] | None) -> Outcome | None:
    """Return the outcome of a job that need not be run, else None. Raises MethodError where it is of another job."""
    folder = job.folder(root)
    outcome = read_outcome(folder)
    if outcome is None or (retry is not None and outcome.failure is not None):
        return None
    if outcome.identity != job.identity:
        changed = _changed_files(outcome.identity, job.identity)
        if outcome.failure is not None and changed and _but_files(outcome.identity) == _but_files(job.identity):
            return None  # the files that it failed on were mended
        keys = differing(outcome.identity, job.identity)
        parts = [f"{', '.join(keys)} differ{'s' if len(keys) == 1 else ''}"] if keys else []
        differs = "; ".join([*parts, *([f"{', '.join(changed)} changed"] if changed else [])])
        if changed and job.identity["method"].get("files") and not outcome.identity["method"].get("files"):
            differs = "an earlier version of oysterbench did not record by which files"
        raise MethodError(
            f"{folder}: holds run {job.number + 1} of a different {job.adapter.name} ({differs}); "
            "it was left unchanged: rerun it with --again, or choose another folder with --out"
        )
    known = replace(outcome, earlier=True)
    return None if retry is not None and retry(job, known) else known


def _changed_files(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Names of the files of a method or program, and of the sequence, that differ; those in only one of the identities
    are among them if it is the same method or sequence."""
    old, new = (identity["method"].get("files", {}) for identity in (before, now))
    names = {**new, **old} if _but_files(before)["method"] == _but_files(now)["method"] else new.keys() & old.keys()
    changed = sorted(name for name in names if old.get(name) != new.get(name))
    (place, *old), (same, *new) = (identity["origin"].splitlines() for identity in (before, now))
    if place == same:
        changed += sorted({line.partition(" ")[2] for line in {*old} ^ {*new}})
    return changed


def _but_files(identity: Mapping[str, Any]) -> dict[str, Any]:
    """An identity without its files: where the sequence is, and the method by its reference and settings."""
    method = {key: value for key, value in identity["method"].items() if key != "files"}
    return {**identity, "method": method, "origin": identity["origin"].partition("\n")[0]}


def _by_lasting_names(failure: str, job: Job, given: Path | None, folder: Path, kept: Path) -> str:
    """Replace the paths of a job's temporary input and output, which are deleted, by those of the files that last."""
    failure = failure.replace(str(folder), str(kept))
    own = job.adapter.form == job.adapter.interface.own_form
    return failure.replace(str(given), str(job.sequence.source)) if own and given and job.sequence.source else failure


def _run(
    jobs: list[Job],
    root: Path,
    workers: int,
    exports: Path | None,
    hardware: Mapping[str, Any],
    announce: Announce,
    on_output: OnOutput | None,
) -> Iterator[tuple[Job, Outcome]]:
    processes = Processes()
    held = ExitStack()
    # The path of a temporary folder does not reveal where the ground truth is.
    inputs = Inputs(held.enter_context(scratch()), jobs, processes, exports, announce)
    sharing = Sharing(workers, known_peaks(jobs, root))
    waiting, running = list(jobs), dict[Future[Outcome], Job]()
    folders: dict[str, Path] = {}
    pool = ThreadPoolExecutor(workers)
    try:
        while waiting or running:
            while waiting and sharing.fits(waiting[0], running.values()):
                job = waiting.pop(0)
                cores = sharing.cores(job, running.values(), waiting)
                started = len(jobs) - len(waiting)
                announce(f"running {job.title} ({started} of {len(jobs)})")
                begun = partial(folders.__setitem__, job.title)
                running[pool.submit(run_job, job, root, inputs, processes, hardware, begun, cores)] = job
            ended = wait(running, None if on_output is None else LOOK_S, FIRST_COMPLETED).done
            if on_output is not None:
                titles = [job.title for future, job in running.items() if future not in ended]
                on_output({title: read_output(folders[title]) for title in titles if title in folders})
            for future in ended:
                job, outcome = running.pop(future), future.result()
                sharing.learn(job, outcome)
                yield job, outcome
    finally:
        # Also if the caller stops iterating or is interrupted: no process is left running unattended.
        processes.stop()
        pool.shutdown(wait=True, cancel_futures=True)
        inputs.close()
        held.close()


def run_job(
    job: Job,
    root: Path,
    inputs: Inputs,
    processes: Processes,
    hardware: Mapping[str, Any] | None = None,
    begun: Callable[[Path], None] = lambda folder: None,
    cores: int | None = None,
) -> Outcome:
    """Run one job and write its outcome, unless it was the machine that failed. begun: called with the folder that the
    job's output goes to while it runs. cores: number of cores for it, where jobs share a machine."""
    kept = job.folder(root)
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    folder = Path(tempfile.mkdtemp(dir=inputs.scratch))
    begun(folder)
    started, seed = _now(), job.adapter.seed(job.number)
    who = f"method {job.adapter.name!r} on {job.sequence.name}"
    hidden = (*job.sequence.hidden, *secrets(), *inputs.hidden)
    command: list[str] = []
    given: Path | None = None
    outcome = Outcome(
        identity=job.identity,
        failure=None,
        wall_s=0.0,
        cpu_s=0.0,
        process={"wall_s": 0.0, "cpu_s": 0.0, "peak_bytes": 0, "left_behind": 0},
        command=command,
        limit_s=job.limit_s,
        versions=job.adapter.versions(),
        hardware=dict(hardware or {}),
        started=started,
        ended=started,
        contained=can_hide(),
    )
    try:
        job.adapter.check(job.sequence)
        given = inputs.of(job)
        places = partial(processes.run, folder=folder, hidden=hidden, visible=[given], fixed=[root])
        run = partial(places, limit_s=job.limit_s, cores=cores)
        preparation = job.adapter.preparation(given, folder, job.number)
        prepared = run(preparation) if preparation else None
        if prepared is not None and prepared.failure is not None:
            ended = prepared
        else:
            command += job.adapter.command(given, folder, job.number)
            ended = run(command)
            process = {key: getattr(ended, key) for key in outcome.process}
            outcome = replace(outcome, wall_s=ended.wall_s, cpu_s=ended.cpu_s, process=process)
        unfit = _unfit(folder / job.adapter.interface.out)
        _move(folder, kept)
        if ended.failure is not None:
            outcome = replace(outcome, failure=job.adapter.own_failure(kept) or f"{who}: {ended.failure}")
        elif unfit:
            raise MethodError(f"{job.adapter.left_none}: {unfit}")
        else:
            outcome = _with_predictions(outcome, job, job.adapter.take(job.sequence, given, kept))
    except (MethodError, SequenceError, LabelError) as error:
        seeded = f" with seed {seed}" if seed is not None else ""
        outcome = replace(outcome, failure=f"{who}{seeded}: {error}")
    except MachineError as error:
        outcome = replace(outcome, failure=f"{who}: {error}", finished=False)
    finally:
        inputs.done(job)
        shutil.rmtree(folder, ignore_errors=True)
    if outcome.failure is not None:
        for place in (*inputs.hidden, kept):
            raise_if_full(place)
        failure = _by_lasting_names(outcome.failure, job, given, folder, kept)
        # A disk was full, if only for a moment or another one, such as /dev/shm: that says nothing of the method.
        if FULL in failure or not outcome.finished:
            failure = f"{failure}; the run is not counted, and the same command runs it again"
            outcome = replace(outcome, finished=False)
        outcome = replace(outcome, failure=failure)
    outcome = replace(outcome, ended=_now())
    if outcome.finished:
        outcome.write(kept)
    return outcome


def _move(source: Path, target: Path) -> None:
    """Move what a run left, except symbolic links: a reader with more rights than the method would follow them."""
    for path in sorted(source.rglob("*")):
        if path.is_symlink() or not path.is_file():
            continue
        place = target / path.relative_to(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(path, place)


def _unfit(out: Path) -> str:
    """What is wrong with an output that is not moved; empty if there is none, or nothing wrong."""
    if out.is_symlink():
        return f"it is a link, to {os.readlink(out)}, and links are not followed; write the file itself to {{out}}"
    if out.is_dir() and not any(path.is_file() for path in out.rglob("*")):
        return "it is a folder without files; write to {out} itself"
    return ""


def _with_predictions(outcome: Outcome, job: Job, found: Predicted) -> Outcome:
    notes = list(found.notes)
    if left := outcome.process["left_behind"]:
        notes.append(f"{left} processes were still running after it ended and were killed")
    return replace(
        outcome,
        wall_s=outcome.wall_s if found.wall_s is None else found.wall_s,
        cpu_s=outcome.cpu_s if found.cpu_s is None else found.cpu_s,
        info=dict(found.info),
        notes=notes,
        prediction=dict(found.prediction),
    )


def _now() -> str:
    return _time(time.time())


def _time(since_epoch_s: float) -> str:
    return datetime.fromtimestamp(since_epoch_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """Lock the folder. Raises MethodError where another runner holds it."""
    root.mkdir(parents=True, exist_ok=True)
    with open(root / ".runner", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise MethodError(f"{root}: another run is using it; wait for it or choose another --out") from None
        yield
