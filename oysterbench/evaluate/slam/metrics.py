"""What is measured of trajectories: name, unit, direction and definition of every metric."""

from __future__ import annotations

import re
from dataclasses import replace

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics


def _consistency(part: str, freedom: int, of: str) -> dict[str, Metric]:
    """Metrics of one part of the pose, where the estimate has covariances."""
    band = f"end of the 95 % chi-square band of nees_{part}, for errors that are independent in time."
    return {
        f"nees_{part}": Metric(
            f"Mean normalised estimation error squared, e^T C^-1 e, of the {of} with the estimate's covariance: "
            f"{freedom} where the covariances are right, more where they promise too much. Aligned by the first "
            "matched pose, in the freedom of the alignment, and not over the whole path.",
            f"NEES {part}",
        ),
        f"nees_{part}_low": Metric(f"Lower {band}", f"NEES {part}, low"),
        f"nees_{part}_high": Metric(f"Upper {band}", f"NEES {part}, high"),
        f"within_3sigma_{part}": Metric(
            f"Share (0 to 1) of matched stamps at which the error of the {of} lies in the 3-sigma ellipsoid of the "
            "covariance; 0.9973 where the covariances are right.",
            f"3 sigma {part}",
        ),
    }


SLAM: dict[str, Metric] = {
    "score": Metric(
        "Area (0 to 1) under the recall curve of the position error over ALL truth stamps, unanswered ones counted as "
        "failures: the mean of 1 / (1 + e / e0), 0 where there is no answer, with e0 = 1 % of the true path "
        "(recall_scale_percent). An estimate that stops after a tenth is below one that ends with ten times its error.",
        "Score",
        better="higher",
        column=Column("score", "", small=0.0),
    ),
    **{
        f"recall_{percent}percent": Metric(
            f"Share (0 to 1) of all truth stamps at which the position errs by at most {percent} % of the true path; "
            "unanswered ones are failures.",
            f"Recall {percent} %",
            better="higher",
        )
        for percent in ("0.5", "1", "2", "5")
    },
    "ate_rmse_m": Metric(
        "Absolute trajectory error: root mean square distance between true and aligned estimated position over all "
        "matched truth stamps.",
        "ATE",
        unit="m",
        better="lower",
        column=Column("ATE", "m", small=0.01),
    ),
    "ate_percent": Metric(
        "ATE (RMSE) as a percentage of the length of the whole true path.",
        "ATE of path",
        unit="%",
        better="lower",
        column=Column("ATE", "%", digits=2),
    ),
    "ate_mean_m": Metric("Mean of the distances that ate_rmse_m is taken over.", "ATE mean", unit="m", better="lower"),
    "ate_median_m": Metric(
        "Median of the distances that ate_rmse_m is taken over.", "ATE median", unit="m", better="lower"
    ),
    "ate_max_m": Metric("Largest of the distances that ate_rmse_m is taken over.", "ATE max", unit="m", better="lower"),
    "ate_rotation_rmse_deg": Metric(
        "Root mean square angle of R_truth^T R_estimate over all matched truth stamps, the estimate's attitudes turned "
        "by the alignment.",
        "Rotation",
        unit="deg",
        better="lower",
        column=Column("rot", "deg", digits=2),
    ),
    "ate_rotation_median_deg": Metric(
        "Median of the angles that ate_rotation_rmse_deg is taken over.", "Rotation median", unit="deg", better="lower"
    ),
    "ate_rotation_max_deg": Metric(
        "Largest of the angles that ate_rotation_rmse_deg is taken over.", "Rotation max", unit="deg", better="lower"
    ),
    "ate_yaw_rmse_deg": Metric(
        "Root mean square yaw error: the angle about the vertical of R_estimate R_truth^T, taken as a tilt about a "
        "level axis followed by a turn about the vertical.",
        "Yaw",
        unit="deg",
        better="lower",
    ),
    "ate_tilt_rmse_deg": Metric(
        "Root mean square angle between the true direction of gravity and the one that the estimated attitude takes "
        "for it.",
        "Gravity",
        unit="deg",
        better="lower",
    ),
    "ate_rotation_part_rmse": Metric(
        "Root mean square Frobenius norm of R - I, with R the rotation of E = Q^-1 P (evo's rotation part).",
        "Rotation part",
        better="lower",
    ),
    "ate_full_rmse": Metric(
        "Root mean square Frobenius norm of E - I, E = Q^-1 P, truth Q, aligned estimate P: metres and rotation in one "
        "number (evo's full transformation).",
        "Full",
        better="lower",
    ),
    "rpe_1s_translation_rmse_m": Metric(
        "Relative pose error over 1 s: root mean square translation of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), truth Q, aligned "
        "estimate P, over all pairs of matched truth stamps that are 1 s apart (or consecutive ones: rpe_pairs).",
        "RPE 1 s",
        unit="m",
        better="lower",
        column=Column("RPE 1s", "m", small=0.01),
    ),
    "rpe_1s_rotation_rmse_deg": Metric(
        "Relative pose error over 1 s: root mean square rotation angle over the same pairs.",
        "RPE 1 s rotation",
        unit="deg",
        better="lower",
        column=Column("RPE 1s", "deg", digits=2),
    ),
    "rpe_1s_pairs": Metric("Number of pairs that the relative errors over 1 s are taken over.", "RPE 1 s pairs"),
    "subpath_translation_percent": Metric(
        "Mean over all answered segments, of all lengths, of the translation of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) as a "
        "percentage of the length; a segment ends at the first truth stamp that is more than its length along the "
        "whole true path (KITTI).",
        "Drift",
        unit="%",
        better="lower",
    ),
    "subpath_rotation_deg_per_m": Metric(
        "Mean over the same segments of the rotation angle by the length.",
        "Drift rotation",
        unit="deg/m",
        better="lower",
    ),
    "subpath_yaw_deg_per_m": Metric(
        "Mean over the same segments of the yaw part of the rotation by the length.",
        "Drift yaw",
        unit="deg/m",
        better="lower",
    ),
    "subpath_tilt_deg_per_m": Metric(
        "Mean over the same segments of the gravity part of the rotation by the length.",
        "Drift gravity",
        unit="deg/m",
        better="lower",
    ),
    "subpath_10m_translation_percent": Metric(
        "Mean over the answered segments of 10 m of the relative translation error by that length.",
        "10 m",
        unit="%",
        better="lower",
    ),
    "subpath_10percent_translation_percent": Metric(
        "Mean over the answered segments of 10 % of the true path of the relative translation error by that length.",
        "10 % of path",
        unit="%",
        better="lower",
    ),
    "subpath_segments": Metric("Number of segments that are answered at both ends.", "Segments"),
    "subpath_coverage": Metric(
        "Share (0 to 1) of the segments of the truth that are answered at both ends.",
        "Segments answered",
        better="higher",
    ),
    "subpath_scale": Metric(
        "Median over the same segments of the estimated over the true distance between their ends, where these are "
        "10 % of the length apart; 1 is right.",
        "Scale of segments",
    ),
    "subpath_scale_error_percent": Metric(
        "Median distance of those ratios from 1.", "Scale error", unit="%", better="lower"
    ),
    "drift_percent": Metric(
        "Position error at the last matched pose when the first is laid on the truth, by the true path between them.",
        "End drift",
        unit="%",
        better="lower",
    ),
    "drift_deg_per_m": Metric(
        "Angle by which the attitude errs at the last matched pose when the first is laid on the truth, by the true "
        "path between them.",
        "End drift rotation",
        unit="deg/m",
        better="lower",
    ),
    "velocity_rmse_m_per_s": Metric(
        "Root mean square length of the difference of true and estimated mean velocity, in the truth's world, over "
        "velocity_step_s (0.2 s).",
        "Velocity",
        unit="m/s",
        better="lower",
    ),
    "coverage": Metric(
        "Share (0 to 1) of all truth stamps that the estimate answers: those on one of its poses (matched to one, with "
        "nearest association), or between two poses at most max_gap_s apart.",
        "Coverage",
        better="higher",
        column=Column("cover", "%", digits=1, small=0.0, factor=100.0),
    ),
    "first_fix_s": Metric(
        "Time from the first truth stamp to the first answered one.", "First fix", unit="s", better="lower"
    ),
    "gaps": Metric("Number of runs of unanswered truth stamps after the first fix.", "Gaps", better="lower"),
    "longest_gap_s": Metric(
        "Longest of the gaps: from the last answered truth stamp before it to the first after it, or to the end.",
        "Longest gap",
        unit="s",
        better="lower",
    ),
    "matched": Metric("Number of truth stamps that the errors are taken over.", "Matched"),
    "path_length_m": Metric("Length of the whole true path.", "Path", unit="m"),
    "duration_s": Metric("Time from the first to the last truth stamp.", "Duration", unit="s"),
    "scale": Metric("Scale that the alignment put on the estimate; 1 unless by sim3 or scale.", "Scale"),
    "alignment_condition": Metric(
        "How much better the path determines the best determined turn of the alignment than the worst (the root of the "
        "ratio of their stiffnesses; for posyaw, total over horizontal spread): 1 is best, a line has no limit.",
        "Condition",
    ),
    "alignment_sigma_deg": Metric(
        "Uncertainty of the least determined turn of the alignment: the estimate's error across the path's main "
        "direction over the distances that determine the turn.",
        "Alignment sigma",
        unit="deg",
    ),
    "time_offset_s": Metric("What was added to the estimate's stamps.", "Time offset", unit="s"),
    "time_offset_sigma_s": Metric("Standard deviation of an estimated time offset.", "Offset sigma", unit="s"),
    "time_offset_correlation": Metric(
        "Correlation of the true and the estimated speed at an estimated time offset; 1 is certain.", "Offset fit"
    ),
    **{
        key: metric
        for part, freedom, of in (("position", 3, "position"), ("rotation", 3, "attitude"), ("pose", 6, "whole pose"))
        for key, metric in _consistency(part, freedom, of).items()
    },
    "realtime_factor": Metric(
        "Duration of the sequence divided by the wall time of the method; above 1 it keeps up with the sensors.",
        "Speed",
        better="higher",
        column=Column("speed", "x", digits=1),
    ),
    "wall_s": Metric("Wall time of the method.", "Wall time", unit="s", better="lower"),
    "cpu_s": Metric(
        "Processor time of the method, summed over its threads and processes.", "CPU time", unit="s", better="lower"
    ),
    "peak_memory_mb": Metric(
        "Most memory (1e6 bytes) that the method's processes had resident, the program around it included: the greater "
        "of the largest one's peak, as the kernel kept it, and of their sum, looked at every 0.2 s.",
        "Memory",
        unit="MB",
        better="lower",
    ),
}
"""Metrics of the SLAM track by their key, which carries the unit; without one a metric is a plain number."""

_VARIED = {
    r"rpe_([0-9.e+-]+)(s|m|deg|frames)_(\w+)": ("rpe_1s_{2}", "1 s"),
    r"recall_([0-9.e+-]+)(percent)": ("recall_1percent", "1 %"),
    r"subpath_([0-9.e+-]+)(m)_translation_percent": ("subpath_10m_translation_percent", "10 m"),
    r"subpath_([0-9.e+-]+)(percent)_translation_percent": ("subpath_10percent_translation_percent", "10 %"),
}
"""Keys that carry a number and its unit -> the key that defines them all, and how the number is written in it."""

_WRITTEN = {"percent": "%", "frames": "poses"}


def find_slam(key: str) -> Metric | None:
    """Metrics over another time, path, angle or share than those of `SLAM`."""
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
)
"""Errors of the standings are relative to the path, as they are means over paths."""
