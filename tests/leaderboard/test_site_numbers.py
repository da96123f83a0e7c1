"""Numbers as pages write them: with the digits that their words stand on."""

from __future__ import annotations

from oysterbench.evaluate.statistics import Comparison, Interval
from oysterbench_leaderboard.site.pages.compare import _compared_cells


def test_a_verdict_stands_beside_an_interval_that_shows_it():
    def texts(low, high):
        comparison = Comparison(8, 0.031, Interval(low, high), 6, 0, 2, "better")
        return [cell.text for cell in _compared_cells("score", comparison)[:2]]

    assert texts(0.00012, 0.066) == ["+0.0310", "+0.0001 to +0.0660"]
    assert texts(-0.00012, 0.066) == ["+0.031", "0.000 to +0.066"]
