"""Scoring a trajectory: association, alignment, absolute and relative errors, coverage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.errors import TrajectoryError
from oysterbench.evaluate.metrics import SLAM as METRICS
from oysterbench.evaluate.validate import alignment_notes, attitude_notes, check_trajectory
from oysterbench.geometry import (
    IDENTITY,
    Array,
    Similarity,
    align_origin,
    align_umeyama,
    align_yaw,
    invert,
    rotation_angle,
)
from oysterbench.trajectory import Trajectory, ns_to_seconds

__all__ = ["EVALUATOR", "METRICS", "SlamResult", "SlamSettings", "relative_errors", "score"]

EVALUATOR = "slam 1"
"""Name and version of this evaluator; the version rises whenever a number may change."""

MIN_MATCHED = 5
"""Fewer poses are fitted by the alignment rather than scored: three are 9 numbers, of which sim3 fits 7."""

RPE_TOLERANCE = 0.05
"""Of rpe_delta_s: how far a pair's distance in time may be from it, where no stamp falls on start + rpe_delta_s."""

MIN_PATH_M = 1e-3
"""A shorter path has no percentages."""

Align = Literal["none", "origin", "se3", "posyaw", "sim3"]
Associate = Literal["interpolate", "nearest"]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class SlamSettings:
    """How an estimate is brought to the truth.

    align:            none; origin (first matched pose); posyaw (translation and yaw, the freedom that a
                      gravity-aware method has); se3 (translation and rotation); sim3 (and scale: monocular)
    associate:        interpolate the estimate at the truth stamps, or take the nearest pose
    max_gap_s:        the estimate is interpolated only between poses that are this close
    max_difference_s: between a truth stamp and its nearest pose
    rpe_delta_s:      over which time relative errors are taken
    """

    align: Align = "posyaw"
    associate: Associate = "interpolate"
    max_gap_s: float = 0.3
    max_difference_s: float = 0.01
    rpe_delta_s: float = 1.0

    def __post_init__(self) -> None:
        for key, value, options in (
            ("align", self.align, get_args(Align)),
            ("associate", self.associate, get_args(Associate)),
        ):
            if value not in options:
                raise TrajectoryError(f"evaluator setting {key!r}: expected one of {', '.join(options)}, got {value!r}")
        for key in ("max_gap_s", "max_difference_s", "rpe_delta_s"):
            if not 0 < getattr(self, key) < float("inf"):
                raise TrajectoryError(f"evaluator setting {key!r}: expected more than 0 s, got {getattr(self, key)!r}")

    def as_dict(self) -> dict[str, Any]:
        """The settings for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class SlamResult:
    """What `score` gives.

    metrics:            values by keys of `METRICS`; NaN where there is no sample, with the reason in `reasons`
    notes:              what a reader of the numbers should know (suspected frames, little coverage), in sentences
    settings:           as they were used
    alignment:          takes the estimate's world into the truth's
    whole_truth:        all poses of the truth (T,)
    truth, estimate:    matched poses (N,), the estimate aligned and at the truth's stamps
    error_m:            (N,) distance of the matched positions, m
    rotation_error_deg: (N,) angle between the matched attitudes, deg
    """

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    notes: tuple[str, ...]
    settings: SlamSettings
    alignment: Similarity
    whole_truth: Trajectory
    truth: Trajectory
    estimate: Trajectory
    error_m: Array
    rotation_error_deg: Array

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(N,) stamps of the matched poses, ns."""
        return self.truth.stamps_ns


