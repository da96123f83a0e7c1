"""A ratio over a data set is the mean of its clips' ratios weighed by their denominators, and so is its interval."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import ResultError
from oysterbench.core.streams import stream
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage
from oysterbench.evaluate.segmentation.dataset import over_dataset
from oysterbench.evaluate.statistics import compare, summarise
from oysterbench.results.records import ResultRecord, aggregate, mean_weights
from tests.helpers.masks import truth_of

A, OF_A = {"a": [0.5], "b": [1.0]}, {"a": [2.0], "b": [6.0]}
B, OF_B = {"a": [0.5], "b": [0.25]}, {"a": [4.0], "b": [4.0]}


def test_a_mean_is_weighed_and_so_is_the_difference_of_two():
    assert summarise(A, OF_A).mean == pytest.approx((1 + 6) / 8)
    found = compare(A, B, "higher", (OF_A, OF_B))
    assert found.difference == pytest.approx(7 / 8 - 3 / 8)
    assert (found.wins, found.ties, found.losses) == (1, 1, 0)


def test_equal_weights_are_no_weights():
    rng = stream(1, b"", "weighed")
    sample = {str(k): [float(v)] for k, v in enumerate(rng.random(9))}
    even = {name: [3.0] for name in sample}
    plain, weighed = summarise(sample), summarise(sample, even)
    assert weighed.mean == pytest.approx(plain.mean)
    assert weighed.interval.low == pytest.approx(plain.interval.low)
    assert weighed.interval.high == pytest.approx(plain.interval.high)


def test_runs_without_weight_leave_the_plain_mean():
    assert summarise({"a": [1.0], "b": [1.0]}, {"a": [0.0], "b": [0.0]}).mean == 1.0
    assert summarise({"a": [1.0], "b": [0.0]}, {"a": [1.0], "b": [-1.0]}).mean == 0.5


def test_a_run_without_value_and_weight_leaves_its_sequence_the_weight_of_the_others():
    nan = float("nan")
    assert summarise({"a": [0.5, nan], "b": [1.0]}, {"a": [2.0, nan], "b": [6.0]}).mean == pytest.approx((1 + 6) / 8)


def test_records_say_the_same_as_the_counts_that_they_are_of():
    rng = stream(2, b"", "weighed")
    clips = []
    for _ in range(7):
        scorer = ClipScorer()
        for k in range(3):
            true = rng.random((12, 12)) < rng.random()
            scorer.add(truth_of(true, name=str(k)), EstimateImage(str(k), oyster=true ^ (rng.random((12, 12)) < 0.2)))
        clips.append(scorer.result())
    records = [
        ResultRecord(
            track="segmentation", split="s", sequence=str(k), method="m", metrics=clip.metrics, reasons=clip.reasons
        )
        for k, clip in enumerate(clips)
    ]
    (found,) = aggregate(records)
    whole = over_dataset(clips)
    for key in ("iou", "dice", "precision", "recall", "boundary_iou", "image_iou", "cover"):
        assert found["metrics"][key] == pytest.approx(whole.whole.metrics[key]), key
    interval = found["statistics"]["iou"]["interval"]
    assert (interval["low"], interval["high"]) == pytest.approx(
        (whole.intervals["iou"].low, whole.intervals["iou"].high)
    )


def test_a_failed_run_pulls_the_data_set_down_by_what_it_missed():
    rows = [("1", {"iou": 0.8, "union_px": 100.0}, None), ("2", {"union_px": 300.0}, "crashed")]
    records = [
        ResultRecord(track="segmentation", split="s", sequence=name, method="m", metrics=metrics, failure=failure)
        for name, metrics, failure in rows
    ]
    (found,) = aggregate(records)
    assert found["metrics"]["iou"] == pytest.approx(0.2)


def test_a_value_without_its_weight_is_refused():
    record = ResultRecord(track="segmentation", split="s", sequence="1", method="m", metrics={"iou": np.float64(0.5)})
    with pytest.raises(ResultError, match="m on 1 has iou, but not union_px"):
        mean_weights([record], "iou")
