"""Plausibility of the numbers of a result: each within its range, and those that follow from others consistent."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.slam.metrics import RECALL_PERCENTS
from oysterbench.results.records import ResultRecord

RELATIVE, ABSOLUTE = 1e-6, 1e-6
"""Tolerances within which numbers must fulfil a relation: results published by a server are rounded."""

MOST = 1e100
"""Greatest amount of any number: the sums and squares of greater ones could be infinite."""

COSTS: dict[str, tuple[float, float]] = {
    "wall_s": (1e-5, math.inf),
    "cpu_s": (1e-5, math.inf),
    "cpu_s_per_s": (0.0, 1e5),
    "peak_memory_mb": (1.0, 1e8),
    "realtime_factor": (0.0, 1e5),
    "steps_per_s": (0.0, 1e6),
    "pictures_per_s": (0.0, 1e6),
    "images_per_s": (0.0, 1e6),
}
"""Least and greatest cost of a run that was scored, far beyond anything measured: a day of dives in a second, a process
of one megabyte."""

Metrics = Mapping[str, float]


def check_plausible(record: ResultRecord, where: str = "result") -> None:
    """Raise ResultError, in one line, for the first impossible number.

    Passing proves nothing: carefully invented numbers pass too.
    """
    known = {key: float(value) for key, value in record.metrics.items() if not math.isnan(value)}
    for key, value in known.items():
        check_range(key, value, record.track, where, COSTS if record.failure is None else {})
    for keys, holds, relation in RELATIONS.get(record.track, ()):
        if all(key in known for key in keys) and not holds(*(known[key] for key in keys)):
            values = ", ".join(f"{key} = {known[key]:.6g}" for key in keys)
            raise ResultError(f"{where}: expected {relation}, got {values}")
    if record.track == "slam" and record.failure is None:
        _check_recalls(record, known, where)


def check_range(
    key: str, value: float, track: str, where: str, costs: Mapping[str, tuple[float, float]] | None = None
) -> None:
    """Raise ResultError where a metric's value is outside the range of the metric, or too great to be summed.

    costs: narrower ranges of some metrics
    """
    metric = find_metric(key, track)
    low, high = (-math.inf, math.inf) if metric is None else metric.range
    low, high = (costs or {}).get(key, (low, high))
    if not _above(value, low) or not _above(high, value):
        raise ResultError(f"{where}: metric {key!r}: expected {_between(low, high)}, got {value:.6g}")
    if abs(value) > MOST:
        raise ResultError(f"{where}: metric {key!r}: expected {-MOST:g} to {MOST:g}, got {value:.6g}")


def _between(low: float, high: float) -> str:
    if math.isinf(high):
        return f"{low:g} or more"
    return f"{high:g} or less" if math.isinf(low) else f"{low:g} to {high:g}"


def _above(value: float, low: float) -> bool:
    return value >= low - ABSOLUTE - RELATIVE * abs(low) if math.isfinite(low) else True


def _same(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=RELATIVE, abs_tol=ABSOLUTE)


def _least(greater: str, *keys: str) -> Iterator[tuple[tuple[str, ...], Callable[..., bool], str]]:
    for key in keys:
        yield (key, greater), lambda a, b: _above(b, a), f"{key} <= {greater}"


def _chain(*keys: str) -> Iterator[tuple[tuple[str, ...], Callable[..., bool], str]]:
    for less, greater in pairwise(keys):
        yield from _least(greater, less)


RELATIONS: dict[str, tuple[tuple[tuple[str, ...], Callable[..., bool], str], ...]] = {
    "slam": (
        *_chain("ate_mean_m", "ate_rmse_m", "ate_max_m"),
        *_least("ate_max_m", "ate_median_m"),
        *_least("ate_rotation_max_deg", "ate_rotation_median_deg", "ate_rotation_rmse_deg"),
        (
            ("ate_percent", "ate_rmse_m", "path_length_m"),
            lambda percent, ate, path: _same(percent * path, 100.0 * ate),
            "ate_percent = 100 ate_rmse_m / path_length_m",
        ),
        (
            ("realtime_factor", "wall_s", "duration_s"),
            lambda factor, wall, duration: math.isclose(factor * wall, duration, rel_tol=0.01),
            "realtime_factor = duration_s / wall_s",
        ),
        (
            ("cpu_s_per_s", "cpu_s", "duration_s"),
            lambda share, cpu, duration: math.isclose(share * duration, cpu, rel_tol=0.01),
            "cpu_s_per_s = cpu_s / duration_s",
        ),
    ),
    "segmentation": (
        *_least("precision", "iou"),
        *_least("recall", "iou"),
        (("dice", "iou"), lambda dice, iou: _same(dice * (1.0 + iou), 2.0 * iou), "dice = 2 iou / (1 + iou)"),
        *_least("best_iou", "iou"),
    ),
    "detection": (
        *_least("ap50_mask", "ap_mask"),
        *_least("ap50_box", "ap_box"),
        (("pq", "sq", "rq"), lambda pq, sq, rq: _same(pq, sq * rq), "pq = sq rq"),
        *_chain("count_mae", "count_rmse"),
        (("count_bias", "count_mae"), lambda bias, mae: _above(mae, abs(bias)), "|count_bias| <= count_mae"),
        (
            ("count_error", "count_estimate", "count_truth"),
            lambda error, estimate, truth: _same(error, estimate - truth),
            "count_error = count_estimate - count_truth",
        ),
    ),
    "density": (
        (
            ("cell_bias_per_m2", "cell_mae_per_m2"),
            lambda bias, mae: _above(mae, abs(bias)),
            "|cell_bias_per_m2| <= cell_mae_per_m2",
        ),
        (
            ("count_off_percent", "count_error_percent"),
            lambda off, error: _same(off, abs(error)),
            "count_off_percent = |count_error_percent|",
        ),
    ),
    "steering": (
        *_least("yaw_accuracy", "joint_accuracy"),
        *_least("pitch_accuracy", "joint_accuracy"),
        *_least("yaw_within_one", "yaw_accuracy"),
        *_least("pitch_within_one", "pitch_accuracy"),
    ),
}
"""Track -> keys, the relation that their values must fulfil, and its wording."""

BOUNDING = {"slam": ("score", "coverage", *(f"recall_{percent:g}percent" for percent in RECALL_PERCENTS))}
"""Track -> keys without which the score of a run cannot be checked."""


def _check_recalls(record: ResultRecord, known: Metrics, where: str) -> None:
    """Check that the recalls increase up to the coverage, and that the score, the mean of 1 / (1 + e / e0), lies
    between the least and the greatest value that they allow. Raises ResultError."""
    score, coverage, *recalls = BOUNDING[record.track]
    names = [*recalls, coverage]
    if any(key not in known for key in BOUNDING[record.track]):
        return
    for less, greater in pairwise(names):
        if not _above(known[greater], known[less]):
            got = f"{known[less]:.6g} and {known[greater]:.6g}"
            raise ResultError(f"{where}: expected {less} <= {greater}, got {got}")
    steps = [b - a for a, b in pairwise([0.0, *(known[name] for name in names)])]
    scale = float(record.settings.get("recall_scale_percent", 1.0))
    worth = [1.0 / (1.0 + percent / scale) for percent in (0.0, *RECALL_PERCENTS)] + [0.0]
    high = sum(step * most for step, most in zip(steps, worth, strict=False))
    low = sum(step * least for step, least in zip(steps, worth[1:], strict=True))
    if not _above(known[score], low) or not _above(high, known[score]):
        expected = f"expected {low:.4f} to {high:.4f}, got {known[score]:.6g}"
        raise ResultError(f"{where}: the score does not belong to the recalls: {expected}")
