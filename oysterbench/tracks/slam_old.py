"""A track, run: methods over the sequences of a split, each estimate scored and recorded."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2

from oysterbench.core.errors import MethodError, OysterbenchError, TrajectoryError
from oysterbench.core.trajectory import ReadOptions, Trajectory, write_tum
from oysterbench.evaluate.slam.inputs import read_pair
from oysterbench.evaluate.slam.scoring import EVALUATOR, SlamResult, SlamSettings, score
from oysterbench.methods import Method, run_method
from oysterbench.methods.outcomes import Job, Outcome
from oysterbench.recipe import SplitRecipe
from oysterbench.report import SlamRun
from oysterbench.results.records import ResultRecord
from oysterbench.sequence import Sequence, open_sequence
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import digest

FRAMES_IN_REPORT = 6
FRAME_WIDTH = 480  # px, in the report

PATH_METRICS = (
    "ate_rmse_m",
    "ate_percent",
    "ate_rotation_rmse_deg",
    "rpe_1s_translation_rmse_m",
    "coverage",
    "nees_position",
)
"""What is kept, as far as there is such, of the paths of a method that are not scored."""

Announce = Callable[[str], None]
"""Called with a sentence on what is being done."""


def evaluate_slam(
    split: SplitRecipe,
    files: dict[str, Path],
    methods: list[Method],
    settings: SlamSettings,
    announce: Announce = lambda text: None,
    folder: Path | None = None,
    times: int = 1,
) -> list[SlamRun]:
    """Run each method so many times on each sequence and score what it gives; estimates are kept in `folder` as TUM.

    A method that draws random numbers has the attribute `seed`, a whole number: run k is given its seed + k. A method
    that fails, or whose estimate cannot be scored, leaves a record with `failure`; the others go on.
    """
    first_seeds = {id(method): getattr(method, "seed", None) for method in methods}
    runs = []
    for name, path in files.items():
        sequence = open_sequence(path)
        truth = sequence.truth()
        frames = sample_frames(sequence)
        if folder is not None:
            write_tum(folder / f"{name}-truth.tum", truth)
        for method in methods:
            for k in range(times):
                counted = f", run {k + 1} of {times}" if times > 1 else ""
                announce(f"running {method.name} on {name}{counted}")
                seed = _give_seed(method, first_seeds[id(method)], k)
                record, result, estimate = _run(split, sequence, truth, method, settings, k, seed)
                if folder is not None and estimate is not None:
                    number = f"-{k + 1}" if times > 1 else ""
                    write_tum(folder / f"{name}-{method.name}{number}.tum", estimate)
                runs.append(SlamRun(record, result, frames))
    for method in methods:
        _give_seed(method, first_seeds[id(method)], 0)
    return runs


def _give_seed(method: Method, first: Any, k: int) -> int | None:
    """Seed run k of a method that takes one."""
    if not isinstance(first, int) or isinstance(first, bool):
        return None
    method.seed = first + k  # type: ignore[attr-defined]
    return first + k


def _run(
    split: SplitRecipe,
    sequence: Sequence,
    truth: Trajectory,
    method: Method,
    settings: SlamSettings,
    number: int,
    seed: int | None,
) -> tuple[ResultRecord, SlamResult | None, Trajectory | None]:
    record = {**_about(split, sequence.name, truth, settings), "method": method.name, "run": number, "seed": seed}
    try:
        run = run_method(method, sequence)
    except MethodError as error:
        return ResultRecord(**record, failure=str(error)), None, None
    cost = _cost(truth, run.wall_s, run.cpu_s)
    estimate = run.estimate.trajectory
    info = {**run.estimate.info, **paths_info(truth, run.estimate.scored, run.estimate.alternatives, settings)}
    return (*_scored(record, truth, estimate, settings, cost, info), estimate)


def record_outcome(
    split: SplitRecipe | None,
    truth: Trajectory,
    job: Job,
    outcome: Outcome,
    estimate: Trajectory | None,
    settings: SlamSettings,
    alternatives: Mapping[str, Trajectory] = MappingProxyType({}),
) -> tuple[ResultRecord, SlamResult | None]:
    """What the runner's job is worth. split: of the sequence, None for one that is of none; estimate, alternatives:
    where it did not fail."""
    record = {
        **_about(split, job.name, truth, settings),
        "method": job.entrant.name,
        "method_settings": job.entrant.settings,
        "run": job.number,
        "seed": outcome.identity["seed"],
        "hardware": outcome.hardware,
        "created": outcome.ended,
    }
    run = {key: getattr(outcome, key) for key in ("command", "versions", "limit_s", "process", "started")}
    info = {**outcome.info, "run": run, **paths_info(truth, outcome.scored, alternatives, settings)}
    if outcome.map is not None:
        info["map"] = dict(outcome.map)
    cost = {}
    if outcome.wall_s > 0:
        cost = _cost(truth, outcome.wall_s, outcome.cpu_s)
        cost["peak_memory_mb"] = outcome.process["peak_bytes"] / 1e6
    if outcome.failure is not None or estimate is None:
        return ResultRecord(
            **record, failure=outcome.failure, metrics=cost, notes=tuple(outcome.notes), info=info
        ), None
    # Said of the reading of its file; the one that is scored here has been read before.
    return _scored(record, truth, replace(estimate, notes=tuple(outcome.notes)), settings, cost, info)


def paths_info(
    truth: Trajectory, scored: str, alternatives: Mapping[str, Trajectory], settings: SlamSettings
) -> dict[str, Any]:
    """For the `info` of a record: which of a method's paths is scored, and what each other one reaches (PATH_METRICS).

    An alternative that cannot be scored has a `failure` in their place: it costs the scored path nothing.
    """
    if not scored and not alternatives:
        return {}
    reached: dict[str, dict[str, Any]] = {}
    for name, path in alternatives.items():
        try:
            metrics = score(truth, path, settings).metrics
            reached[name] = {key: metrics[key] for key in PATH_METRICS if key in metrics}
        except TrajectoryError as error:
            reached[name] = {"failure": str(error)}
    return {"paths": {"scored": scored, "alternatives": reached}}


def _about(split: SplitRecipe | None, sequence: str, truth: Trajectory, settings: SlamSettings) -> dict[str, Any]:
    """What every record of a sequence says."""
    return {
        "track": "slam",
        "split": "" if split is None else split.name,
        "split_digest": "" if split is None else digest(split),
        "sequence": sequence,
        "truth_digest": truth_digest(truth),
        "conditions": {} if split is None else conditions(split, sequence),
        "settings": settings.as_dict(),
        "evaluator_version": EVALUATOR,
    }


def _cost(truth: Trajectory, wall_s: float, cpu_s: float) -> dict[str, float]:
    duration = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    return {"wall_s": wall_s, "cpu_s": cpu_s, "realtime_factor": duration / wall_s}


def _scored(
    record: Mapping[str, Any],
    truth: Trajectory,
    estimate: Trajectory,
    settings: SlamSettings,
    cost: Mapping[str, float],
    info: Mapping[str, Any],
) -> tuple[ResultRecord, SlamResult | None]:
    try:
        result = score(truth, estimate, settings)
    except TrajectoryError as error:
        return ResultRecord(**record, failure=str(error), metrics=cost, info=info), None
    metrics = {**result.metrics, **cost}
    return ResultRecord(**record, metrics=metrics, reasons=result.reasons, notes=result.notes, info=info), result


def score_files(
    truth: Path,
    estimate: Path,
    settings: SlamSettings,
    truth_options: ReadOptions | None = None,
    estimate_options: ReadOptions | None = None,
) -> SlamRun:
    """Score one trajectory file against another; the options say what the files leave open."""
    any_scale = settings.align in ("sim3", "scale")
    pair = read_pair(truth, estimate, truth_options, estimate_options, settings.time_offset_s, any_scale)
    result = score(*pair, settings)
    record = ResultRecord(
        track="slam",
        split="",
        sequence=truth.name,
        method=estimate.name,
        truth_digest=truth_digest(pair[0]),
        metrics=result.metrics,
        reasons=result.reasons,
        notes=result.notes,
        settings=settings.as_dict(),
        evaluator_version=EVALUATOR,
    )
    return SlamRun(record, result, [])


def truth_digest(truth: Trajectory) -> str:
    """SHA-256 of stamps and poses: whether two results speak of one truth."""
    text = hashlib.sha256()
    for array in (truth.stamps_ns, truth.positions, truth.quaternions):
        text.update(array.tobytes())
    return text.hexdigest()


def sample_frames(sequence: Sequence) -> list[tuple[int, bytes]]:
    """A few frames of the first camera, evenly over the sequence: stamp in ns and a small JPEG."""
    camera = next(iter(sequence.cameras), None)
    if camera is None:
        return []
    stamps = [image.stamp_ns for image in sequence.images(camera)]
    wanted = {stamps[round(k * (len(stamps) - 1) / (FRAMES_IN_REPORT - 1))] for k in range(FRAMES_IN_REPORT)}
    frames = []
    for image in sequence.images(camera):
        if image.stamp_ns not in wanted:
            continue
        height, width = image.pixels.shape[:2]
        small = cv2.resize(
            image.pixels, (FRAME_WIDTH, round(height * FRAME_WIDTH / width)), interpolation=cv2.INTER_AREA
        )
        done, jpeg = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
        if not done:
            raise OysterbenchError(f"{sequence.name}: the frame at {image.stamp_ns} could not be encoded")
        frames.append((image.stamp_ns, jpeg.tobytes()))
    return frames