def score(truth: Trajectory, estimate: Trajectory, settings: SlamSettings | None = None) -> SlamResult:
    """Score an estimate against the truth.

    Raises TrajectoryError, in one line, where a number would mean nothing: poses that `check_trajectory` refuses,
    no common time, too few matched poses, an alignment that the motion does not determine.
    """
    settings = settings or SlamSettings()
    truth = check_trajectory(truth, "truth")
    estimate = check_trajectory(estimate, "estimate")
    _check_overlap(truth, estimate, settings)

    covered = covered_stamps(truth.stamps_ns, estimate.stamps_ns, settings.max_gap_s)
    if settings.associate == "interpolate":
        answered = np.flatnonzero(covered)
        _check_matched(len(answered), truth, estimate, settings)
        matched_estimate = estimate.at(truth.stamps_ns[answered])
    else:
        answered, taken = nearest_pairs(truth.stamps_ns, estimate.stamps_ns, settings.max_difference_s)
        _check_matched(len(answered), truth, estimate, settings)
        covered[answered] = True
        matched_estimate = estimate.select(taken)
    matched_truth = truth.select(answered)

    alignment = _align(matched_truth, matched_estimate, settings.align)
    aligned = Trajectory(
        matched_truth.stamps_ns,
        alignment.apply(matched_estimate.positions),
        alignment.rotate(matched_estimate.quaternions),
    )
    error_m = np.linalg.norm(aligned.positions - matched_truth.positions, axis=1)
    rotation_error_deg = np.rad2deg(rotation_angle(matched_truth.quaternions, aligned.quaternions))
    pairs = pairs_over_time(matched_truth.stamps_ns, settings.rpe_delta_s)
    rpe_m, rpe_rad = relative_errors(matched_truth.matrices, aligned.matrices, pairs)

    reasons: dict[str, str] = {}
    path_m = truth.path_length
    if path_m < MIN_PATH_M:
        reasons["ate_percent"] = "the truth does not move: there is no path to take a percentage of"
    delta = f"rpe_{settings.rpe_delta_s:g}s"
    if not len(pairs):
        for key in (f"{delta}_translation_rmse_m", f"{delta}_rotation_rmse_deg"):
            reasons[key] = f"no two matched poses are {settings.rpe_delta_s:g} s apart (within {RPE_TOLERANCE:.0%})"
    metrics = {
        "ate_rmse_m": _rms(error_m),
        "ate_percent": 100.0 * _rms(error_m) / path_m if path_m >= MIN_PATH_M else np.nan,
        "ate_mean_m": float(np.mean(error_m)),
        "ate_median_m": float(np.median(error_m)),
        "ate_max_m": float(np.max(error_m)),
        "ate_rotation_rmse_deg": _rms(rotation_error_deg),
        "ate_rotation_median_deg": float(np.median(rotation_error_deg)),
        "ate_rotation_max_deg": float(np.max(rotation_error_deg)),
        f"{delta}_translation_rmse_m": _rms(rpe_m),
        f"{delta}_rotation_rmse_deg": _rms(np.rad2deg(rpe_rad)),
        f"{delta}_pairs": len(pairs),
        "coverage": float(np.mean(covered)),
        "matched": len(answered),
        "path_length_m": path_m,
        "duration_s": float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9,
        "scale": float(alignment.scale),
    }
    notes = attitude_notes(matched_truth.quaternions, matched_estimate.quaternions, alignment)
    notes += alignment_notes(matched_truth.positions, matched_estimate.positions, settings.align, metrics["ate_rmse_m"])
    if metrics["coverage"] < 0.5:
        notes.append(f"the errors speak of {metrics['coverage']:.0%} of the sequence only")
    return SlamResult(
        metrics,
        reasons,
        tuple(notes),
        settings,
        alignment,
        truth,
        matched_truth,
        aligned,
        error_m,
        rotation_error_deg,
    )


def covered_stamps(stamps_ns: NDArray[np.int64], estimate_ns: NDArray[np.int64], max_gap_s: float) -> NDArray[np.bool_]:
    """Which stamps (N,) the estimate answers: on one of its poses, or between two that are at most max_gap_s apart.

    Both are int64 ns, increasing; returns (N,).
    """
    after = np.searchsorted(estimate_ns, stamps_ns, side="left")
    inside = (after > 0) & (after < len(estimate_ns))
    high = np.minimum(after, len(estimate_ns) - 1)
    low = np.maximum(after - 1, 0)
    gap = estimate_ns[high] - estimate_ns[low]
    return (inside & (gap <= round(max_gap_s * 1e9))) | (estimate_ns[high] == stamps_ns)


def nearest_pairs(
    stamps_ns: NDArray[np.int64], estimate_ns: NDArray[np.int64], max_difference_s: float
) -> tuple[Index, Index]:
    """Indices (M,) into stamps (N,) and into estimate stamps (K,), both increasing: the pairs nearest in time.

    Each stamp asks for its nearest pose, if that is at most max_difference_s away; a pose goes to the nearest of
    those that ask for it, so that none is used twice.
    """
    after = np.clip(np.searchsorted(estimate_ns, stamps_ns), 1, len(estimate_ns) - 1)
    before_is_nearer = stamps_ns - estimate_ns[after - 1] <= estimate_ns[after] - stamps_ns
    nearest = after - before_is_nearer
    difference = np.abs(estimate_ns[nearest] - stamps_ns)
    asking = np.flatnonzero(difference <= round(max_difference_s * 1e9))
    by_pose = asking[np.lexsort((difference[asking], nearest[asking]))]
    _, first = np.unique(nearest[by_pose], return_index=True)
    winners = np.sort(by_pose[first])
    return winners, nearest[winners]


