"""Settings of the trajectory evaluator: how an estimate is matched and aligned, and over what errors are taken."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from oysterbench.core.errors import TrajectoryError
from oysterbench.evaluate.settings import EvaluatorSettings, is_number, positive, setting, whole

Align = Literal["none", "origin", "se3", "posyaw", "sim3", "scale"]
Associate = Literal["interpolate", "nearest"]
SCALED: tuple[Align, ...] = ("sim3", "scale")
"""Alignments that fit a scale."""
Pairs = Literal["all", "consecutive"]
Angle = Literal["turned", "direct"]

MIN_MATCHED = 5
"""Minimum number of matched poses; fewer are fitted rather than scored: three are 9 numbers, of which sim3 fits 7."""
MAX_OFFSET_S = 4e9
"""Limit of a time offset: below the 146 years allowed for stamps, and enough to shift stamps from zero to today."""


def _is_offset(value: Any) -> bool:
    return value == "estimate" or (is_number(value) and abs(value) < MAX_OFFSET_S)


@dataclass(frozen=True)
class SlamSettings(EvaluatorSettings):
    """Settings for scoring an estimate.

    align:                none; origin (first matched pose); posyaw (translation and yaw, the freedom of a
                          gravity-aware method); se3 (translation and rotation); sim3 (and scale: monocular);
                          scale (alone: no rotation or translation)
    align_first:          fit the alignment to this many matched poses, from the first; None: to all of them
    associate:            interpolate the estimate at the truth stamps, or take the nearest pose
    max_gap_s:            the estimate is interpolated only between poses at most this far apart
    max_difference_s:     maximum difference between a truth stamp and its nearest pose
    time_offset_s:        added to the estimate's stamps before anything else; "estimate": found from the motion
    recall_scale_percent: position error, % of the true path, that counts half in the score
    rpe_frames, rpe_delta_s, rpe_delta_m, rpe_delta_deg: number of matched poses, time, true path length and true angle
                          turned over which relative errors are taken
    rpe_pairs:            from every start (all), or each pair starting where the last one ended (consecutive)
    rpe_angle:            angle that rpe_delta_deg refers to: that accumulated along the true path (turned), or that
                          between the two attitudes (direct: evo's all pairs, of at most 20 000 poses)
    subpath_m:            lengths of the segments, m; default: 10, 20, 30, 40 and 50 % of the true path
    subpath_step:         a segment starts at every n-th truth stamp
    velocity_step_s:      time over which mean velocities are taken

    Examples
    --------
    >>> SlamSettings(align="se3").align
    'se3'
    >>> SlamSettings(align="se4")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oysterbench.core.errors.TrajectoryError: evaluator setting 'align': expected one of none, origin, ..., got 'se4'
    """

    error = TrajectoryError

    align: Align = "posyaw"
    align_first: int | None = whole(None, MIN_MATCHED)
    associate: Associate = "interpolate"
    max_gap_s: float = positive(0.3, "s")
    max_difference_s: float = positive(0.01, "s")
    time_offset_s: float | Literal["estimate"] = setting(0.0, "seconds or 'estimate'", _is_offset)
    recall_scale_percent: float = positive(1.0, "%")
    rpe_frames: int = whole(1, 1)
    rpe_delta_s: float = positive(1.0, "s")
    rpe_delta_m: float = positive(1.0, "m")
    rpe_delta_deg: float = positive(10.0, "deg")
    rpe_pairs: Pairs = "all"
    rpe_angle: Angle = "turned"
    subpath_m: tuple[float, ...] = setting(
        (), "lengths of more than 0 m", lambda value: all(is_number(m) and 0 < m < math.inf for m in value)
    )
    subpath_step: int = whole(1, 1)
    velocity_step_s: float = positive(0.2, "s")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rpe_angle == "direct" and self.rpe_pairs != "all":
            self.refuse("rpe_angle", f"'turned' with {self.rpe_pairs} pairs (direct tries all)", self.rpe_angle)
