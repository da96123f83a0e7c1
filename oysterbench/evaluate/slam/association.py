"""Association of an estimate's poses with the timestamps of the ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory, ns_to_seconds, too_wide
from oysterbench.core.trajectory.poses import nearest_stamps
from oysterbench.evaluate.slam.pairs import Index, run_of
from oysterbench.evaluate.slam.settings import MIN_MATCHED, SlamSettings

Stamps = NDArray[np.int64]

EDGE_NS = 1_000_000
"""Tolerance, ns, beyond the estimate's ends, within which its first and last pose count: files round timestamps."""

FEW = 0.9
"""If a smaller share of the poses that could be compared is matched, a note says so."""

SPARSE_S, SPARSE = 0.2, 5.0
"""A truth is sparse if its stamps are at least SPARSE_S, and SPARSE times the estimate's spacing, apart."""


@dataclass(frozen=True)
class Association:
    """Matched poses of truth and estimate.

    covered:    (T,) which truth stamps the estimate covers, with a pose or between two close ones
    associated: (N,) indices of the truth stamps that are compared; all of `covered` with interpolation
    truth:      (N,) poses of the truth at these stamps
    estimate:   (N,) poses of the estimate matched to them, with the truth's stamps
    positions:  (C, 3) m, positions of the estimate at the C covered stamps, before alignment
    by_first:   how many of the matched poses, from the first on, have the covariance of the same pose of the estimate
    """

    covered: NDArray[np.bool_]
    associated: Index
    truth: Trajectory
    estimate: Trajectory
    positions: Array
    by_first: int = 1


