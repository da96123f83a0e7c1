"""The metrics that tables show: their headings, units and decimals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

ABSENT = "\N{EN DASH}"
"""Stands where there is no value."""


@dataclass(frozen=True)
class Column:
    """A metric in a table: key, heading and unit below it, factor to the shown unit.

    decimals: of ordinary values; one more is shown where a value lies below `small`
    """

    key: str
    heading: str
    unit: str
    factor: float = 1.0
    decimals: int = 2
    small: float = 0.1

    def texts(self, values: Sequence[float | None]) -> list[str]:
        """The values as shown, all with the same decimals, so that the eye can compare them.

        Coverage is cut, not rounded: 100 is said of nothing less.
        """
        known = [abs(value * self.factor) for value in values if value is not None and math.isfinite(value)]
        decimals = self.decimals + any(0 < value < self.small for value in known)
        return [ABSENT if value is None or math.isnan(value) else self._text(value, decimals) for value in values]

    def _text(self, value: float, decimals: int) -> str:
        if self.key == "coverage":
            return f"{math.floor(value * self.factor * 10 + 1e-9) / 10:.1f}"
        return f"{value * self.factor:.{decimals}f}"


COLUMNS = (
    Column("score", "score", "", decimals=3, small=0.0),
    Column("ate_rmse_m", "ATE", "m", decimals=3, small=0.01),
    Column("ate_rotation_rmse_deg", "rot", "deg"),
    Column("rpe_1s_translation_rmse_m", "RPE 1s", "m", decimals=3, small=0.01),
    Column("rpe_1s_rotation_rmse_deg", "RPE 1s", "deg"),
    Column("coverage", "cover", "%", factor=100.0),
    Column("realtime_factor", "speed", "x", decimals=1),
)
"""Of one line per method and sequence: as many as a terminal of 80 columns holds."""

STANDING = (
    Column("coverage", "cover", "%", factor=100.0),
    Column("ate_percent", "ATE", "%"),
    Column("ate_rotation_rmse_deg", "rot", "deg"),
    Column("realtime_factor", "speed", "x", decimals=1),
)
"""Of the standings, beside rank, score and interval; errors relative to the path, as they are means over paths."""


SEGMENTATION = (
    Column("iou", "IoU", "", decimals=3, small=0.0),
    Column("image_iou", "IoU", "by image", decimals=3, small=0.0),
    Column("boundary_iou", "IoU", "boundary", decimals=3, small=0.0),
    Column("precision", "prec", "", decimals=3, small=0.0),
    Column("recall", "recall", "", decimals=3, small=0.0),
    Column("dice", "Dice", "", decimals=3, small=0.0),
    Column("empty_false_positive_rate", "empty", "% false", factor=100.0),
)
DETECTION = (
    Column("ap_mask", "AP", "mask", decimals=3, small=0.0),
    Column("ap50_mask", "AP50", "mask", decimals=3, small=0.0),
    Column("ap_box", "AP", "box", decimals=3, small=0.0),
    Column("ar_mask", "AR", "mask", decimals=3, small=0.0),
    Column("pq", "PQ", "", decimals=3, small=0.0),
    Column("count_mae", "count", "MAE", decimals=1, small=0.0),
    Column("count_bias", "count", "bias", decimals=1, small=0.0),
    Column("density_error_per_m2", "density", "err/m\N{SUPERSCRIPT TWO}", decimals=1, small=0.0),
)

DENSITY = (
    Column("map_score", "score", "", decimals=3, small=0.0),
    Column("count_error_percent", "count", "% error", decimals=1, small=0.0),
    Column("live_error_percent", "live", "% error", decimals=1, small=0.0),
    Column("cell_mae_per_m2", "MAE", "per m\N{SUPERSCRIPT TWO}", decimals=1, small=0.0),
    Column("cell_bias_per_m2", "bias", "per m\N{SUPERSCRIPT TWO}", decimals=1, small=0.0),
    Column("right_class", "class", "% right", factor=100.0, decimals=0, small=0.0),
    Column("twice_percent", "twice", "%", decimals=1, small=0.0),
    Column("lost_percent", "lost", "%", decimals=1, small=0.0),
    Column("coverage", "cover", "%", factor=100.0),
)

STEERING = (
    Column("skill", "skill", "", decimals=3, small=0.0),
    Column("regret_oysters", "regret", "oysters", small=0.0),
    *(
        column
        for axis in ("yaw", "pitch")
        for column in (
            Column(f"{axis}_accuracy", axis, "% right", factor=100.0, decimals=1, small=0.0),
            Column(f"{axis}_macro_f1", axis, "F1", decimals=3, small=0.0),
            Column(f"{axis}_cost_deg", axis, "deg off", decimals=1, small=0.0),
        )
    ),
)
EXPLORATION = (
    Column("oysters_per_min", "oysters", "per min", decimals=1, small=0.0),
    Column("found_share", "found", "%", factor=100.0, decimals=1, small=0.0),
    Column("covered_share", "covered", "%", factor=100.0, decimals=1, small=0.0),
    Column("contacts_per_min", "contacts", "per min", small=0.0),
    Column("in_band_share", "in band", "%", factor=100.0, decimals=1, small=0.0),
    Column("turned_back", "turned", "times", decimals=1, small=0.0),
    Column("distance_m", "way", "m", decimals=1, small=0.0),
    Column("steps_per_s", "speed", "steps/s", decimals=1, small=0.0),
)

OF_TRACK = {
    "slam": COLUMNS,
    "segmentation": SEGMENTATION,
    "detection": DETECTION,
    "density": DENSITY,
    "steering": STEERING,
    "exploration": EXPLORATION,
}
"""Track -> columns of its results."""

STANDING_OF_TRACK = {
    "slam": STANDING,
    "segmentation": SEGMENTATION[1:],
    "detection": DETECTION[1:],
    "density": DENSITY[1:],
    "steering": STEERING[1:],
    "exploration": EXPLORATION[1:],
}
"""Track -> columns of its standings, beside the metric that ranks."""

ERROR_OF_TRACK = {
    "slam": "ate_percent",
    "segmentation": "boundary_iou",
    "detection": "count_mae",
    "density": "cell_mae_per_m2",
    "steering": "regret_oysters",
    "exploration": "contacts_per_min",
}
"""Track -> the metric that is shown beside the one that ranks, over conditions and over runs."""


def find_column(key: str) -> Column:
    """The column of a metric."""
    known = (*COLUMNS, *STANDING, *(column for columns in OF_TRACK.values() for column in columns))
    return next(column for column in known if column.key == key)
