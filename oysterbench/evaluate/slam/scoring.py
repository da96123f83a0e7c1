"""Scoring a trajectory: association, alignment, absolute and relative errors, coverage, and the score."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, Similarity
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_frame
from oysterbench.evaluate.slam.alignment import Alignment, meet
from oysterbench.evaluate.slam.association import match_notes, rate_notes
from oysterbench.evaluate.slam.computation import (
    Matched,
    measure_alignment,
    measure_answers,
    measure_consistency,
    measure_drift,
    measure_recall,
    measure_relative,
    measure_segments,
    measure_velocity,
    sparse_note,
)
from oysterbench.evaluate.slam.consistency import Nees
from oysterbench.evaluate.slam.metrics import SLAM as METRICS
from oysterbench.evaluate.slam.pairs import distances
from oysterbench.evaluate.slam.pose_errors import absolute_errors, measure_absolute
from oysterbench.evaluate.slam.recall import Recall
from oysterbench.evaluate.slam.settings import SCALED, SlamSettings
from oysterbench.evaluate.slam.time_offset import estimate_offset, shift
from oysterbench.evaluate.slam.time_offset_notes import time_offset_notes
from oysterbench.evaluate.slam.validate import alignment_notes, attitude_notes, check_trajectory
from oysterbench.evaluate.values import Measures

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["EVALUATOR", "METRICS", "SlamResult", "SlamSettings", "score"]

EVALUATOR = "slam 3"
"""Name and version of this evaluator; the version rises whenever a published number may change (docs/versions.md)."""


@dataclass(frozen=True, repr=False)
class SlamResult:
    """Result of `score`.

    metrics:            values by keys of `METRICS`; NaN where there is no sample, with the reason in `reasons`
    notes:              what a reader of the numbers should know (suspected frames, little coverage), in sentences
    settings:           as they were used
    fit:                the alignment, its singular values and how well they determine it
    whole_truth:        all poses of the truth (T,)
    covered:            (T,) which of them the estimate covers
    truth, estimate:    matched poses (N,), the estimate aligned and at the truth's stamps
    error_m:            (N,) distance between the matched positions, m
    rotation_error_deg: (N,) angle between the matched attitudes, deg
    recall:             the recall curve, over all truth stamps; None where the truth does not move
    nees:               by part of the pose, at the last M of the matched stamps; empty without covariances
    """

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    notes: tuple[str, ...]
    settings: SlamSettings
    fit: Alignment
    whole_truth: Trajectory
    covered: NDArray[np.bool_]
    truth: Trajectory
    estimate: Trajectory
    error_m: Array
    rotation_error_deg: Array
    recall: Recall | None
    nees: Mapping[str, Nees]

    def __repr__(self) -> str:
        from oysterbench.evaluate.slam.display import outline

        return f"<SlamResult: {outline(self)}>"

    def _repr_html_(self) -> str:
        from oysterbench.evaluate.slam.display import result_card

        return result_card(self)

    def summary(self) -> pd.DataFrame:
        """All metrics, one row each, indexed by key: value, unit, better (higher, lower or empty), definition, and the
        reason where the value is NaN."""
        from oysterbench.evaluate.slam.display import result_table

        return result_table(self)

    @property
    def alignment(self) -> Similarity:
        """Similarity that maps the estimate's world frame to the truth's."""
        return self.fit.similarity

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps (N,) of the matched poses, ns."""
        return self.truth.stamps_ns


def score(truth: Trajectory, estimate: Trajectory, settings: SlamSettings | None = None) -> SlamResult:
    """Score an estimate against the truth: `score(truth, estimate, SlamSettings(align="se3")).metrics["ate_rmse_m"]`.

    The steps: check both, correct the clock, associate, align, measure. `METRICS` defines each number.
    Raises TrajectoryError, in one line, where numbers would be meaningless: poses that `check_trajectory` refuses,
    no common time, too few matched poses, an alignment that the motion does not determine.
    """
    settings = settings or SlamSettings()
    truth = check_trajectory(truth, "truth")
    estimate = check_trajectory(estimate, "estimate")
    notes = [*truth.notes, *estimate.notes]
    measures = Measures()
    T = estimate.T_body_estimate

    if settings.time_offset_s == "estimate":
        fixed = T if settings.align in SCALED else None
        offset = estimate_offset(poses_of_frame(truth, fixed), poses_of_frame(estimate, fixed))
        estimate = shift(estimate, offset.offset_s)
        measures["time_offset_s"] = offset.offset_s
        measures["time_offset_sigma_s"] = offset.sigma_s
        measures["time_offset_correlation"] = offset.correlation
        notes.append(
            f"{offset.offset_s:.4f} s were added to the estimate's timestamps, found from the {offset.signal}: "
            f"certain to {offset.sigma_s:.2g} s, with a correlation of {offset.correlation:.3f}"
        )
    else:
        estimate = shift(estimate, settings.time_offset_s)
        measures["time_offset_s"] = settings.time_offset_s

    met, fit = meet(truth, estimate, settings)
    aligned = Trajectory(
        met.truth.stamps_ns,
        fit.similarity.apply(met.estimate.positions),
        fit.similarity.rotate(met.estimate.quaternions),
    )
    absolute = absolute_errors(met.truth, aligned)
    if met.positions is met.estimate.positions:
        covered_m = absolute.translation_m
    else:
        covered_m = np.linalg.norm(fit.similarity.apply(met.positions) - truth.positions[met.covered], axis=1)
    matched = Matched(truth, met, aligned, absolute, covered_m, fit)
    path_m = distances(truth.positions)
    length_m = float(path_m[-1])
    curve = measure_recall(matched, settings, length_m, measures)
    measure_absolute(absolute, length_m, measures)
    measure_relative(matched, settings, path_m, measures)
    measure_segments(matched, settings, path_m, measures)
    measure_drift(matched, path_m, measures)
    measure_velocity(matched, settings, measures)
    measure_answers(matched, length_m, measures)
    measure_alignment(fit, settings, measures)
    consistency = measure_consistency(matched, settings, measures)

    if sparse := sparse_note(estimate, settings):
        notes.append(sparse)
    turned = T is not None and not np.allclose(T[:3, :3], np.eye(3))
    notes += attitude_notes(met.truth.quaternions, met.estimate.quaternions, fit.similarity, turned)
    seen = poses_of_frame(met.truth, T), poses_of_frame(met.estimate, met.estimate.T_body_estimate)
    notes += alignment_notes(seen[0].positions, seen[1].positions, settings.align, measures["ate_rmse_m"])
    notes += rate_notes(truth, estimate)
    notes += match_notes(truth, estimate, met, settings)
    if settings.time_offset_s == 0.0:
        notes += time_offset_notes(truth, estimate, met.truth, aligned, settings)
    notes += fit.notes
    notes += measures.notes
    return SlamResult(
        measures.values,
        measures.reasons,
        tuple(notes),
        settings,
        fit,
        truth,
        met.covered,
        met.truth,
        aligned,
        absolute.translation_m,
        np.rad2deg(absolute.rotation_rad),
        curve,
        consistency,
    )
