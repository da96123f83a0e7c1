"""Display of a scored trajectory in a notebook."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from oysterbench.core.display import CardTable, card
from oysterbench.evaluate.metric import Metric
from oysterbench.evaluate.slam.metrics import SLAM, TRACK, find_slam

if TYPE_CHECKING:
    import pandas as pd

    from oysterbench.evaluate.slam.scoring import SlamResult

SHOWN = tuple(key for key in TRACK.table if key != "realtime_factor")
ON_A_CARD = (*SHOWN, "ate_percent", "subpath_translation_percent", "scale", "time_offset_s", "path_length_m")


def outline(result: SlamResult) -> str:
    """The main numbers in one line."""
    parts = [f"{metric.heading} {written(result.metrics[key], metric)}" for key, metric in _metrics(SHOWN, result)]
    return ", ".join([*parts, f"aligned by {result.settings.align}"])


def result_card(result: SlamResult) -> str:
    """The main numbers as an HTML card, with their definitions and the notes of the result."""
    rows = [
        (metric.heading, written(result.metrics[key], metric), result.reasons.get(key, metric.definition), key)
        for key, metric in _metrics(ON_A_CARD, result)
    ]
    tables = [CardTable(("metric", "value", "what it is", "key"), rows)]
    return card("Trajectory scored", f"aligned by {result.settings.align}", tables, notes=result.notes)


def result_table(result: SlamResult) -> pd.DataFrame:
    """All metrics, one row each."""
    import pandas as pd

    rows = {}
    for key, value in result.metrics.items():
        metric = SLAM.get(key) or find_slam(key)
        known = (metric.unit, metric.better, metric.definition) if metric else ("", "", "")
        row = (float(value), *known, result.reasons.get(key, ""))
        rows[key] = dict(zip(("value", "unit", "better", "definition", "reason"), row, strict=True))
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("metric")


def written(value: float, metric: Metric) -> str:
    """Format a value as in tables, with its unit; "none" for NaN."""
    if math.isnan(value):
        return "none"
    unit = metric.narrow[1]
    return f"{value * metric.factor:.4g}{f' {unit}' if unit else ''}"


def _metrics(keys: tuple[str, ...], result: SlamResult) -> list[tuple[str, Metric]]:
    return [(key, SLAM[key]) for key in keys if key in result.metrics]
