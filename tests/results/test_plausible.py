"""Numbers that cannot be are refused, and all that a program has computed pass."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.slam.metrics import RECALL_PERCENTS
from oysterbench.results.plausible import check_plausible
from oysterbench.results.records import ResultRecord

RECORDS = sorted((Path(__file__).parents[2] / "leaderboard" / "records").glob("*.json"))


MADE = {
    "detection": {"ap_mask": 0.03, "ap50_mask": 0.1, "pq": 0.12, "sq": 0.6, "rq": 0.2},
    "steering": {"skill": 0.33, "joint_accuracy": 0.2, "yaw_accuracy": 0.5, "pitch_accuracy": 0.4},
}
"""Numbers that hold together, of tracks of which the board need not have records."""


def results() -> list[ResultRecord]:
    return [ResultRecord.from_dict(row) for path in RECORDS for row in json.loads(path.read_bytes())["results"]]


def test_every_metric_that_a_run_writes_has_a_definition():
    """Reported results with another one are refused, and a report could not say what it is."""
    written = {(one.track, key) for one in results() for key in one.metrics}
    assert {track for track, _ in written} >= {"slam", "segmentation", "detection", "steering"}
    assert [one for one in sorted(written) if find_metric(one[1], one[0]) is None] == []


@pytest.fixture(scope="module")
def scored() -> dict[str, ResultRecord]:
    """One of each track, of a run that was not lost: what is wrong of it says something only where it was right."""
    made = [ResultRecord(track=track, split="s", sequence="a", method="m", metrics=of) for track, of in MADE.items()]
    found = [*made, *results()]
    return {one.track: one for one in found if one.failure is None and one.metrics.get("score", 1.0) > 0.5}


@pytest.mark.parametrize("track", MADE)
def test_numbers_that_hold_together_pass(track, scored):
    check_plausible(scored[track])


def test_all_that_is_on_the_board_can_be():
    for one in results():
        check_plausible(one)


@pytest.mark.parametrize(
    ("track", "metrics", "said"),
    [
        ("slam", {"score": 1e308}, r"metric 'score': expected 0 to 1, got 1e\+308"),
        ("slam", {"score": 5.0}, "metric 'score': expected 0 to 1, got 5"),
        ("slam", {"ate_rmse_m": -1.0}, "metric 'ate_rmse_m': expected 0 or more, got -1"),
        ("slam", {"coverage": 7.0}, "metric 'coverage': expected 0 to 1, got 7"),
        ("slam", {"score": 1.0, "recall_0.5percent": 0.0}, "the score does not belong to the recalls"),
        ("slam", {"recall_5percent": 0.0}, "expected recall_2percent <= recall_5percent"),
        ("slam", {"ate_percent": 1e-4}, "expected ate_percent = 100 ate_rmse_m / path_length_m"),
        ("slam", {"ate_rmse_m": 0.0}, "expected ate_mean_m <= ate_rmse_m"),
        ("slam", {"realtime_factor": 1e12}, r"metric 'realtime_factor': expected 0 to 100000, got 1e\+12"),
        ("slam", {"wall_s": 1e-12}, "metric 'wall_s': expected 1e-05 or more, got 1e-12"),
        ("slam", {"cpu_s": 0.0}, "metric 'cpu_s': expected 1e-05 or more, got 0"),
        ("slam", {"peak_memory_mb": 0.001}, r"metric 'peak_memory_mb': expected 1 to 1e\+08, got 0.001"),
        ("slam", {"wall_s": 12345.0}, "expected realtime_factor = duration_s / wall_s, got"),
        ("slam", {"cpu_s": 12345.0}, "expected cpu_s_per_s = cpu_s / duration_s, got"),
        ("segmentation", {"iou": 0.999}, "expected iou <= precision"),
        ("segmentation", {"dice": 0.99}, "expected dice = "),
        ("segmentation", {"truth_px": -1e5}, "metric 'truth_px': expected 0 or more, got -100000"),
        ("segmentation", {"scored_images": -1.0}, "metric 'scored_images': expected 0 or more, got -1"),
        ("segmentation", {"union_px": 1e308}, r"metric 'union_px': expected -1e\+100 to 1e\+100, got 1e\+308"),
        ("detection", {"ap_mask": 0.99}, "expected ap_mask <= ap50_mask"),
        ("steering", {"skill": 1.5}, "metric 'skill': expected 1 or less"),
        ("steering", {"joint_accuracy": 1.0}, "expected joint_accuracy <= yaw_accuracy"),
    ],
)
def test_what_cannot_be_is_named(track, metrics, said, scored):
    with pytest.raises(ResultError, match=said):
        check_plausible(replace(scored[track], metrics={**scored[track].metrics, **metrics}))


def test_a_run_that_failed_may_have_cost_nothing(scored):
    metrics = {"wall_s": 0.0, "cpu_s": 0.0, "peak_memory_mb": 0.0, "score": 0.0, "coverage": 0.0}
    check_plausible(replace(scored["slam"], failure="it ended at once", metrics=metrics))


@given(st.lists(st.floats(0, 30), min_size=1, max_size=40), st.integers(0, 20), st.sampled_from([0.5, 1.0, 2.0]))
def test_scores_of_any_errors_lie_between_the_bounds_of_their_recalls(errors, silent, scale):
    percent = np.array(errors)
    stamps = len(errors) + silent
    metrics = {f"recall_{limit:g}percent": float((percent <= limit).sum() / stamps) for limit in RECALL_PERCENTS}
    metrics |= {"coverage": len(errors) / stamps, "score": float((1 / (1 + percent / scale)).sum() / stamps)}
    settings = {"recall_scale_percent": scale}
    check_plausible(
        ResultRecord(
            track="slam", split="slam-val", sequence="val-01", method="carp", metrics=metrics, settings=settings
        )
    )
