"""Ranks on a board where a team may publish any number of methods: ahead of others', only the best of a team counts."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.statistics import LEAST_SEQUENCES, significant_signs
from oysterbench.results.standings import REFERENCES, Direction, ScoreTable, Standing


def standings_by_team(table: ScoreTable, teams: Sequence[Hashable], better: Direction) -> list[Standing]:
    """Standing of each method, in the order of the table, without `worst`.

    The best methods of all teams are ranked among each other, as `ScoreTable.standings` does. The rank of any further
    method of a team is its rank within the team + the number of other teams whose best method is significantly better,
    and at least the rank of any best method placed above it. So a team's further methods change no rank of another
    team's, and a team that is alone on a board has the ranks of `ScoreTable.standings`.

    teams: of each method (R,); a method that always counts is a team of its own
    """
    if len(set(teams)) in (1, len(teams)):
        return [replace(one, worst=None) for one in table.standings(better)]
    means = table.means() * (-1 if better == "higher" else 1)
    order = np.argsort(means, kind="stable")[: np.count_nonzero(~np.isnan(means))]
    places = (1 + np.searchsorted(means[order], means)).tolist()
    found = [Standing(None, None, None)] * len(means)
    of_team: dict[Hashable, list[int]] = {}
    for row in order.tolist():
        of_team.setdefault(teams[row], []).append(row)
    if not of_team:  # no method has a value
        return found
    best = [rows[0] for rows in of_team.values()]  # in the order of their means, as `order` is
    standings = table.take(best).standings(better)
    for row, standing in zip(best, standings, strict=True):
        found[row] = Standing(places[row], standing.rank, None)
    # Rank of the last of the best methods above each row: where it is the one after the references, so is the row's.
    above = np.maximum.accumulate([standing.rank or 1 for standing in standings])
    least = above[np.searchsorted(means[best], means, side="right") - 1]
    tested = [row for rows in of_team.values() for row in rows[1:] if least[row] <= REFERENCES]
    ahead = _number_ahead(table, best[:REFERENCES], tested, teams, better)
    enough = np.count_nonzero(~np.isnan(table.values), axis=1) >= LEAST_SEQUENCES
    for rows in of_team.values():
        near = [row for row in rows if least[row] <= REFERENCES] if len(rows) > 1 else []
        ranks = dict.fromkeys(rows, REFERENCES + 1)
        if near:
            inside = [one.rank or 1 for one in table.take(near).standings(better)]
            among = np.maximum(np.maximum.accumulate(ahead[near]) + inside, least[near])
            ranks |= dict(zip(near, np.minimum(among, REFERENCES + 1).tolist(), strict=True))
        for row in rows[1:]:
            found[row] = Standing(places[row], ranks[row] if enough[row] else None, None)
    return found


def _number_ahead(
    table: ScoreTable, best: Sequence[int], rows: Sequence[int], teams: Sequence[Hashable], better: Direction
) -> NDArray[np.int64]:
    """Number (R,), for the given rows, of the best methods of other teams that are significantly better."""
    ahead, sign = np.zeros(len(table.values), int), 1 if better == "higher" else -1
    for one in best:
        others = [row for row in rows if teams[row] != teams[one]]
        weights = (None, None) if table.weights is None else (table.weights[one], table.weights[others])
        if others:
            ahead[others] += sign * significant_signs(table.values[one], table.values[others], *weights) > 0
    return ahead
