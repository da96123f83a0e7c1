"""Scores against speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from oysterbench.report.columns import metric_column
from oysterbench.report.labelled import Point, labelled_plot
from oysterbench_leaderboard.board import BoardInfo, Row
from oysterbench_leaderboard.site.charts import Card

SPEEDS = {"slam": "realtime_factor", "exploration": "steps_per_s"}
"""Track -> the metric of its tables that says how fast a method is."""
REAL_TIME = {"realtime_factor": 1.0}
"""Such a metric -> what keeps up with the sensors."""
MOST_POINTS = 30
AXIS = (0.01, 1000.0)
"""Of the chart: no record stretches it. What is beyond stands at its edge, with its value."""


def speed_card(info: BoardInfo, rows: Sequence[Row]) -> Card | None:
    """Of the rows that have both; None where fewer than three have. A record all of whose runs failed has no speed."""
    key = SPEEDS.get(info.track, "")
    points = []
    for row in rows[:MOST_POINTS]:
        speed = row.metrics.get(key)
        known = row.score is not None and speed is not None and math.isfinite(speed) and speed > 0
        if known and row.failures < row.runs:
            points.append(_point(row.method, float(speed or 0.0), float(row.score or 0.0)))
    if len(points) < 3:
        return None
    metric, column = metric_column(info.metric), metric_column(key, track=info.track)
    x_label = f"{column.heading}, {column.unit}: to the right is faster"
    title = f"{metric.heading} against {column.heading.lower()}"
    plot = labelled_plot(points, title, x_label, f"{metric.heading} {metric.unit}".strip(), REAL_TIME.get(key))
    return Card(title, Markup(plot))


def _point(method: str, speed: float, score: float) -> Point:
    low, high = AXIS
    label = method if low <= speed <= high else f"({speed:.3g}) {method}"
    return Point(label, min(max(speed, low), high), score)
