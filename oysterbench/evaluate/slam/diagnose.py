"""Mistakes in how an estimate was written, found by comparing it with the ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import scipy

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, align_umeyama, spread
from oysterbench.core.trajectory import Trajectory, ns_to_seconds
from oysterbench.core.trajectory.frames import ROTATION_BODY_OPTICAL, inverted
from oysterbench.core.trajectory.options import Order
from oysterbench.evaluate.slam.time_offset import estimate_offset
from oysterbench.evaluate.slam.validate import check_trajectory

SAMPLES = 2000
"""Number of poses compared: enough for every decision here, and the same for an hour as for a minute."""

FITS = 0.25
"""Rotations that err by less than this share of their size belong to the same motion."""
GAIN = 4.0
"""Factor by which another interpretation must fit better before it is believed."""
MIN_TURN_RAD = np.deg2rad(3.0)
"""Attitudes that rotate by less than this say nothing about their axes."""
USUAL_TURN_RAD = np.deg2rad(15.0)
"""Rotation between two compared attitudes that stands well above their noise and does not wrap."""
MIN_AXES = 0.05
"""Minimum ratio of the rotation about the second axis to that about the first that determines a constant rotation."""
LEVEL_RAD = np.deg2rad(10.0)
"""Tilt within which two attitudes agree on the direction of up."""
TILTED_RAD = np.deg2rad(30.0)
"""Tilt beyond which they do not."""

MILLI = 1000.0
SCALE_TOLERANCE = 0.1
"""Relative deviation from a scale of 1000, by drift of scale, up to which millimetres are still recognised."""
SHAPE = 0.1
"""Maximum error of positions along the same path, as a share of the truth's spread."""

ORDERS: tuple[tuple[Order, Order, list[int]], ...] = (("xyzw", "wxyz", [1, 2, 3, 0]), ("wxyz", "xyzw", [3, 0, 1, 2]))
"""Order in which quaternions were read, the one in which they may have been written, and the columns to take then."""

TIME_UNITS = {1e-9: "ns", 1e-6: "us", 1e-3: "ms", 1e9: "s"}
"""Factor that corrects stamps read in the wrong unit -> the unit that they are actually in.

Stamps are read as seconds where nothing else is known, and as nanoseconds in EuRoC files (the last entry).
"""

Cause = Literal[
    "time-unit",
    "no-overlap",
    "length-unit",
    "truth-length-unit",
    "inverted",
    "quaternion-order",
    "frame",
    "turned",
    "swapped",
]


@dataclass(frozen=True)
class Finding:
    """One suspicion about a pair of trajectories.

    cause:    its kind
    sentence: what was observed, with numbers
    decide:   what to type to settle it; empty if no option does
    changes:  `ReadOptions` of the estimate that would resolve it
    severity: `certain`: only one interpretation is possible, and it may be applied; `refuse`: scoring makes no sense
              before the user decides; `note`: worth a sentence
    """

    cause: Cause
    sentence: str
    decide: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    severity: Literal["certain", "refuse", "note"] = "note"

    def __str__(self) -> str:
        return f"{self.sentence} ({self.decide})" if self.decide else self.sentence


def diagnose(truth: Trajectory, estimate: Trajectory) -> list[Finding]:
    """List what is suspicious about an estimate; empty if nothing is.

    Raises TrajectoryError for poses that `check_trajectory` refuses.
    """
    # Comes first: stamps in a wrong unit may fail every check of stamps.
    if findings := _time_unit(truth, estimate):
        return findings
    truth, estimate = check_trajectory(truth, "truth"), check_trajectory(estimate, "estimate")
    if findings := _overlap(truth, estimate):
        return findings
    inside = (estimate.stamps_ns >= truth.stamps_ns[0]) & (estimate.stamps_ns <= truth.stamps_ns[-1])
    index = np.flatnonzero(inside)
    if len(index) > SAMPLES:
        index = index[np.linspace(0, len(index) - 1, SAMPLES).astype(int)]
    findings = _swapped(truth, estimate)
    if len(index) >= 3:
        taken = estimate.select(index)
        # Only the poses around the samples are needed: few of a long truth.
        after = np.searchsorted(truth.stamps_ns, taken.stamps_ns)
        there = truth.select(np.unique([np.maximum(after - 1, 0), after])).at(taken.stamps_ns)
        # If poses are inverted, their attitudes are no separate suspicion.
        findings += _inverted(there.positions, taken) or [
            *_unit(there.positions, taken.positions),
            *_attitude(there.quaternions, taken.quaternions),
        ]
    return findings


