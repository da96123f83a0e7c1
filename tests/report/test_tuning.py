"""The best trial of a search is the method that would be ranked first."""

from __future__ import annotations

import math

import pytest

from oysterbench.report.tuning import best_of, mean_scores, trials_table
from oysterbench.results.comparison import boards
from tests.results.test_results import record


def detected(method: str, sequence: str, ap: float, failure: str | None = None):
    reasons = {"ap_mask": "there is nothing to find"} if math.isnan(ap) else {}
    metrics = {} if failure else {"ap_mask": ap}
    return record(
        track="detection", method=method, sequence=sequence, metrics=metrics, reasons=reasons, failure=failure
    )


def test_a_sequence_without_a_value_does_not_make_a_failure_the_best():
    trials = {"m": 0.6, "m[k=1]": 0.8}
    made = [detected(name, "a", ap) for name, ap in trials.items()]
    made += [detected(name, "empty", math.nan) for name in trials]
    made += [detected("m[k=9]", name, 0.0, "it crashed") for name in ("a", "empty")]
    names = {name: name for name in (*trials, "m[k=9]")}
    assert best_of(made, names) == ("m[k=1]", 0.8)
    assert mean_scores(made, names)["m[k=9]"] == 0.0
    assert [row.cells[0].value for row in trials_table(made, names).rows] == [1, 0, 2]


def test_a_trial_without_a_run_on_a_sequence_that_others_ran_on_has_no_mean():
    made = [detected("m", "easy", 0.9), detected("m", "hard", 0.3), detected("m[k=1]", "easy", 0.8)]
    names = {name: name for name in ("m", "m[k=1]")}
    assert best_of(made, names) == ("m", pytest.approx(0.6))
    assert math.isnan(mean_scores(made, names)["m[k=1]"])
    assert [row.cells[0].value for row in trials_table(made, names).rows] == [0, 1]


def test_the_best_trial_is_the_first_in_a_comparison():
    """Of IoU by pixels: what is right on many pixels counts more than what is right on few."""
    found = {"large": (0.8, 0.3), "small": (0.5, 0.9)}
    made = [
        record(track="segmentation", method=name, sequence=where, metrics={"iou": iou, "union_px": pixels})
        for name, values in found.items()
        for where, iou, pixels in zip("ab", values, (900, 100), strict=True)
    ]
    best, mean = best_of(made, {name: name for name in found})
    (board,) = boards(made)
    assert best == board.standings[0].label == "large"
    assert mean == pytest.approx(board.standings[0].over["iou"]) == pytest.approx(0.75)