def pairs_over_time(stamps_ns: NDArray[np.int64], delta_s: float) -> Index:
    """Index pairs (M, 2) of stamps (N,) that lie delta_s apart, from every start that has such an end.

    The end is the stamp nearest to start + delta_s, if within half the median step, so that the last starts do not
    take an earlier end instead of none, and within RPE_TOLERANCE of delta_s.
    """
    delta_ns = round(delta_s * 1e9)
    ends_ns = stamps_ns + delta_ns
    after = np.clip(np.searchsorted(stamps_ns, ends_ns), 1, len(stamps_ns) - 1)
    ends = after - (ends_ns - stamps_ns[after - 1] <= stamps_ns[after] - ends_ns)
    starts = np.arange(len(stamps_ns))
    allowed_ns = min(RPE_TOLERANCE * delta_ns, 0.5 * float(np.median(np.diff(stamps_ns))))
    fits = (np.abs(stamps_ns[ends] - ends_ns) <= allowed_ns) & (ends > starts)
    return np.column_stack([starts[fits], ends[fits]])


def relative_errors(truth: Array, estimate: Array, pairs: Index) -> tuple[Array, Array]:
    """Translation (M,) in m and rotation angle (M,) in rad of E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).

    truth Q and estimate P are (N, 4, 4) transforms at the same stamps, pairs (M, 2) their indices i, j
    (Sturm et al. 2012, eq. 2).
    """
    if not len(pairs):
        return np.empty(0), np.empty(0)
    i, j = pairs[:, 0], pairs[:, 1]
    true_motion = invert(truth[i]) @ truth[j]
    estimated_motion = invert(estimate[i]) @ estimate[j]
    error = invert(true_motion) @ estimated_motion
    return np.linalg.norm(error[:, :3, 3], axis=1), Rotation.from_matrix(error[:, :3, :3]).magnitude()


def _align(truth: Trajectory, estimate: Trajectory, align: Align) -> Similarity:
    """The alignment of matched poses. Raises TrajectoryError where the motion does not determine it."""
    if align == "none":
        return IDENTITY
    if align == "origin":
        return align_origin(truth.matrices[0], estimate.matrices[0])
    try:
        if align == "posyaw":
            return align_yaw(truth.positions, estimate.positions)
        return align_umeyama(truth.positions, estimate.positions, with_scale=align == "sim3")
    except ValueError as error:
        others = "origin or none" if align == "posyaw" else "posyaw, origin or none"
        raise TrajectoryError(
            f"estimate cannot be aligned to the truth by {align!r}: {error}; choose another alignment ({others})"
        ) from None


def _check_overlap(truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> None:
    """Refuse two time spans that do not meet."""
    allowed_ns = round(settings.max_difference_s * 1e9) if settings.associate == "nearest" else 0
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    begin, end = int(estimate.stamps_ns[0]), int(estimate.stamps_ns[-1])
    if begin <= last + allowed_ns and end >= first - allowed_ns:
        return
    offset = ns_to_seconds(abs(begin - first))
    raise TrajectoryError(
        f"truth and estimate do not overlap in time: the truth spans {ns_to_seconds(first)} to {ns_to_seconds(last)} "
        f"s, the estimate {ns_to_seconds(begin)} to {ns_to_seconds(end)} s and starts {offset} s "
        f"{'after' if begin > first else 'before'} it; write the stamps of the sensor data into the estimate"
    )


def _check_matched(matched: int, truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> None:
    """Refuse too few matched poses, and say what keeps them from matching."""
    if matched >= MIN_MATCHED:
        return
    step_s = float(np.median(np.diff(estimate.stamps_ns))) * 1e-9
    if settings.associate == "interpolate":
        why = (
            f"the estimate's {len(estimate)} poses are {step_s:.3g} s apart (median) and interpolated across gaps of "
            f"up to max_gap_s = {settings.max_gap_s:g}"
        )
    else:
        why = (
            f"the estimate has {len(estimate)} poses and the nearest one may be max_difference_s = "
            f"{settings.max_difference_s:g} away"
        )
    raise TrajectoryError(
        f"estimate answers {matched} of {len(truth)} truth stamps, expected at least {MIN_MATCHED}: {why}; give poses "
        "more often, or allow more"
    )


def _rms(values: Array) -> float:
    """Root mean square; NaN for an empty sample."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