def _time_unit(truth: Trajectory, estimate: Trajectory) -> list[Finding]:
    """Check whether the two time spans overlap only if the estimate's stamps are in another unit."""
    if not len(truth) or not len(estimate):
        return []
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    begin, end = int(estimate.stamps_ns[0]), int(estimate.stamps_ns[-1])
    shares = {factor: _share(begin * factor, end * factor, first, last) for factor in (1.0, *TIME_UNITS)}
    best = max(TIME_UNITS, key=lambda factor: shares[factor])
    if shares[best] < 0.5 or shares[1.0] > 0.01:
        return []
    unit = TIME_UNITS[best]
    return [
        Finding(
            "time-unit",
            f"the timestamps, {ns_to_seconds(begin)} to {ns_to_seconds(end)} s as they were read, meet the truth's "
            f"{ns_to_seconds(first)} to {ns_to_seconds(last)} s when taken as {unit}",
            f"--time-unit {unit}",
            {"time_unit": unit},
            "refuse",
        )
    ]


def _overlap(truth: Trajectory, estimate: Trajectory) -> list[Finding]:
    """Check whether the two time spans overlap and, if not, which constant offset would make them."""
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    begin, end = int(estimate.stamps_ns[0]), int(estimate.stamps_ns[-1])
    if begin <= last and end >= first:
        return []
    try:
        offset = estimate_offset(truth, estimate)
        found = f"a constant offset of {offset.offset_s:.6f} s would match the motion (correlation "
        found += f"{offset.correlation:.2f})"
        offset_s = offset.offset_s
    except TrajectoryError:
        offset_s = (first - begin) * 1e-9
        found = f"a constant offset of {offset_s:.6f} s would let them begin together"
    return [
        Finding(
            "no-overlap",
            f"truth and estimate do not overlap in time: the truth spans {ns_to_seconds(first)} to "
            f"{ns_to_seconds(last)} s, the estimate {ns_to_seconds(begin)} to {ns_to_seconds(end)} s; {found}",
            f"--time-offset {offset_s:.6f}",
            severity="refuse",
        )
    ]


def _share(begin: float, end: float, first: float, last: float) -> float:
    """Overlap of two spans as a share of the longer one."""
    longer = max(end - begin, last - first)
    return max(min(end, last) - max(begin, first), 0.0) / longer if longer > 0 else 0.0


def _swapped(truth: Trajectory, estimate: Trajectory) -> list[Finding]:
    """Check whether the truth looks like an estimate: it covers less, more coarsely, or it alone has covariances."""
    seen = []
    spans = [int(t.stamps_ns[-1]) - int(t.stamps_ns[0]) for t in (truth, estimate)]
    inside = truth.stamps_ns[0] >= estimate.stamps_ns[0] and truth.stamps_ns[-1] <= estimate.stamps_ns[-1]
    if inside and spans[0] < 0.9 * spans[1] and len(truth) < 0.5 * len(estimate):
        seen.append(
            f"the truth has {len(truth)} poses over {spans[0] * 1e-9:.1f} s, all within the {spans[1] * 1e-9:.1f} s of "
            f"the estimate's {len(estimate)}"
        )
    if truth.covariances is not None and estimate.covariances is None:
        seen.append("the ground truth carries covariances and the estimate does not")
    if not seen:
        return []
    return [
        Finding("swapped", f"{'; '.join(seen)}: have the two been swapped?", "exchange --truth and --estimate if so")
    ]


