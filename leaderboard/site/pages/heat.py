"""Heat maps of scores: methods in rows, sequences or classes of conditions in columns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.report.columns import metric_column
from oysterbench.report.table import Cell, Column, Table, TableRow
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.site.paths import record_path
from oysterbench_leaderboard.site.site import Site

LEVELS = 10
"""Number of shades of a heat map above the lowest, as defined in `style.css`."""
MOST_COLUMNS = 24
"""Maximum number of columns: a split with more sequences is shown by its classes alone."""
MOST_ROWS = 25


@dataclass(frozen=True)
class Scores:
    """Scores of a board's rows on each of its sequences, where missing ones count as failed. values: digest -> sequence
    -> score; like: sequence -> conditions."""

    info: BoardInfo
    rows: Sequence[Row]
    values: Mapping[str, Mapping[str, float]]
    like: Mapping[str, Mapping[str, object]]

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest of the scores and 0."""
        known = [value for of in self.values.values() for value in of.values() if math.isfinite(value)] or [0.0]
        return min(0.0, *known), max(*known, 1e-12)


def scores_of(site: Site, info: BoardInfo, rows: Sequence[Row]) -> Scores | None:
    """Scores of the first MOST_ROWS rows; None where none is known by sequence, as on a hidden split, or without
    rows."""
    rows = rows[:MOST_ROWS]
    found = site.index.scores(row.digest for row in rows)
    failed = FAILED[info.track].get(info.metric, math.nan)
    lacking = dict.fromkeys(info.sequences, failed) | site.lowest_scores(info)
    values = {row.digest: {name: found[row.digest].get(name, lacking[name]) for name in info.sequences} for row in rows}
    known = any(math.isfinite(value) for of in found.values() for value in of.values())
    return Scores(info, rows, values, site.conditions(info.id, rows[0].digest)) if rows and known else None


def sequences_heat(scores: Scores) -> Table | None:
    """Heat map with a column per sequence; None where there are too many, or only one, which the board's own table
    shows."""
    names = scores.info.sequences
    if not 2 <= len(names) <= MOST_COLUMNS:
        return None
    columns = [Column(name, name, _said(scores.like.get(name, {}))) for name in names]
    values = {row.digest: [scores.values[row.digest][name] for name in names] for row in scores.rows}
    metric = metric_column(scores.info.metric).heading
    return _heat(scores, f"{metric} by sequence", columns, values, ())


def classes_heat(scores: Scores) -> Table | None:
    """Heat map with a column per class of each condition that has several: means over its sequences. None where there
    are too few or too many columns.

    A class of one sequence is left out where that sequence has its own column (`sequences_heat`). For metrics with a
    weighted mean, such as IoU by pixels, each sequence of a class has one vote here, which a note says.
    """
    columns, groups = [], []
    least = 2 if len(scores.info.sequences) <= MOST_COLUMNS else 1
    for condition in STRATA:
        classes: dict[str, list[str]] = {}
        for name in scores.info.sequences:
            value = scores.like.get(name, {}).get(condition)
            if value is not None:
                classes.setdefault(f"{value:g}" if isinstance(value, float) else str(value), []).append(name)
        if len(classes) > 1:
            for value, names in sorted(classes.items()):
                if len(names) < least:
                    continue
                name = CONDITIONS[condition].name
                heading, unit = (f"{name} {value}", "") if value.isdigit() else (value, f"{name}, ")
                columns.append(
                    Column(f"{condition} {value}", heading, f"{unit}n = {len(names)}", about=", ".join(names))
                )
                groups.append(names)
    if not 2 <= len(columns) <= MOST_COLUMNS:
        return None
    values = {row.digest: [_mean(scores.values[row.digest], names) for names in groups] for row in scores.rows}
    metric = find_metric(scores.info.metric)
    weighed = " A sequence has one vote here, whatever its pixels." if metric is not None and metric.weight else ""
    alone = " Classes of one sequence are in the table above." if least > 1 else ""
    notes = (f"Means over the sequences of a class; n is their number.{alone}{weighed}",)
    return _heat(scores, f"{metric_column(scores.info.metric).heading} by conditions", columns, values, notes)


def _heat(
    scores: Scores,
    title: str,
    columns: Sequence[Column],
    values: Mapping[str, Sequence[float]],
    notes: tuple[str, ...],
) -> Table:
    metric, (_, high) = metric_column(scores.info.metric), scores.ends
    lines = []
    for row in scores.rows:
        cells = [
            Cell(value, metric.text(value), heat_kind(value, high, metric.better == "lower"))
            for value in values[row.digest]
        ]
        lines.append(TableRow((Cell(row.method, path=record_path(row.digest)), *cells)))
    shown = [Column("method", "Method"), *(_number(column) for column in columns)]
    return Table(title, tuple(shown), tuple(lines), notes)


def _number(column: Column) -> Column:
    return Column(column.key, column.heading, column.unit, "number", about=column.about)


def heat_kind(value: float, high: float, lower_is_better: bool = False) -> str:
    """CSS class of a cell: from heat-0 for 0, or the worst, to heat-10 for the best; "below" for values below 0, unless
    lower is better; "soft" for no value.

    >>> heat_kind(0.5, 1.0), heat_kind(-0.1, 1.0), heat_kind(math.nan, 1.0)
    ('heat-5', 'below', 'soft')
    """
    if not math.isfinite(value):
        return "soft"
    if value < 0 and not lower_is_better:
        return "below"
    share = value / high if high > 0 else 0.0
    return f"heat-{round(LEVELS * (1.0 - share if lower_is_better else share))}"


def _mean(values: Mapping[str, float], names: Sequence[str]) -> float:
    known = [values[name] for name in names if math.isfinite(values[name])]
    return math.fsum(known) / len(known) if known else math.nan


def _said(like: Mapping[str, object]) -> str:
    """Short text below the name of a sequence: its class of water."""
    return str(like.get("water", "")) if like else ""
