"""The steering track in closed loop: policies drive over reefs, in parallel, and each finished rollout is kept.

Each rollout is a job of its own: the process that it runs in, and the rollouts before it, affect only its times.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import write_atomically
from oysterbench.core.cluster import Results
from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.evaluate.steering import EVALUATOR, RolloutLog, score_rollout
from oysterbench.exploration.rollout_store import (
    method_identity,
    packed,
    read_rollout,
    rollout_file,
    steering_source,
    unpacked,
)
from oysterbench.methods.finding import find_method
from oysterbench.methods.policy_process import LIMIT_S, PolicyProcess
from oysterbench.methods.sharing import default_workers
from oysterbench.recipe import SplitRecipe
from oysterbench.report import results_table
from oysterbench.report.exploring import places, places_table, policies_table
from oysterbench.report.steering import RolloutRun
from oysterbench.report.steering_figures import rollout_figures
from oysterbench.report.tables import standings_table
from oysterbench.results.comparison import boards
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.generate import PROGRAM, digest
from oysterbench.simulation.salt import Salt
from oysterbench.simulation.scheduling import run_here, run_in_processes
from oysterbench.tracks.track import Evaluation, about_sequence

TRACK = "exploration"
REFERENCES = ("expert", "lawnmower", "random")
"""Policies that are included with the closed loop and see the ground truth; see `exploration.references`."""

FAILED = b"failed: "
"""Prefix of the data of a rollout in which the policy failed; the file of a finished one starts differently."""

Explore = Callable[..., tuple[RolloutLog, Any]]
"""A function like `oysterbench.exploration.rollout.explore`."""


@dataclass(frozen=True)
class RolloutJob:
    """A policy (one of REFERENCES, or the reference of a method) on a reef."""

    reef: str
    policy: str


@dataclass(frozen=True)
class RolloutPlan:
    """Parameters common to all rollouts. seconds: length of each, a whole number of steps; start: number of the start
    pose; limit_s: time limit of each, in s of the clock."""

    split: SplitRecipe
    seconds: float
    start: int = 0
    salt: bytes = b""
    explore: Explore | None = None
    limit_s: float = LIMIT_S

    @property
    def steps(self) -> int:
        """Number of commands in a rollout."""
        assert self.split.steering is not None
        return round(self.seconds / self.split.steering.step_s)


def plan_rollouts(
    split: SplitRecipe,
    seconds: float | None = None,
    start: int = 0,
    salt: bytes = b"",
    explore: Explore | None = None,
    limit_s: float = LIMIT_S,
) -> RolloutPlan:
    """Make the plan of rollouts that last `seconds`, or as long as the task says.

    Raises RecipeError where the split is of another track, or a rollout would be shorter than a step.
    """
    task = split.steering
    if task is None:
        raise RecipeError(f"split {split.name} is of the track {split.track!r}; expected one of the track 'steering'")
    chosen = float(task.rollout_s if seconds is None else seconds)
    steps = round(chosen / task.step_s) if math.isfinite(chosen) else 0
    if steps < 1:
        raise RecipeError(
            f"--seconds: expected at least {task.step_s:g}, the time of one command of {split.name}, got {chosen:g}"
        )
    return RolloutPlan(split, steps * task.step_s, start, Salt(salt), explore, limit_s)


def run_rollouts(
    plan: RolloutPlan,
    reefs: Sequence[str],
    policies: Sequence[str],
    folder: Path,
    workers: int = 1,
    again: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    announce: Callable[[str], None] = lambda text: None,
) -> list[RolloutRun]:
    """Run each policy on each reef, reef by reef; rollouts already in `folder` are not repeated, which is announced.

    A policy that fails gets a record with `failure`, which is not kept: the next time it is tried again. Raises
    MachineError where one was killed from outside: the rollouts before it are kept.
    """
    jobs = [RolloutJob(reef, policy) for reef in reefs for policy in policies]
    identities = {policy: _policy(policy) for policy in policies}
    files = {
        job: rollout_file(folder, job.reef, job.policy, _identity(plan, job, identities[job.policy])) for job in jobs
    }
    if again:  # before the first is made: interrupted, the command without --again then takes none of them
        for file in files.values():
            file.unlink(missing_ok=True)
    found: dict[RolloutJob, RolloutLog | str] = {}
    for job in jobs:
        kept = read_rollout(files[job])
        if kept is not None:
            found[job] = kept
    todo = [job for job in jobs if job not in found]
    if found:
        announce(
            f"{folder}: kept {len(found)} of {len(jobs)} rollouts from an earlier command, without repeating them; "
            "--again repeats them"
        )
    progress(len(found), len(jobs))
    with contextlib.closing(_results(plan, todo, workers)) as results:
        for job, data in results:
            if data.startswith(FAILED):
                found[job] = data.removeprefix(FAILED).decode()
            else:
                write_atomically(files[job], data)
                found[job] = unpacked(data)
            progress(len(found), len(jobs))
    return [_run(plan, job, found[job], identities[job.policy]) for job in jobs]


def _results(plan: RolloutPlan, jobs: Sequence[RolloutJob], workers: int) -> Results[RolloutJob, bytes]:
    if workers > 1 and len(jobs) > 1:
        cores = max(1, default_workers() // min(workers, len(jobs)))
        return run_in_processes(partial(make_rollout, plan, cores=cores), jobs, workers, partial(_warm_up, plan))
    return run_here(partial(make_rollout, plan), jobs)


def _warm_up(plan: RolloutPlan) -> None:
    """Compile the kernels once; the other processes find them in the cache."""
    if plan.explore is None:
        from oysterbench.render.camera import warm_up

        warm_up("cpu")


def make_rollout(plan: RolloutPlan, job: RolloutJob, cores: int | None = None) -> bytes:
    """Make a rollout and return the contents of its file or, after FAILED, why the policy failed. cores: number of
    cores for the policy, where rollouts share a machine."""
    explore = plan.explore or _explore()
    try:
        policy = job.policy if job.policy in REFERENCES else PolicyProcess(job.policy, plan.limit_s, cores)
        log, _ = explore(plan.split, job.reef, policy, salt=plan.salt, seconds=plan.seconds, start=plan.start)
        if len(log.commands) < plan.steps:
            raise MethodError(
                f"method {_name(job.policy)!r} on {job.reef}: expected {plan.steps} commands, got {len(log.commands)}"
            )
    except MethodError as error:
        return FAILED + str(error).encode()
    if isinstance(policy, PolicyProcess):
        log = replace(log, cpu_s=log.cpu_s + policy.cpu_s)
    return packed(log)


def _explore() -> Explore:
    from oysterbench.exploration.rollout import explore  # loads the renderer

    return explore


def _policy(policy: str) -> dict[str, Any]:
    return {"reference": policy} if policy in REFERENCES else method_identity(policy)


def _name(policy: str) -> str:
    """Name in results: the policy's own, as over labelled images, however it was referred to."""
    return policy if policy in REFERENCES else find_method(policy).name


