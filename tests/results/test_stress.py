"""Which disturbance breaks which method, and from which strength on."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

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


def test_of_several_runs_means_are_shown_so_that_a_method_that_fails_now_and_then_looks_so():
    flaky = [0.9, 0.9, 0.9, 0.9, 0.3, 0.3, 0.3]
    failing = [0.9, 0.9, 0.9, None, None, None, None]
    several = [replace(one, run=k) for k, scores in enumerate((flaky, flaky, failing)) for one in runs("flaky", scores)]
    (board,) = boards([*runs("steady", STEADY), *several])
    plumes, blur = disturbances(board)
    assert plumes.scores["flaky"] == pytest.approx((0.9, 0.9, 0.9, 0.6))
    assert blur.scores["flaky"] == pytest.approx((0.9, 0.2, 0.2, 0.2))
    standing = next(row for row in board.standings if row.label == "flaky")
    assert standing.over["score"] == pytest.approx((3 * 0.9 + 0.6 + 3 * 0.2) / 7), "as it is ranked"


def test_a_method_is_not_broken_at_a_strength_at_which_it_was_not_run():
    (board,) = boards([*runs("steady", STEADY), *runs("short", FRAGILE)[:2], *runs("gone", FRAGILE)[:3]])
    plumes, blur = disturbances(board)
    assert [plumes.breaks_at(label) for label in ("short", "gone")] == [None, 2]
    assert blur.breaks_at("short") is None


def test_without_a_calm_dive_it_is_not_said_that_there_is_nothing_to_break():
    (board,) = boards([*runs("steady", STEADY), *runs("late", FRAGILE)[1:]])
    table = stress_table(board)
    assert table is not None
    cell = table.rows[0].cells[[each.key for each in table.columns].index("late")]
    assert (cell.kind, cell.small) == ("", "no calm dive")


def test_the_plots_over_conditions_show_means_of_the_runs():
    depths = [
        record(sequence=f"d{k}", run=run, metrics={"score": score, "coverage": 1.0}, conditions={"depth_m": float(k)})
        for k in range(6)
        for run, score in enumerate((0.9, 0.9, 0.3))
    ]
    page = html_report([SlamRun(one) for one in depths], "command")
    assert ": 2, 0.7</title>" in page
    assert ": 2, 0.9</title>" not in page
