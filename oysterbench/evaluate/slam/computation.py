"""The numbers of a scored trajectory, group by group."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory, too_wide
from oysterbench.evaluate.slam.alignment import Alignment
from oysterbench.evaluate.slam.association import Association, find_gaps
from oysterbench.evaluate.slam.consistency import Nees, nees
from oysterbench.evaluate.slam.metrics import RECALL_PERCENTS
from oysterbench.evaluate.slam.pairs import (
    Index,
    between,
    pairs_along,
    pairs_apart,
    pairs_over_frames,
    pairs_over_time,
    run_of,
    segments,
    turned,
)
from oysterbench.evaluate.slam.pose_errors import MIN_PATH_M, STILL, PoseErrors, relative_errors, rms
from oysterbench.evaluate.slam.recall import Recall, recall
from oysterbench.evaluate.slam.settings import SlamSettings
from oysterbench.evaluate.values import Measures

SUBPATH_PERCENTS = (10, 20, 30, 40, 50)
"""Default lengths of the segments, % of the true path (Zhang & Scaramuzza 2018, sec. VI)."""
MIN_CHORD = 0.1
"""Minimum distance between a segment's ends, as a share of its length, for the scale to be estimated from them."""


@dataclass(frozen=True)
class Matched:
    """An estimate associated with the truth and aligned to it.

    truth:     all poses of the truth (T,)
    met:       which of them are associated, and with which poses (N,)
    aligned:   the estimate's poses (N,), in the truth's world frame
    absolute:  their errors
    covered_m: (C,) position errors at all covered stamps, m
    fit:       the alignment
    """

    truth: Trajectory
    met: Association
    aligned: Trajectory
    absolute: PoseErrors
    covered_m: Array
    fit: Alignment


def measure_recall(matched: Matched, settings: SlamSettings, path_m: float, measures: Measures) -> Recall | None:
    """Measure the score and recall at some errors, and return the recall curve; None where the truth does not move.

    path_m: length of the true path
    """
    shares = [f"recall_{percent:g}percent" for percent in RECALL_PERCENTS]
    if path_m < MIN_PATH_M:
        measures.missing(STILL, "score", *shares)
        return None
    stamps = len(matched.truth)
    curve = recall(matched.covered_m, stamps, settings.recall_scale_percent / 100 * path_m)
    measures["score"] = curve.area
    for key, percent in zip(shares, RECALL_PERCENTS, strict=True):
        measures[key] = float(np.count_nonzero(matched.covered_m <= percent / 100 * path_m) / stamps)
    return curve


def measure_relative(matched: Matched, settings: SlamSettings, path_m: Array, measures: Measures) -> None:
    """Measure relative errors over frames, seconds, metres and degrees; path_m (T,) along the true path."""
    met, consecutive = matched.met, settings.rpe_pairs == "consecutive"
    frames, seconds = settings.rpe_frames, settings.rpe_delta_s
    metres, degrees = settings.rpe_delta_m, settings.rpe_delta_deg
    choices: dict[str, Callable[[], Index]] = {
        f"{frames}frames": lambda: pairs_over_frames(len(met.associated), frames, consecutive),
        f"{seconds:g}s": lambda: pairs_over_time(met.truth.stamps_ns, seconds, consecutive),
        f"{metres:g}m": lambda: pairs_along(path_m[met.associated], metres, consecutive),
        f"{degrees:g}deg": lambda: _pairs_over_angle(matched, settings),
    }
    for name, choose in choices.items():
        pairs = choose()
        keys = [f"rpe_{name}_translation_rmse_m", f"rpe_{name}_rotation_rmse_deg"]
        measures[f"rpe_{name}_pairs"] = len(pairs)
        if not len(pairs):
            measures.missing(f"no two matched poses are {_spaced(name)} apart", *keys)
            continue
        errors = relative_errors(met.truth, matched.aligned, pairs, matched.absolute)
        measures[keys[0]] = rms(errors.translation_m)
        measures[keys[1]] = rms(np.rad2deg(errors.rotation_rad))


def _pairs_over_angle(matched: Matched, settings: SlamSettings) -> Index:
    delta_rad = float(np.deg2rad(settings.rpe_delta_deg))
    if settings.rpe_angle == "direct":
        return pairs_apart(matched.met.truth.quaternions, delta_rad)
    angle = turned(matched.truth.quaternions)[matched.met.associated]
    return pairs_along(angle, delta_rad, settings.rpe_pairs == "consecutive")