def _identity(plan: RolloutPlan, job: RolloutJob, policy: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "program": PROGRAM,
        "steering": steering_source(),
        "split": digest(plan.split, plan.salt),
        "reef": job.reef,
        "policy": policy,
        "seconds": plan.seconds,
        "start": plan.start,
    }


def _run(plan: RolloutPlan, job: RolloutJob, made: RolloutLog | str, policy: Mapping[str, Any]) -> RolloutRun:
    split = plan.split
    settings = {"rollout_s": plan.seconds, "start": plan.start}
    about = {
        **about_sequence(TRACK, split, job.reef, "", settings, EVALUATOR),
        "split_digest": digest(split, plan.salt),
        "method": _name(job.policy),
        "seed": policy.get("seed"),
        "method_settings": json.loads(json.dumps(policy.get("settings", {}), default=str)),
    }
    if isinstance(made, str):
        return RolloutRun(ResultRecord(**about, failure=made))
    assert split.steering is not None
    score = score_rollout(made, split.steering)
    about["truth_digest"] = hashlib.sha256(made.oysters.round(6).tobytes()).hexdigest()
    return RolloutRun(ResultRecord(**about, metrics=score.metrics, reasons=score.reasons), made)


def show_rollouts(runs: Sequence[RolloutRun], out: Path) -> Evaluation:
    """Show the policies over all reefs, their standings, and the reefs from above.

    Pairs by the ranking metric and classes of conditions appear only in the files: they would fill a screen.
    """
    first = [policies_table(runs)]
    if found := places(runs):
        first.insert(0, places_table(found))
    records = [run.record for run in runs]
    standings = [standings_table(board) for board in boards(records) if len(board.sequences) > 1]
    printed = [results_table(records), *standings, *first]
    return Evaluation(runs, first=first, printed=printed, figures=rollout_figures(runs, out))
