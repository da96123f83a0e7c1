"""The settings of the trajectory evaluator: how an estimate is brought to the truth, and over what errors are taken."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from oysterbench.core.errors import TrajectoryError

Align = Literal["none", "origin", "se3", "posyaw", "sim3", "scale"]
Associate = Literal["interpolate", "nearest"]
Pairs = Literal["all", "consecutive"]
Angle = Literal["turned", "direct"]

MIN_MATCHED = 5
"""Fewer poses are fitted by the alignment rather than scored: three are 9 numbers, of which sim3 fits 7."""

_CHOICES: dict[str, tuple[str, ...]] = {
    "align": get_args(Align),
    "associate": get_args(Associate),
    "rpe_pairs": get_args(Pairs),
    "rpe_angle": get_args(Angle),
}
_POSITIVE = {
    "max_gap_s": "s",
    "max_difference_s": "s",
    "recall_scale_percent": "%",
    "rpe_delta_s": "s",
    "rpe_delta_m": "m",
    "rpe_delta_deg": "deg",
    "velocity_step_s": "s",
}
_COUNTS = {"align_first": MIN_MATCHED, "rpe_frames": 1, "subpath_step": 1}


@dataclass(frozen=True)
class SlamSettings:
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
    """

    align: Align = "posyaw"
    align_first: int | None = None
    associate: Associate = "interpolate"
    max_gap_s: float = 0.3
    max_difference_s: float = 0.01
    time_offset_s: float | Literal["estimate"] = 0.0
    recall_scale_percent: float = 1.0
    rpe_frames: int = 1
    rpe_delta_s: float = 1.0
    rpe_delta_m: float = 1.0
    rpe_delta_deg: float = 10.0
    rpe_pairs: Pairs = "all"
    rpe_angle: Angle = "turned"
    subpath_m: tuple[float, ...] = ()
    subpath_step: int = 1
    velocity_step_s: float = 0.2

    def __post_init__(self) -> None:
        object.__setattr__(self, "subpath_m", tuple(self.subpath_m))
        for key, options in _CHOICES.items():
            value = getattr(self, key)
            if value not in options:
                raise TrajectoryError(f"evaluator setting {key!r}: expected one of {', '.join(options)}, got {value!r}")
        for key, unit in _POSITIVE.items():
            self._check(key, getattr(self, key), f"more than 0 {unit}", _is_positive)
        for key, least in _COUNTS.items():
            value = getattr(self, key)
            if key == "align_first" and value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise TrajectoryError(f"evaluator setting {key!r}: expected a whole number from {least}, got {value!r}")
        for length in self.subpath_m:
            self._check("subpath_m", length, "lengths of more than 0 m", _is_positive)
        if self.rpe_angle == "direct" and self.rpe_pairs != "all":
            raise TrajectoryError(
                f"evaluator setting 'rpe_angle': expected 'turned' with {self.rpe_pairs} pairs, got 'direct', which "
                "tries all pairs"
            )
        if self.time_offset_s != "estimate":
            self._check("time_offset_s", self.time_offset_s, "seconds or 'estimate'", _is_offset)

    @staticmethod
    def _check(key: str, value: Any, expected: str, holds: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float) or not holds(value):
            raise TrajectoryError(f"evaluator setting {key!r}: expected {expected}, got {value!r}")

    def as_dict(self) -> dict[str, Any]:
        """The settings for JSON."""
        return {**asdict(self), "subpath_m": list(self.subpath_m)}


def _is_positive(value: float) -> bool:
    return 0 < value < float("inf")


def _is_offset(value: float) -> bool:
    # Less than the 146 years that a stamp may be from the epoch, and enough to bring stamps from zero to today.
    return abs(value) < 4e9