def measure_segments(matched: Matched, settings: SlamSettings, path_m: Array, measures: Measures) -> None:
    """Measure errors over segments relative to their length, all segments weighted equally (Geiger et al. 2012)."""
    met, total_m = matched.met, float(path_m[-1])
    rank = np.full(len(path_m), -1)
    rank[met.associated] = np.arange(len(met.associated))
    if settings.subpath_m:
        lengths = {f"{length:g}m": float(length) for length in settings.subpath_m}
    else:
        lengths = {f"{percent}percent": percent / 100 * total_m for percent in SUBPATH_PERCENTS}
    turns = ("rotation", "yaw", "tilt")
    sums: dict[str, list[Array]] = {"translation_percent": [], **{f"{turn}_deg_per_m": [] for turn in turns}}
    ratios: list[Array] = []
    possible = 0
    for name, length_m in lengths.items():
        key = f"subpath_{name}_translation_percent"
        all_pairs = (
            segments(path_m, length_m, settings.subpath_step) if total_m >= MIN_PATH_M else np.empty((0, 2), int)
        )
        starts, ends = np.take(rank, all_pairs.T)
        pairs = np.stack([starts, ends])[:, (starts >= 0) & (ends >= 0)].T
        possible += len(all_pairs)
        if not len(pairs):
            measures.missing(_no_segment(length_m, total_m), key)
            continue
        errors = relative_errors(met.truth, matched.aligned, pairs, matched.absolute)
        percent = 100.0 / length_m * errors.translation_m
        measures[key] = float(np.mean(percent))
        sums["translation_percent"].append(percent)
        for turn in turns:
            sums[f"{turn}_deg_per_m"].append(np.rad2deg(getattr(errors, f"{turn}_rad")) / length_m)
        ratios.append(_scale_ratios(met.truth, matched.aligned, pairs, MIN_CHORD * length_m))
    keys = [f"subpath_{name}" for name in sums]
    measures["subpath_segments"] = sum(len(part) for part in sums["translation_percent"])
    if not sums["translation_percent"]:
        measures.missing(_no_segment(min(lengths.values()), total_m), *keys, "subpath_coverage")
    else:
        measures["subpath_coverage"] = measures["subpath_segments"] / possible
        for key, parts in zip(keys, sums.values(), strict=True):
            measures[key] = float(np.mean(np.concatenate(parts)))
    ratio = np.concatenate(ratios) if ratios else np.empty(0)
    if not len(ratio):
        reason = f"no segment has estimates at ends that are {MIN_CHORD:.0%} of its length apart"
        measures.missing(reason, "subpath_scale", "subpath_scale_error_percent")
        return
    measures["subpath_scale"] = float(np.median(ratio))
    measures["subpath_scale_error_percent"] = float(100.0 * np.median(np.abs(ratio - 1.0)))


def _scale_ratios(truth: Trajectory, estimate: Trajectory, pairs: Index, least_m: float) -> Array:
    """Ratio of estimated to true distance between the poses of pairs (M, 2) whose true distance is at least least_m."""
    i, j = run_of(pairs[:, 0]), run_of(pairs[:, 1])
    true_m, estimated_m = _lengths(between(truth.positions, i, j)), _lengths(between(estimate.positions, i, j))
    told = true_m >= least_m
    return np.asarray(estimated_m[told] / true_m[told])


def _no_segment(length_m: float, total_m: float) -> str:
    if total_m < MIN_PATH_M:
        return STILL
    if length_m >= total_m:
        return f"the true path of {total_m:.4g} m has no segment of {length_m:.4g} m"
    return f"no segment of {length_m:.4g} m has an estimate at both ends"


def measure_drift(matched: Matched, path_m: Array, measures: Measures) -> None:
    """Measure the error of the estimate at its last pose when its first pose is made to coincide with the truth."""
    met = matched.met
    path_length_m = float(path_m[met.associated[-1]] - path_m[met.associated[0]])
    if path_length_m < MIN_PATH_M:
        measures.missing(STILL, "drift_percent", "drift_deg_per_m")
        return
    ends = np.array([[0, len(met.associated) - 1]])
    errors = relative_errors(met.truth, matched.aligned, ends, matched.absolute)
    measures["drift_percent"] = 100.0 * float(errors.translation_m[0]) / path_length_m
    measures["drift_deg_per_m"] = float(np.rad2deg(errors.rotation_rad[0])) / path_length_m


