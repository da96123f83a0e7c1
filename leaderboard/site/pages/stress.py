"""Plots for a board of single disturbances: scores of the methods shown against the strength of each disturbance."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from oysterbench.report.stress import stress_group
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.publishing.truths import Stated
from oysterbench_leaderboard.site import charts, standing
from oysterbench_leaderboard.site.site import Site

MOST_METHODS = 8
"""Number of first rows of a page that are drawn: as many as there are distinct marks."""


def stress_drawing(site: Site, info: BoardInfo, rows: Sequence[Row]) -> charts.Drawing | None:
    """Plots for the rows of a board, without those whose records are damaged, or of another ground truth than others;
    None where the split has no single disturbances, or there are no rows."""
    shown = [row for row in rows[:MOST_METHODS] if site.is_whole(row.digest)]
    if not shown or not site.has_disturbances(info.id, shown[0].digest):
        return None
    stated = [Stated.of(row.digest, site.record(row.digest)) for row in shown]
    odd = site.contradicted(stated)
    shown = [row for row in shown if row.digest not in odd]
    names = [row.method for row in shown]
    labels = [row.method if names.count(row.method) == 1 else f"{row.method} ({row.digest[:8]})" for row in shown]
    results = [
        result
        for label, row in zip(labels, shown, strict=True)
        for result in standing.named(site.record(row.digest), label)
    ]
    board = standing.board(results)
    group = stress_group(board, {label: 1 + i for i, label in enumerate(labels)})
    if group is None:
        return None
    about = "0 is the calm dive. Means of the runs; a failed one scores 0."
    cards = tuple(charts.Card(card.title, Markup(card.svg)) for card in group.cards)  # escaped when drawn
    return charts.Drawing(group.heading, about, charts.legend(list(group.legend), truth=False), cards)
