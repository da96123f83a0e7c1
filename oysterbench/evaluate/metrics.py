"""What is measured: name, unit, direction and definition of every metric that a result may hold."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """One number of a result.

    unit:       as written behind the number; empty where it has none
    better:     the direction of improvement; empty for what describes the sequence or the run
    definition: one sentence
    short:      heading of a table's column
    """

    unit: str
    better: Literal["lower", "higher", ""]
    definition: str
    short: str = ""


SLAM: dict[str, Metric] = {
    "ate_rmse_m": Metric(
        "m",
        "lower",
        "Absolute trajectory error: root mean square distance between true and aligned estimated position over all "
        "matched truth stamps.",
        "ATE",
    ),
    "ate_percent": Metric(
        "%",
        "lower",
        "ATE (RMSE) as a percentage of the length of the whole true path.",
        "ATE of path",
    ),
    "ate_mean_m": Metric("m", "lower", "Mean of the distances that ate_rmse_m is taken over.", "ATE mean"),
    "ate_median_m": Metric("m", "lower", "Median of the distances that ate_rmse_m is taken over.", "ATE median"),
    "ate_max_m": Metric("m", "lower", "Largest of the distances that ate_rmse_m is taken over.", "ATE max"),
    "ate_rotation_rmse_deg": Metric(
        "deg",
        "lower",
        "Root mean square angle of R_truth^T R_estimate over all matched truth stamps, the estimate's attitudes turned "
        "by the alignment.",
        "Rotation",
    ),
    "ate_rotation_median_deg": Metric(
        "deg", "lower", "Median of the angles that ate_rotation_rmse_deg is taken over.", "Rotation median"
    ),
    "ate_rotation_max_deg": Metric(
        "deg", "lower", "Largest of the angles that ate_rotation_rmse_deg is taken over.", "Rotation max"
    ),
    "rpe_1s_translation_rmse_m": Metric(
        "m",
        "lower",
        "Relative pose error over 1 s: root mean square translation of (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), truth Q, aligned "
        "estimate P, over all pairs of matched truth stamps that are 1 s apart.",
        "RPE 1 s",
    ),
    "rpe_1s_rotation_rmse_deg": Metric(
        "deg",
        "lower",
        "Relative pose error over 1 s: root mean square rotation angle over the same pairs.",
        "RPE 1 s rotation",
    ),
    "rpe_1s_pairs": Metric("", "", "Number of pairs that the relative errors over 1 s are taken over.", "RPE pairs"),
    "coverage": Metric(
        "",
        "higher",
        "Share (0 to 1) of all truth stamps that the estimate answers: those on one of its poses (matched to one, with "
        "nearest association), or between two poses at most max_gap_s apart.",
        "Coverage",
    ),
    "matched": Metric("", "", "Number of truth stamps that the errors are taken over.", "Matched"),
    "path_length_m": Metric("m", "", "Length of the whole true path.", "Path"),
    "duration_s": Metric("s", "", "Time from the first to the last truth stamp.", "Duration"),
    "scale": Metric("", "", "Scale that the alignment put on the estimate; 1 unless aligned by sim3.", "Scale"),
    "realtime_factor": Metric(
        "",
        "higher",
        "Duration of the sequence divided by the wall time of the method; above 1 it keeps up with the sensors.",
        "Speed",
    ),
    "wall_s": Metric("s", "lower", "Wall time of the method.", "Wall time"),
    "cpu_s": Metric("s", "lower", "Processor time of the method, summed over its threads.", "CPU time"),
}
"""Metrics of the SLAM track by their key, which carries the unit; without one a metric is a plain number."""


def find_metric(key: str) -> Metric | None:
    """The metric of that key; relative errors over another time than 1 s are found as well ("rpe_0.5s_pairs")."""
    if key in SLAM:
        return SLAM[key]
    match = re.fullmatch(r"rpe_([0-9.e+-]+)s_(\w+)", key)
    if match and (known := SLAM.get(f"rpe_1s_{match[2]}")):
        return replace(
            known,
            definition=known.definition.replace("1 s", f"{match[1]} s"),
            short=known.short.replace("1 s", f"{match[1]} s"),
        )
    return None