def _inverted(truth: Array, estimate: Trajectory) -> list[Finding]:
    """Check whether matched poses have the shape of the true path (N, 3) only when they are inverted."""
    size = spread(truth)
    as_is = _misfit(truth, estimate.positions)
    turned_round = _misfit(truth, inverted(estimate).positions)
    if turned_round >= SHAPE * size or turned_round >= as_is / GAIN:
        return []
    return [
        Finding(
            "inverted",
            f"its positions have the shape of the true path when its poses are inverted (off by {turned_round:.3g} m "
            f"after alignment, {as_is:.3g} m as they are): do they take points of the world into the body or camera?",
            "--direction world-to-body, or --direction body-to-world to keep them",
            {"direction": "world-to-body"},
            "refuse",
        )
    ]


def _misfit(truth: Array, estimate: Array) -> float:
    """RMS distance, m, between matched paths (N, 3) after the most general alignment; infinite for a straight line."""
    try:
        return spread(align_umeyama(truth, estimate, with_scale=True).apply(estimate) - truth)
    except ValueError:  # a line has too little shape to tell
        return float("inf")


def _unit(truth: Array, estimate: Array) -> list[Finding]:
    """Check whether one of two matched paths (N, 3) is in millimetres."""
    sizes = spread(truth), spread(estimate)
    if min(sizes) <= 0:
        return []
    ratio = sizes[1] / sizes[0]
    for scale, cause, name, option in (
        (ratio, "length-unit", "estimate", "unit"),
        (1.0 / ratio, "truth-length-unit", "truth", "truth-unit"),
    ):
        if abs(scale / MILLI - 1.0) > SCALE_TOLERANCE:
            continue
        try:
            fit = align_umeyama(truth, estimate, with_scale=True)
            if spread(fit.apply(estimate) - truth) > SHAPE * sizes[0]:
                continue
        except ValueError:
            pass  # a straight line: only its length can be compared
        return [
            Finding(
                cause,  # type: ignore[arg-type]
                f"the {name}'s path is {scale:.0f} times as large as the other one: is it in millimetres?",
                f"--{option} mm, or --{option} m to keep it",
                {"unit": "mm"} if name == "estimate" else {},
                "refuse",
            )
        ]
    return []


def _attitude(truth: Array, estimate: Array) -> list[Finding]:
    """Check whether the attitudes, matched quaternions (N, 4), are in another order or of another frame.

    Rotations between poses do not depend on the world frame: if R_estimate = A R_truth X, with A between the world
    frames and X between the frames fixed to the vehicle, the rotation vector is X^T times the true one.
    """
    true_turns = _turns(truth, lag := _lag(truth))
    size = _rms(true_turns)
    if size < MIN_TURN_RAD:
        return _level(truth, estimate)
    turns = _turns(estimate, lag)
    as_is = _rms(turns - true_turns) / size
    optical = _rms(turns - true_turns @ ROTATION_BODY_OPTICAL) / size
    believed = min(FITS, as_is / GAIN)
    seen = f"the rotations between its poses are off by {as_is:.0%}"
    # Of a vehicle that stays level both orders give the rotations, but only one of them leaves it level.
    for read, written, columns in sorted(ORDERS, key=lambda order: _tilt(truth, estimate[:, order[2]])):
        reordered = _rms(_turns(estimate[:, columns], lag) - true_turns) / size
        if reordered >= believed:
            continue
        return [
            Finding(
                "quaternion-order",
                f"{seen} when the quaternions are read as {' '.join(read)}, and by {reordered:.1%} as "
                f"{' '.join(written)}",
                f"--quaternion {written}, or --quaternion {read} to keep them",
                {"quaternion": written},
                "certain",
            )
        ]
    if optical < believed:
        return [
            Finding(
                "frame",
                f"{seen}, and by {optical:.1%} if its poses are those of a camera's optical frame",
                "--frame optical, --T-body-estimate with the camera's place, or --frame body to keep them",
                {"frame": "optical"},
                "refuse",
            )
        ]
    turn = _constant_turn(true_turns, turns)
    if turn is None or (left := _rms(turns - turn.inv().apply(true_turns)) / size) >= believed:
        return []
    x, y, z, w = turn.as_quat(canonical=True)
    place = f"0,0,0,{x:.4f},{y:.4f},{z:.4f},{w:.4f}"
    matrix = np.eye(4)
    matrix[:3, :3] = turn.as_matrix()
    return [
        Finding(
            "turned",
            f"{seen}, and by {left:.1%} if its poses are those of a frame rotated by a constant "
            f"{np.rad2deg(turn.magnitude()):.1f} deg with respect to the body",
            f"--T-body-estimate {place}, with the frame's place for the zeros, or --frame body to keep them",
            {"T_body_estimate": matrix},
            "refuse",
        )
    ]


