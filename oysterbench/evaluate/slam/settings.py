"""The settings of the trajectory evaluator: how an estimate is brought to the truth, and over what errors are taken."""

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
"""Fewer poses are fitted by the alignment rather than scored: three are 9 numbers, of which sim3 fits 7."""
MAX_OFFSET_S = 4e9
"""Less than the 146 years that a stamp may be from the epoch, and enough to bring stamps from zero to today."""


def _is_offset(value: Any) -> bool:
    return value == "estimate" or (is_number(value) and abs(value) < MAX_OFFSET_S)


@dataclass(frozen=True)
class SlamSettings(EvaluatorSettings):
    """How an estimate is scored.

    align:                none; origin (first matched pose); posyaw (translation and yaw, the freedom that a
                          gravity-aware method has); se3 (translation and rotation); sim3 (and scale: monocular);
                          scale (alone: nothing is turned or moved)
    align_first:          how many matched poses, from the first, the alignment is fitted to; None: all of them
    associate:            interpolate the estimate at the truth stamps, or take the nearest pose
    max_gap_s:            the estimate is interpolated only between poses that are this close
    max_difference_s:     between a truth stamp and its nearest pose
    time_offset_s:        added to the estimate's stamps before anything else; "estimate": found from the motion
    recall_scale_percent: of the true path: the position error that counts half in the score
    rpe_frames, rpe_delta_s, rpe_delta_m, rpe_delta_deg: over how many matched poses, over which time, true path and
                          truly turned angle relative errors are taken
    rpe_pairs:            from every start (all), or each pair beginning where the last one ended (consecutive)
    rpe_angle:            over which rpe_delta_deg is counted: what the truth turned on the way (turned), or the angle
                          between the two attitudes (direct: evo's all pairs, of at most 20 000 poses)
    subpath_m:            lengths in m of the segments; none given: 10, 20, 30, 40 and 50 % of the true path
    subpath_step:         a segment starts at every so many truth stamps
    velocity_step_s:      over which time velocities are differenced

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
