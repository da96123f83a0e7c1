"""What is told of a method that loses some sequences: how many, and its errors on the others."""

from __future__ import annotations

import math
from dataclasses import replace

from oysterbench.report.tables import results_table, standings_table
from oysterbench.results.card_figures import card_figures
from oysterbench.results.comparison import as_plain, boards
from oysterbench.results.lost import lost_sequences
from oysterbench.results.records import ResultRecord, aggregate, write_results

DIVERGED = {"score": 0.0004, "ate_percent": 34000.0, "ate_rmse_m": 51000.0, "coverage": 0.9, "realtime_factor": 2.0}


def result(sequence: str, ate_percent: float, **changes) -> ResultRecord:
    metrics = {"score": 1 / (1 + ate_percent), "ate_percent": ate_percent, "ate_rmse_m": 1.5 * ate_percent}
    metrics |= {"coverage": 1.0, "realtime_factor": 1.0}
    return ResultRecord(
        **{"track": "slam", "split": "s", "sequence": sequence, "method": "m", "metrics": metrics} | changes
    )


HELD = [result(f"val-0{i}", ate) for i, ate in enumerate((0.1, 0.2, 0.3, 0.4, 0.5))]
SOME = [*HELD, result("val-5", 0, metrics=DIVERGED), result("val-6", 0, metrics={}, failure="it crashed")]


def test_a_sequence_that_diverged_and_one_that_failed_are_lost():
    (row,) = aggregate(SOME)
    assert row["lost"] == ["val-5", "val-6"]
    assert row["sequences"] == 7


def test_errors_are_medians_over_what_is_not_lost_and_all_else_means_over_everything():
    (row,) = aggregate(SOME)
    assert row["metrics"]["ate_percent"] == 0.3
    assert math.isclose(row["metrics"]["coverage"], (5 + 0.9) / 7)
    assert row["statistics"]["ate_percent"]["mean"] > 5000


def test_the_card_of_weights_has_no_interval_of_means_beside_a_median(tmp_path):
    weights = {"weights": {"w": "ab" * 32}}
    write_results(tmp_path / "results.json", [replace(one, method_settings=weights) for one in SOME[:-1]])
    figures = {figure.metric: figure for figure in card_figures(tmp_path, "w", "ab" * 32)}
    error, score = figures["ate_rmse_m"], figures["score"]
    assert math.isclose(error.value, 1.5 * 0.3)
    assert error.low is error.high is None
    assert score.low is not None
    assert score.low < score.value < score.high


def test_a_method_that_lost_everything_has_no_errors_and_says_why():
    (row,) = aggregate([result("val-5", 0, metrics=DIVERGED)])
    assert row["metrics"]["ate_percent"] is None
    assert row["reasons"]["ate_percent"] == "every sequence is lost"


def test_the_mean_over_runs_decides_whether_a_sequence_is_lost():
    assert lost_sequences({"a": [0.6, 0.0], "b": [0.4, 0.0]}, "slam") == ("b",)


def test_tracks_whose_errors_are_bounded_know_no_loss():
    assert lost_sequences({"a": [0.0]}, "segmentation") is None


def test_standings_and_results_say_how_many_are_lost_and_the_same_error():
    (board,) = boards(SOME)
    standings, results = standings_table(board), results_table(SOME)
    headings = [column.key for column in standings.columns]
    shown = dict(zip(headings, standings.texts[0], strict=True))
    assert (shown["lost"], shown["ate_percent"]) == ("2", "0.30")
    assert any("score below 0.25 is lost" in note for note in standings.notes)
    assert results.texts[-1][0] == "over 7, 2 lost"
    assert results.texts[-1][[column.key for column in results.columns].index("ate_rmse_m")] == "0.450"
    assert as_plain(board)["standings"][0]["metrics"]["ate_percent"] == 0.3