def associate(truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> Association:
    """Match an estimate to the truth's stamps. Raises TrajectoryError where they do not overlap or too few match."""
    check_overlap(truth, estimate, settings)
    covered = covered_stamps(truth.stamps_ns, estimate.stamps_ns, settings.max_gap_s)
    if settings.associate == "interpolate":
        associated = np.flatnonzero(covered)
        _check_matched(len(associated), truth, estimate, settings)
        same = len(associated) == len(estimate) and np.array_equal(truth.stamps_ns[associated], estimate.stamps_ns)
        matched = estimate if same else _interpolated(estimate, truth.stamps_ns[associated])
        every = truth if len(associated) == len(truth) else truth.select(run_of(associated))
        by_first = 1 if same else _number_at_first(estimate.stamps_ns, truth.stamps_ns[associated])
        return Association(covered, associated, every, matched, matched.positions, by_first)
    associated, taken = nearest_pairs(truth.stamps_ns, estimate.stamps_ns, settings.max_difference_s)
    _check_matched(len(associated), truth, estimate, settings)
    covered[associated] = True
    matched = estimate.select(taken)
    # Stamps between the associated ones may be covered as well: recall takes all of these into account.
    positions = np.empty((len(truth), 3))
    between_ns = np.clip(truth.stamps_ns[covered], estimate.stamps_ns[0], estimate.stamps_ns[-1])
    positions[covered] = _positions_at(estimate, between_ns)
    positions[associated] = matched.positions
    stamped = replace(matched, stamps_ns=truth.stamps_ns[associated])
    return Association(covered, associated, truth.select(associated), stamped, positions[covered])


def _interpolated(estimate: Trajectory, stamps_ns: Stamps) -> Trajectory:
    """Interpolate poses at covered stamps (N,); just beyond an end, take the pose at that end."""
    within_ns = np.clip(stamps_ns, estimate.stamps_ns[0], estimate.stamps_ns[-1])
    return replace(estimate.at(within_ns), stamps_ns=stamps_ns)


def _number_at_first(estimate_ns: Stamps, stamps_ns: Stamps) -> int:
    """How many of the increasing stamps (N,) are nearest to the same pose of the estimate (K,) as the first of them."""
    taken = nearest_stamps(estimate_ns, stamps_ns)
    return int(np.count_nonzero(taken == taken[0]))


def _positions_at(estimate: Trajectory, stamps_ns: Stamps) -> Array:
    seconds = (stamps_ns - estimate.stamps_ns[0]) * 1e-9
    known = (estimate.stamps_ns - estimate.stamps_ns[0]) * 1e-9
    return np.column_stack([np.interp(seconds, known, estimate.positions[:, k]) for k in range(3)])


def covered_stamps(stamps_ns: Stamps, estimate_ns: Stamps, max_gap_s: float) -> NDArray[np.bool_]:
    """Which stamps (N,) the estimate covers: on one of its poses, or between two that are at most max_gap_s apart.

    Stamps within EDGE_NS of its first or last pose are covered as well. Both inputs are int64 ns, increasing; returns
    (N,).
    """
    after = np.searchsorted(estimate_ns, stamps_ns, side="left")
    inside = (after > 0) & (after < len(estimate_ns))
    high = np.minimum(after, len(estimate_ns) - 1)
    low = np.maximum(after - 1, 0)
    close = inside & ~too_wide(estimate_ns[high] - estimate_ns[low], max_gap_s)
    at_an_end = np.minimum(np.abs(stamps_ns - estimate_ns[0]), np.abs(stamps_ns - estimate_ns[-1])) <= EDGE_NS
    return np.asarray(close | at_an_end | (estimate_ns[high] == stamps_ns))


def nearest_pairs(stamps_ns: Stamps, estimate_ns: Stamps, max_difference_s: float) -> tuple[Index, Index]:
    """Indices (M,) into stamps (N,) and into estimate stamps (K,), both increasing: the pairs nearest in time.

    Each stamp claims its nearest pose, if that is at most max_difference_s away; a pose goes to the nearest stamp that
    claims it, so that none is used twice.
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


@dataclass(frozen=True)
class Gaps:
    """Gaps in the estimate.

    first_fix_s: from the first truth stamp to the first covered one, s
    number:      number of runs of uncovered truth stamps after the first fix
    longest_s:   duration of the longest: from the last covered stamp before to the first after, or to the end of the
                 truth, s
    """

    first_fix_s: float
    number: int
    longest_s: float


def find_gaps(stamps_ns: Stamps, covered: NDArray[np.bool_]) -> Gaps:
    """Find the gaps in the coverage (T,) of truth stamps (T,), int64 ns; at least one stamp is covered."""
    associated = np.flatnonzero(covered)
    ends = np.append(associated[1:], len(stamps_ns))
    holes = np.flatnonzero(ends - associated > 1)
    last = np.minimum(ends[holes], len(stamps_ns) - 1)
    lengths_ns = stamps_ns[last] - stamps_ns[associated[holes]]
    return Gaps(
        float(stamps_ns[associated[0]] - stamps_ns[0]) * 1e-9,
        len(holes),
        float(lengths_ns.max(initial=0)) * 1e-9,
    )


def rate_notes(truth: Trajectory, estimate: Trajectory) -> list[str]:
    """Note on a truth whose stamps are so sparse that most of the estimate is not scored, if so."""
    asked_s, given_s = (float(np.median(np.diff(t.stamps_ns))) * 1e-9 for t in (truth, estimate))
    if asked_s < SPARSE_S or asked_s < SPARSE * given_s:
        return []
    return [
        f"the ground truth has {len(truth)} timestamps, {asked_s:.3g} s apart, for the estimate's "
        f"{len(estimate)} poses, {given_s:.3g} s apart: its motion between those timestamps is not scored"
    ]


def match_notes(truth: Trajectory, estimate: Trajectory, met: Association, settings: SlamSettings) -> list[str]:
    """Note on many poses that could have been compared but had no partner close enough, if so. With interpolation, all
    have one."""
    first, last = np.searchsorted(estimate.stamps_ns, [truth.stamps_ns[0], truth.stamps_ns[-1]])
    possible = min(int(met.covered.sum()), int(last - first))
    if len(met.associated) >= FEW * possible:
        return []
    return [
        f"errors are those of {len(met.associated)} poses, of {possible} that could be compared: the others found no "
        f"ground-truth timestamp of their own within {settings.max_difference_s:g} s (--max-difference); --associate "
        "interpolate needs none"
    ]


UNITS_NS = {"seconds": 10**9, "milliseconds": 10**6, "microseconds": 10**3}
"""Units that timestamps are given in by mistake -> nanoseconds."""


def check_overlap(truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> None:
    """Refuse two trajectories whose time spans do not overlap."""
    allowed_ns = round(settings.max_difference_s * 1e9) if settings.associate == "nearest" else 0
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    begin, end = int(estimate.stamps_ns[0]), int(estimate.stamps_ns[-1])
    if begin <= last + allowed_ns and end >= first - allowed_ns:
        return
    _check_unit(truth, estimate)
    offset = ns_to_seconds(abs(begin - first))
    raise TrajectoryError(
        f"truth and estimate do not overlap in time: the truth spans {ns_to_seconds(first)} to {ns_to_seconds(last)} "
        f"s, the estimate {ns_to_seconds(begin)} to {ns_to_seconds(end)} s and starts {offset} s "
        f"{'after' if begin > first else 'before'} it; both need the timestamps of the sensor data: correct the one "
        "that has others, or give the offset of the estimate's clock (--time-offset)"
    )


def _check_unit(truth: Trajectory, estimate: Trajectory) -> None:
    """Refuse an estimate whose timestamps, as a whole, are within the truth only in another unit than nanoseconds."""
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    begin, end = int(estimate.stamps_ns[0]), int(estimate.stamps_ns[-1])
    margin = (last - first) // 10  # it may begin before the truth, or end after it
    for unit, factor in UNITS_NS.items():
        if first - margin - factor <= begin * factor and end * factor <= last + margin:
            raise TrajectoryError(
                f"the estimate's timestamps, {begin} to {end} ns, do not match the truth's, but are within the truth "
                f"as {unit}: timestamps in memory are in nanoseconds; multiply them by {factor}"
            )


def _check_matched(matched: int, truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> None:
    """Refuse too few matched poses, and state what limits the matching."""
    if matched >= MIN_MATCHED:
        return
    if len(truth) < MIN_MATCHED:
        raise TrajectoryError(
            f"the ground truth has {len(truth)} poses, expected at least {MIN_MATCHED}: no estimate can be scored "
            "against it; give one with more poses"
        )
    if len(estimate) >= MIN_MATCHED:
        _check_unit(truth, estimate)
    step_s = float(np.median(np.diff(estimate.stamps_ns))) * 1e-9
    if settings.associate == "interpolate":
        why = (
            f"the estimate's {len(estimate)} poses are {step_s:.3g} s apart (median) and interpolated across gaps of "
            f"up to {settings.max_gap_s:g} s (--max-gap)"
        )
    else:
        why = (
            f"the estimate has {len(estimate)} poses and the nearest one may be {settings.max_difference_s:g} s away "
            "(--max-difference)"
        )
    todo = "give poses more often, or allow larger gaps"
    if len(estimate) < MIN_MATCHED:
        todo = f"it has {len(estimate)} poses and needs {MIN_MATCHED} at least: give one for each image"
    raise TrajectoryError(
        f"the estimate covers {matched} of {len(truth)} ground-truth timestamps, expected at least {MIN_MATCHED}: "
        f"{why}; {todo}"
    )
