"""Metrics of trajectories: name, unit, direction and definition of each."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics, counted, higher, lower, neutral

RECALL_PERCENTS = (0.5, 1.0, 2.0, 5.0)
"""Position errors, % of the true path, at which recall is a metric of its own."""


def _consistency(part: str, freedom: int, of: str) -> dict[str, Metric]:
    """Metrics of one part of the pose, for estimates with covariances."""
    band = f"end of the 95 % chi-square band of nees_{part}, for errors independent in time."
    return {
        f"nees_{part}": neutral(f"NEES {part}")(
            f"Mean normalised estimation error squared, e^T C^-1 e, of the {of} with the estimate's covariance: "
            f"{freedom} if the covariances are right, more if they are too small. Aligned at the first matched pose, "
            "within the freedom of the alignment, not over the whole path."
        ),
        f"nees_{part}_low": neutral(f"NEES {part}, low")(f"Lower {band}"),
        f"nees_{part}_high": neutral(f"NEES {part}, high")(f"Upper {band}"),
        f"within_3sigma_{part}": neutral(f"3 sigma {part}")(
            f"Share (0 to 1) of matched timestamps at which the error of the {of} lies in the 3-sigma ellipsoid of the "
            "covariance; 0.9973 if the covariances are right."
        ),
    }


SLAM: dict[str, Metric] = {
    "score": higher("Score", column=Column("score"))(
        "Area (0 to 1) under the recall curve of the position error over ALL ground-truth poses, with missing ones "
        "counted as failures: the mean of 1 / (1 + e / e0), or 0 without an estimate, with e0 = 1 % of the true path "
        "(recall_scale_percent). An estimate that stops after a tenth scores below one that covers the whole path with "
        "ten times its error."
    ),
    **{
        f"recall_{percent:g}percent": higher(f"Recall {percent:g} %")(
            f"Share (0 to 1) of all ground-truth poses with a position error of at most {percent:g} % of the true "
            "path; missing ones are failures."
        )
        for percent in RECALL_PERCENTS
    },
    "ate_rmse_m": lower("ATE", "m", Column("ATE", "m", small=0.01))(
        "Absolute trajectory error: root mean square distance between true and aligned estimated positions over all "
        "matched ground-truth poses."
    ),
    "ate_percent": lower("ATE", "% of path", Column("ATE", "% path", 2, small=0.1))(
        "ATE (RMSE) as a percentage of the length of the whole true path."
    ),
    "ate_mean_m": lower("ATE mean", "m")("Mean of the distances behind ate_rmse_m."),
    "ate_median_m": lower("ATE median", "m")("Median of the distances behind ate_rmse_m."),
    "ate_max_m": lower("ATE max", "m")("Largest of the distances behind ate_rmse_m."),
    "ate_rotation_rmse_deg": lower("Rotation", "deg", Column("rot", "deg", 2, small=0.1))(
        "Root mean square angle of R_truth^T R_estimate over all matched ground-truth poses, with the estimate's "
        "attitudes rotated by the alignment."
    ),
    "ate_rotation_median_deg": lower("Rotation median", "deg")("Median of the angles behind ate_rotation_rmse_deg."),
    "ate_rotation_max_deg": lower("Rotation max", "deg")("Largest of the angles behind ate_rotation_rmse_deg."),
    "ate_yaw_rmse_deg": lower("Yaw", "deg")(
        "Root mean square yaw error: the angle about the vertical of R_estimate R_truth^T, split into a tilt about a "
        "level axis followed by a turn about the vertical."
    ),
    "ate_tilt_rmse_deg": lower("Gravity", "deg")(
        "Root mean square angle between the true direction of gravity and the one implied by the estimated attitude."
    ),
    "ate_rotation_part_rmse": lower("Rotation part")(
        "Root mean square Frobenius norm of R - I, with R the rotation of E = Q^-1 P (evo's rotation part)."
    ),
    "ate_full_rmse": lower("Full")(
        "Root mean square Frobenius norm of E - I, E = Q^-1 P, truth Q, aligned estimate P: metres and rotation in one "
        "number (evo's full transformation)."
    ),
    "rpe_1s_translation_rmse_m": lower("RPE 1 s translation", "m", Column("RPE trans", "m", small=0.01))(
        "Relative pose error over 1 s: root mean square translation of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), truth Q, aligned "
        "estimate P, over all pairs of matched ground-truth poses 1 s apart (or consecutive ones: rpe_pairs)."
    ),
    "rpe_1s_rotation_rmse_deg": lower("RPE 1 s rotation", "deg", Column("RPE rot", "deg", 2, small=0.1))(
        "Relative pose error over 1 s: root mean square rotation angle over the same pairs."
    ),
    "rpe_1s_pairs": counted("RPE 1 s pairs")("Number of pairs behind the relative errors over 1 s."),
    "subpath_translation_percent": lower("Drift", "%")(
        "Mean over all segments with an estimate at both ends, of all lengths, of the translation of (Q_i^-1 Q_j)^-1 "
        "(P_i^-1 P_j) as a "
        "percentage of the length; a segment ends at the first ground-truth timestamp more than its length further "
        "along the whole true path (KITTI)."
    ),
    "subpath_rotation_deg_per_m": lower("Drift rotation", "deg/m")(
        "Mean over the same segments of the rotation angle per length."
    ),
    "subpath_yaw_deg_per_m": lower("Drift yaw", "deg/m")(
        "Mean over the same segments of the yaw part of the rotation per length, about the vertical of the aligned "
        "estimate: where that is tilted, so is the axis."
    ),
    "subpath_tilt_deg_per_m": lower("Drift gravity", "deg/m")(
        "Mean over the same segments of the rest of the rotation per length: a tilt about a horizontal axis."
    ),
    "subpath_10m_translation_percent": lower("10 m", "%")(
        "Mean relative translation error per length over the estimated segments of 10 m."
    ),
    "subpath_10percent_translation_percent": lower("10 % of path", "%")(
        "Mean relative translation error per length over the estimated segments of 10 % of the true path."
    ),
    "subpath_segments": counted("Segments")("Number of segments with an estimate at both ends."),
    "subpath_coverage": higher("Segments answered")(
        "Share (0 to 1) of the segments of the true path with an estimate at both ends; no number where there is none."
    ),
    "subpath_scale": neutral("Scale of segments")(
        "Median over the same segments of the ratio of estimated to true distance between their ends, where these are "
        "at least 10 % of the length apart; 1 is right."
    ),
    "subpath_scale_error_percent": lower("Scale error", "%")("Median deviation of those ratios from 1."),
    "drift_percent": lower("End drift", "%")(
        "Position error at the last matched pose when the first is made to coincide with the true one, relative to the "
        "true path between them."
    ),
    "drift_deg_per_m": lower("End drift rotation", "deg/m")(
        "Attitude error at the last matched pose when the first is made to coincide with the true one, relative to the "
        "true path between them."
    ),
    "velocity_rmse_m_per_s": lower("Velocity", "m/s")(
        "Root mean square length of the difference between true and estimated mean velocity, in the true world frame, "
        "over "
        "velocity_step_s (0.2 s)."
    ),
    "coverage": higher("Coverage", column=Column("cover", "%", 1, factor=100.0))(
        "Share (0 to 1) of all ground-truth poses with an estimate: those at one of its poses (matched to one, with "
        "nearest association), or between two poses at most max_gap_s apart."
    ),
    "first_fix_s": lower("First fix", "s")("Time from the first ground-truth pose to the first one with an estimate."),
    "gaps": lower("Gaps")("Number of gaps without an estimate after the first fix."),
    "longest_gap_s": lower("Longest gap", "s")(
        "Longest gap: from the last ground-truth pose with an estimate before it to the first after it, or to the end."
    ),
    "matched": counted("Matched")("Number of ground-truth poses behind the errors."),
    "path_length_m": neutral("Path", "m")("Length of the whole true path."),
    "duration_s": neutral("Duration", "s")("Time from the first to the last ground-truth pose."),
    "scale": neutral("Scale")("Scale that the alignment applied to the estimate; 1 except for sim3 and scale."),
    "alignment_condition": neutral("Condition")(
        "How much better the path determines the best-determined rotation of the alignment than the worst (square root "
        "of the ratio of their stiffnesses; for posyaw, total over horizontal spread): 1 is best, unbounded for a line."
    ),
    "alignment_sigma_deg": neutral("Alignment sigma", "deg")(
        "Uncertainty of the least-determined rotation of the alignment: the estimate's error across the path's main "
        "direction over the distances that determine the rotation."
    ),
    "time_offset_s": neutral("Time offset", "s")("Time added to the estimate's timestamps."),
    "time_offset_sigma_s": neutral("Offset sigma", "s")("Standard deviation of an estimated time offset."),
    "time_offset_correlation": neutral("Offset fit")(
        "Correlation of true and estimated speed at an estimated time offset; 1 is certain."
    ),
    **{
        key: metric
        for part, freedom, of in (("position", 3, "position"), ("rotation", 3, "attitude"), ("pose", 6, "whole pose"))
        for key, metric in _consistency(part, freedom, of).items()
    },
    "realtime_factor": higher("Speed", column=Column("speed", "x", 1, small=0.1), limits=(0.0, math.inf))(
        "Duration of the sequence divided by the wall time of the method; above 1 it keeps up with the sensors."
    ),
    "wall_s": lower("Wall time", "s")("Wall time of the method."),
    "cpu_s": lower("CPU time", "s", Column("CPU", "s", 1))(
        "Processor time of the method, summed over its threads and processes."
    ),
    "cpu_s_per_s": lower("CPU", "s/s", Column("CPU", "s/s", 2, small=0.1))(
        "Processor time divided by the duration of the sequence: the cores it would keep busy at the sensors' pace."
    ),
    "peak_memory_mb": lower("Memory", "MB", Column("memory", "MB", 0))(
        "Peak resident memory (1e6 bytes) of the method's processes, including the surrounding program: the greater of "
        "the largest process's peak, as recorded by the kernel, and of their sum, sampled every 0.2 s."
    ),
}
"""Metrics of the SLAM track by their key, which ends in the unit, if there is one."""

_VARIED = {
    r"rpe_([0-9.e+-]+)(s|m|deg|frames)_(\w+)": ("rpe_1s_{2}", "1 s"),
    r"recall_([0-9.e+-]+)(percent)": ("recall_1percent", "1 %"),
    r"subpath_([0-9.e+-]+)(m)_translation_percent": ("subpath_10m_translation_percent", "10 m"),
    r"subpath_([0-9.e+-]+)(percent)_translation_percent": ("subpath_10percent_translation_percent", "10 %"),
}
"""Pattern of keys that contain a number and its unit -> the key that defines them all, and its number as text."""

_WRITTEN = {"percent": "%", "frames": "poses"}


def find_slam(key: str) -> Metric | None:
    """Return a metric over another time, path length, angle or share than those in `SLAM`; None for an unknown key."""
    for pattern, (defining, number) in _VARIED.items():
        match = re.fullmatch(pattern, key)
        if match and (defined := SLAM.get(defining.format("", "", match[3] if match.re.groups > 2 else ""))):
            mine = f"{match[1]} {_WRITTEN.get(match[2], match[2])}"
            if mine == "1 poses":
                mine = "1 pose"
            return replace(
                defined,
                definition=defined.definition.replace(number, mine),
                heading=defined.heading.replace(number, mine),
                column=None,
            )
    return None


TRACK = TrackMetrics(
    "SLAM",
    SLAM,
    table=(
        "score",
        "ate_rmse_m",
        "ate_rotation_rmse_deg",
        "rpe_1s_translation_rmse_m",
        "rpe_1s_rotation_rmse_deg",
        "coverage",
        "realtime_factor",
    ),
    standing=("coverage", "ate_percent", "ate_rotation_rmse_deg", "realtime_factor"),
    beside="ate_percent",
    failed={"score": 0.0, "coverage": 0.0},
    costs=("cpu_s_per_s", "peak_memory_mb"),
    wide=("rpe_1s_rotation_rmse_deg", "peak_memory_mb"),
    errors=(
        "ate_rmse_m",
        "ate_percent",
        "ate_rotation_rmse_deg",
        "rpe_1s_translation_rmse_m",
        "rpe_1s_rotation_rmse_deg",
    ),
    lost_below=0.25,
)
"""Errors in the standings are relative to the path, since they cover paths of different lengths. A dive is lost below
the score of an estimate that is off by 3 % of the path throughout, or that is right over a quarter of the dive."""
