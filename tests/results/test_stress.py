"""Which disturbance breaks which method, and from which strength on."""

from __future__ import annotations

import math

from oysterbench.report import SlamRun
from oysterbench.report.html import html_report
from oysterbench.report.stress import stress_group, stress_table
from oysterbench.results.comparison import boards
from oysterbench.results.stress import disturbances
from tests.results.test_results import record

DIVES = [("calm", "none", 0)] + [(f"{name}-{k}", name, k) for name in ("plumes", "blur") for k in (1, 2, 3)]


def runs(method: str, scores):
    """A record for each of DIVES; a score of None is a failed run."""
    return [
        record(
            method=method,
            sequence=name,
            conditions={"disturbance": disturbance, "strength": strength},
            metrics={} if score is None else {"score": score, "coverage": 1.0},
            failure="lost" if score is None else None,
        )
        for (name, disturbance, strength), score in zip(DIVES, scores, strict=True)
    ]


STEADY = [0.9, 0.9, 0.85, 0.8, 0.9, 0.88, 0.86]
FRAGILE = [0.9, 0.8, 0.3, None, 0.85, 0.3, 0.7]


def stressed():
    (board,) = boards([*runs("steady", STEADY), *runs("fragile", FRAGILE)])
    return board


def test_each_disturbance_starts_from_the_calm_dive():
    plumes, blur = disturbances(stressed())
    assert (plumes.name, plumes.strengths) == ("plumes", (0, 1, 2, 3))
    assert plumes.scores["steady"] == (0.9, 0.9, 0.85, 0.8)
    assert blur.scores["fragile"] == (0.9, 0.85, 0.3, 0.7)


def test_a_failed_run_scores_zero_at_its_strength():
    assert disturbances(stressed())[0].scores["fragile"][-1] == 0.0


def test_a_method_is_broken_from_the_strength_on_at_which_it_stays_below_half_of_its_calm_score():
    plumes, blur = disturbances(stressed())
    assert plumes.breaks_at("fragile") == 2
    assert blur.breaks_at("fragile") is None  # it comes back at the strongest
    assert plumes.breaks_at("steady") is None


def test_a_method_that_fails_the_calm_dive_withstands_nothing():
    (board,) = boards([*runs("steady", STEADY), *runs("crashing", [None] * 7), *runs("late", FRAGILE)[1:]])
    for disturbance in disturbances(board):
        assert [disturbance.can_break(label) for label in ("steady", "crashing", "late")] == [True, False, False]
        assert [disturbance.breaks_at(label) for label in ("steady", "crashing", "late")] == [None, None, None]
    table = stress_table(board)
    assert table is not None
    column = [each.key for each in table.columns].index("crashing")
    assert {(row.cells[column].kind, row.cells[column].small) for row in table.rows} == {("warn", "nothing to break")}


def test_a_dive_that_a_method_was_not_run_on_leaves_a_gap():
    (board,) = boards([*runs("steady", STEADY), *runs("short", FRAGILE)[:-1]])
    blur = disturbances(board)[1]
    assert math.isnan(blur.scores["short"][-1])
    assert blur.scores["steady"][-1] == 0.86


def test_a_split_without_a_calm_dive_has_no_figure_of_disturbances():
    (board,) = boards(runs("steady", STEADY)[1:])
    assert disturbances(board) == []
    assert stress_table(board) is None
    assert stress_group(board, {"steady": 1}) is None


def test_the_report_shows_a_plot_and_a_row_for_each_disturbance():
    records = [*runs("steady", STEADY), *runs("fragile", FRAGILE)]
    page = html_report([SlamRun(each, None, []) for each in records], "command")
    assert "against the strength of each disturbance alone" in page
    (board,) = boards(records)
    table = stress_table(board)
    assert table is not None
    assert [row.cells[0].value for row in table.rows] == ["plumes", "blur"]
    assert table.rows[0].cells[2].small == "broken from 2"