def measure_velocity(matched: Matched, settings: SlamSettings, measures: Measures) -> None:
    """Measure the error of the mean velocity between poses velocity_step_s apart."""
    stamps, step_s = matched.met.truth.stamps_ns, settings.velocity_step_s
    pairs = pairs_over_time(stamps, step_s)
    if not len(pairs):
        measures.missing(f"no two matched poses are {step_s:g} s apart", "velocity_rmse_m_per_s")
        return
    i, j = pairs[:, 0], pairs[:, 1]
    off = matched.aligned.positions - matched.met.truth.positions
    seconds = (stamps[j] - stamps[i]) * 1e-9
    off = between(off, run_of(i), run_of(j))
    measures["velocity_rmse_m_per_s"] = rms(_lengths(off) / seconds)


def measure_answers(matched: Matched, path_m: float, measures: Measures) -> None:
    """Measure how much of the truth the estimate covers, and the gaps."""
    truth, covered = matched.truth, matched.met.covered
    gaps = find_gaps(truth.stamps_ns, covered)
    measures["coverage"] = float(np.mean(covered))
    measures["matched"] = len(matched.met.associated)
    measures["first_fix_s"] = gaps.first_fix_s
    measures["gaps"] = gaps.number
    measures["longest_gap_s"] = gaps.longest_s
    measures["path_length_m"] = path_m
    measures["duration_s"] = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    if measures["coverage"] < 0.5:
        measures.notes.append(f"the errors cover only {measures['coverage']:.0%} of the sequence")


SPARSE = 0.1
"""Share of an estimate's time within gaps that are too large from which they are told of, if they repeat."""


def sparse_note(estimate: Trajectory, settings: SlamSettings) -> str | None:
    """Say that an estimate's poses are often too rare to be interpolated: what lies between is not covered."""
    steps = np.diff(estimate.stamps_ns) * 1e-9
    wide = too_wide(np.diff(estimate.stamps_ns), settings.max_gap_s)
    few = np.count_nonzero(wide) < SPARSE * len(steps)  # single losses are gaps, which have numbers of their own
    if settings.associate != "interpolate" or few or steps[wide].sum() < SPARSE * steps.sum():
        return None
    return (
        f"{steps[wide].sum() / steps.sum():.0%} of the estimate's time lies between poses more than "
        f"{settings.max_gap_s:g} s apart (median {np.median(steps):.3g} s) and counts as not covered; give poses more "
        "often, or allow larger gaps (--max-gap)"
    )


def measure_alignment(fit: Alignment, settings: SlamSettings, measures: Measures) -> None:
    """Measure the scale of the alignment, and how well the path determines its rotation."""
    measures["scale"] = float(fit.similarity.scale)
    for key, value in (
        ("alignment_condition", fit.condition),
        ("alignment_sigma_deg", float(np.rad2deg(fit.sigma_rad))),
    ):
        if np.isnan(value):
            measures.missing(f"alignment {settings.align!r} fits no rotation to the path", key)
        elif np.isinf(value):
            measures.missing("truth and estimate have no motion in common that would determine a rotation", key)
        else:
            measures[key] = value


def measure_consistency(matched: Matched, settings: SlamSettings, measures: Measures) -> dict[str, Nees]:
    """Measure NEES and return it by part of the pose; empty if the estimate has no valid covariances, with a note where
    it has invalid ones."""
    if matched.met.estimate.covariances is None:
        return {}
    parts = ("position", "rotation", "pose")
    try:
        met = matched.met
        found = nees(met.truth, met.estimate, settings.align, matched.fit.similarity, met.by_first)
    except ValueError as error:
        measures.notes.append(f"NEES is not computed: {error}")
        for part in parts:
            names = ("", "_low", "_high")
            measures.missing(str(error), *(f"nees_{part}{name}" for name in names), f"within_3sigma_{part}")
        return {}
    for part, value in found.items():
        low, high = value.band
        measures[f"nees_{part}"] = value.mean
        measures[f"nees_{part}_low"] = low
        measures[f"nees_{part}_high"] = high
        measures[f"within_3sigma_{part}"] = value.within_3sigma
    return found


def _lengths(vectors: Array) -> Array:
    """Lengths (N,) of vectors (N, 3)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def _spaced(name: str) -> str:
    """Insert a space before the unit: "10deg" becomes "10 deg"."""
    return re.sub(r"(?<=[0-9.])(?=[a-z]+$)", " ", name)
