"""The page of all metrics of all tracks, from the tables that results are checked and shown with."""

from __future__ import annotations

import math

from docs.generate.markdown import code, table
from oysterbench.evaluate.metric import Metric, TrackMetrics

HEAD = """# Evaluators and metrics

Every metric: its key in `results.json` and in the tables of `--csv`, its unit, which direction is better, its range,
and its definition. The first metric of a track ranks its methods. As functions they are in
[`oysterbench.metrics`](api/metrics.md); versions of the evaluators: [current versions](evaluators.md).

Some keys exist for other sizes too: `rpe_1s_...` for another interval, `recall_...` for another distance. They are
described with the first of their kind.
"""


def metrics_page() -> str:
    """The page of all metrics."""
    from oysterbench.evaluate.metrics import TRACKS

    return HEAD + "".join(_section(name, track) for name, track in TRACKS.items())


def _section(name: str, track: TrackMetrics) -> str:
    keys = sorted(track.metrics, key=lambda key: key != track.ranking)
    rows = [_row(key, track.metrics[key]) for key in keys]
    shown = ", ".join(map(code, track.table))
    return (
        f"\n## {track.title} {{ #{name} }}\n\nMethods are ranked by {code(track.ranking)}; a table of results shows "
        f"{shown}.\n\n{table(('Key', 'Unit', 'Better', 'From', 'To', 'Definition'), rows)}"
    )


def _row(key: str, metric: Metric) -> tuple[str, ...]:
    low, high = (f"{end:g}" if math.isfinite(end) else "" for end in metric.range)
    weight = f" A mean over sequences is weighted by `{metric.weight}`." if metric.weight else ""
    definition = metric.definition if metric.definition.endswith(".") else f"{metric.definition}."
    return code(key), metric.unit, metric.better, low, high, definition + weight
