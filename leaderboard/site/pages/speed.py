"""Plot of scores against speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from oysterbench.report.columns import metric_column
from oysterbench.report.labelled import Point, labelled_plot
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.site.charts import Card

SPEEDS = {"slam": "realtime_factor", "exploration": "steps_per_s"}
"""Track -> metric in its tables that measures a method's speed."""
REAL_TIME = {"realtime_factor": 1.0}
"""Metric of speed -> value that keeps up with the sensors."""
MOST_POINTS = 30
AXIS = (0.01, 1000.0)
"""Fixed range of the chart's speed axis. Points beyond it are drawn at its edge, with their value."""


def speed_card(info: BoardInfo, rows: Sequence[Row]) -> Card | None:
    """Plot of the rows that have both score and speed; None where fewer than three do. A record whose runs all failed
    has no speed."""
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
