"""The track steering in a closed loop: pilots dive over reefs, in parallel, and each finished dive is kept.

A dive is a job of its own: which process it runs in, and after which other one, changes nothing in it but its times.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.core.files import write_atomically
from oysterbench.evaluate.steering import EVALUATOR, RolloutLog, score_rollout
from oysterbench.exploration.rollout_store import (
    dive_file,
    method_identity,
    packed,
    read_dive,
    steering_source,
    unpacked,
)
from oysterbench.methods.finding import find_method
from oysterbench.recipe import SplitRecipe
from oysterbench.report.steering import DiveRun
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import PROGRAM, digest
from oysterbench.simulation.salt import Salt
from oysterbench.simulation.scheduling import Results, run_here, run_in_processes

TRACK = "exploration"
REFERENCES = ("expert", "lawnmower", "random")
"""Pilots that come with the closed loop, and see the truth: `oysterbench.exploration.REFERENCES`."""

FAILED = b"failed: "  # begins what a dive gives in which the pilot failed; the file of a finished one begins otherwise

Explore = Callable[..., tuple[RolloutLog, Any]]
"""`oysterbench.exploration.explore`."""


@dataclass(frozen=True)
class DiveJob:
    """A pilot, one of REFERENCES or the reference of a method, over a reef."""

    reef: str
    pilot: str


@dataclass(frozen=True)
class Loop:
    """What all dives have in common. seconds: of each dive, whole steps; start: number of the place where it begins."""

    split: SplitRecipe
    seconds: float
    start: int = 0
    salt: bytes = b""
    explore: Explore | None = None

    @property
    def steps(self) -> int:
        """Commands of a dive."""
        assert self.split.steering is not None
        return round(self.seconds / self.split.steering.step_s)


def make_loop(
    split: SplitRecipe,
    seconds: float | None = None,
    start: int = 0,
    salt: bytes = b"",
    explore: Explore | None = None,
) -> Loop:
    """What dives of so many seconds have in common, or of as many as the task says.

    Raises RecipeError where the split is of another track, or a dive would have no step.
    """
    task = split.steering
    if task is None:
        raise RecipeError(f"split {split.name} is of the track {split.track!r}; expected one of the track 'steering'")
    chosen = float(task.dive_s if seconds is None else seconds)
    steps = round(chosen / task.step_s) if math.isfinite(chosen) else 0
    if steps < 1:
        raise RecipeError(
            f"--seconds: expected at least {task.step_s:g}, the time of one command of {split.name}, got {chosen:g}"
        )
    return Loop(split, steps * task.step_s, start, Salt(salt), explore)


def run_dives(
    loop: Loop,
    reefs: Sequence[str],
    pilots: Sequence[str],
    folder: Path,
    workers: int = 1,
    again: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[DiveRun]:
    """Each pilot over each reef, in that order; dives that `folder` holds already are not made again.

    A pilot that fails leaves a record with `failure`, which is not kept: the next time it is tried again.
    """
    jobs = [DiveJob(reef, pilot) for reef in reefs for pilot in pilots]
    identities = {pilot: _pilot(pilot) for pilot in pilots}
    files = {job: dive_file(folder, job.reef, job.pilot, _identity(loop, job, identities[job.pilot])) for job in jobs}
    found: dict[DiveJob, RolloutLog | str] = {}
    for job in jobs:
        kept = None if again else read_dive(files[job])
        if kept is not None:
            found[job] = kept
    todo = [job for job in jobs if job not in found]
    progress(len(found), len(jobs))
    with contextlib.closing(_results(loop, todo, workers)) as results:
        for job, data in results:
            if data.startswith(FAILED):
                found[job] = data.removeprefix(FAILED).decode()
            else:
                write_atomically(files[job], data)
                found[job] = unpacked(data)
            progress(len(found), len(jobs))
    return [_run(loop, job, found[job], identities[job.pilot]) for job in jobs]


def _results(loop: Loop, jobs: Sequence[DiveJob], workers: int) -> Results[DiveJob]:
    task = partial(make_dive, loop)
    if workers > 1 and len(jobs) > 1:
        return run_in_processes(task, jobs, workers, partial(_warm_up, loop))
    return run_here(task, jobs)


def _warm_up(loop: Loop) -> None:
    """Compile the kernels once; the other processes find them."""
    if loop.explore is None:
        from oysterbench.render.camera import warm_up

        warm_up("cpu")


def make_dive(loop: Loop, job: DiveJob) -> bytes:
    """A dive, as its file, or why the pilot failed."""
    explore = loop.explore or _explore()
    try:
        pilot = job.pilot if job.pilot in REFERENCES else find_method(job.pilot)
        log, _ = explore(loop.split, job.reef, pilot, salt=loop.salt, seconds=loop.seconds, start=loop.start)
        if len(log.commands) < loop.steps:
            raise MethodError(
                f"method {job.pilot!r} on {job.reef}: expected {loop.steps} commands, got {len(log.commands)}"
            )
    except MethodError as error:
        return FAILED + str(error).encode()
    return packed(log)


def _explore() -> Explore:
    from oysterbench.exploration.rollout import explore  # loads the renderer

    return explore


def _pilot(pilot: str) -> dict[str, Any]:
    return {"reference": pilot} if pilot in REFERENCES else method_identity(pilot)


def _identity(loop: Loop, job: DiveJob, pilot: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "program": PROGRAM,
        "steering": steering_source(),
        "split": digest(loop.split, loop.salt),
        "reef": job.reef,
        "pilot": pilot,
        "seconds": loop.seconds,
        "start": loop.start,
    }


def _run(loop: Loop, job: DiveJob, made: RolloutLog | str, pilot: Mapping[str, Any]) -> DiveRun:
    split = loop.split
    about: dict[str, Any] = {
        "track": TRACK,
        "split": split.name,
        "split_digest": digest(split, loop.salt),
        "sequence": job.reef,
        "conditions": conditions(split, job.reef),
        "evaluator_version": EVALUATOR,
        "method": job.pilot,
        "seed": pilot.get("seed"),
        "method_settings": json.loads(json.dumps(pilot.get("settings", {}), default=str)),
        "settings": {"dive_s": loop.seconds, "start": loop.start},
    }
    if isinstance(made, str):
        return DiveRun(ResultRecord(**about, failure=made))
    assert split.steering is not None
    score = score_rollout(made, split.steering)
    about["truth_digest"] = hashlib.sha256(made.oysters.round(6).tobytes()).hexdigest()
    return DiveRun(ResultRecord(**about, metrics=score.metrics, reasons=score.reasons), made)