def _lag(truth: Array) -> int:
    """Choose the number of poses over which to take rotations: the fewest over which the median is large enough, else
    that with the largest median."""
    lags = sorted({lag for k in range(11) if (lag := 2**k) < len(truth)} | {1})
    sizes = {lag: float(np.median(np.linalg.norm(_turns(truth, lag), axis=1))) for lag in lags}
    return next((lag for lag in lags if sizes[lag] >= USUAL_TURN_RAD), max(lags, key=lambda lag: sizes[lag]))


def _turns(quaternions: Array, lag: int) -> Array:
    """Rotation vectors (N - lag, 3) in rad from each attitude to the one `lag` poses later."""
    rotations = scipy.spatial.transform.Rotation.from_quat(quaternions)
    return np.asarray((rotations[:-lag].inv() * rotations[lag:]).as_rotvec())


def _constant_turn(true_turns: Array, turns: Array) -> scipy.spatial.transform.Rotation | None:
    """Fit the rotation X in turns = X^T true_turns (Wahba 1965); None if they are all about one axis."""
    u, d, vt = np.linalg.svd(true_turns.T @ turns)
    if d[1] < MIN_AXES**2 * d[0]:
        return None
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return scipy.spatial.transform.Rotation.from_matrix(u @ np.diag([1.0, 1.0, sign]) @ vt)


def _level(truth: Array, estimate: Array) -> list[Finding]:
    """Check attitudes that hardly rotate by their direction of up; this requires z up in both world frames."""
    tilts = {
        name: _tilt(truth, quaternions, fixed)
        for name, quaternions, fixed in (
            ("as they are", estimate, None),
            *((f"as {' '.join(written)}", estimate[:, columns], None) for _, written, columns in ORDERS),
            ("as those of an optical frame", estimate, ROTATION_BODY_OPTICAL),
        )
    }
    (_, as_is), *others = tilts.items()
    if as_is < TILTED_RAD:
        return []
    decisions: tuple[tuple[Cause, str, dict[str, Any]], ...] = (
        ("quaternion-order", "--quaternion wxyz or xyzw", {"quaternion": "wxyz"}),
        ("quaternion-order", "--quaternion xyzw or wxyz", {"quaternion": "xyzw"}),
        ("frame", "--frame optical or body", {"frame": "optical"}),
    )
    likely = sorted(
        (tilt, name, *decision) for (name, tilt), decision in zip(others, decisions, strict=True) if tilt < LEVEL_RAD
    )
    if not likely:
        return []
    seen = " and ".join(f"by {np.rad2deg(tilt):.0f} deg {name}" for tilt, name, *_ in likely)
    return [
        Finding(
            likely[0][2],
            f"its attitudes tilt by {np.rad2deg(as_is):.0f} deg against the true ones as they are, {seen}, and turn "
            "too little to tell why",
            ", ".join(decide for *_, decide, _ in likely),
            likely[0][4],
            "refuse",
        )
    ]


def _tilt(truth: Array, estimate: Array, fixed: Array | None = None) -> float:
    """Median angle, rad, between the directions of up of matched attitudes (N, 4), the estimate's those of a frame that
    is rotated by `fixed` (3, 3) with respect to the body."""
    up, its_up = (
        scipy.spatial.transform.Rotation.from_quat(quaternions).inv().apply([0.0, 0.0, 1.0])
        for quaternions in (truth, estimate)
    )
    its_up = its_up if fixed is None else its_up @ fixed.T
    return float(np.median(np.arccos(np.clip(np.einsum("ij,ij->i", up, its_up), -1.0, 1.0))))


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))
