"""Scores against strength: a plot for each disturbance, and a table of which disturbance breaks which method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from oysterbench.report.cards import Card, PlotGroup
from oysterbench.report.columns import metric_column
from oysterbench.report.plots import Curve, strength_plot
from oysterbench.report.table import Cell, Column, Table, TableRow
from oysterbench.results.comparison import Board
from oysterbench.results.stress import BROKEN_SHARE, Disturbance, disturbances


def stress_group(board: Board, styles: Mapping[str, int]) -> PlotGroup | None:
    """Plots, one for each disturbance of the board's split; None if there are none."""
    found = disturbances(board)
    if not found:
        return None
    heading = metric_column(board.metric).heading
    cards = tuple(_card(disturbance, heading, styles) for disturbance in found)
    labels = tuple((row.label, styles[row.label]) for row in board.standings)
    return PlotGroup(f"{heading} against the strength of each disturbance alone on {board.name}", labels, cards)


def _card(disturbance: Disturbance, heading: str, styles: Mapping[str, int]) -> Card:
    strengths = np.array(disturbance.strengths, dtype=float)
    curves = [Curve(label, strengths, np.array(y), styles[label]) for label, y in disturbance.scores.items()]
    return Card(disturbance.name, strength_plot(curves, disturbance.name, "strength, 0: the calm dive", heading))


def stress_table(board: Board) -> Table | None:
    """Table with a row per disturbance and a column per method: the score at each strength, and the strength from which
    the method is broken; None if there are no disturbances."""
    found = disturbances(board)
    if not found:
        return None
    labels = [row.label for row in board.standings]
    columns = [Column("disturbance", "Disturbance"), *(Column(label, label) for label in labels)]
    rows = [TableRow((each.name, *(_cell(each, label) for label in labels))) for each in found]
    note = (
        f"{metric_column(board.metric).heading} (mean of the runs) on the calm dive and at strengths "
        f"{_list(found[0].strengths[1:])}; a method is broken from the strength at which it stays below "
        f"{BROKEN_SHARE:.0%} of the former. Where that is not above 0, there is nothing to break."
    )
    return Table(f"Disturbances on {board.name}", tuple(columns), tuple(rows), (note,))


def _cell(disturbance: Disturbance, label: str) -> Cell:
    values = "  ".join("-" if math.isnan(value) else f"{value:.2f}" for value in disturbance.scores[label])
    if math.isnan(disturbance.scores[label][0]):
        return Cell(values, small="no calm dive")
    if not disturbance.can_break(label):
        return Cell(values, kind="warn", small="nothing to break")
    broken = disturbance.breaks_at(label)
    return Cell(values, kind="" if broken is None else "warn", small="" if broken is None else f"broken from {broken}")


def _list(strengths: Sequence[int]) -> str:
    return ", ".join(str(strength) for strength in strengths)
