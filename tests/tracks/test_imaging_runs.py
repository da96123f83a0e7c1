"""Several runs on the same images are no further evidence: a sequence of a data set counts once, with all its runs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from oysterbench.evaluate.detection import DetectionScorer
from oysterbench.evaluate.detection.instances import from_planes
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage
from oysterbench.report import ImageRun, dataset_tables, html_report
from oysterbench.results.records import ResultRecord
from oysterbench.tracks import TRACKS
from tests.helpers.masks import truth_of

SCORERS = {"segmentation": ClipScorer, "detection": DetectionScorer}


def result(track, found, images=2):
    """The result on images of ten oysters in a row, of which the first `found` are found."""
    true = np.zeros((30, 100), np.int32)
    for k in range(10):
        true[10:16, 10 * k : 10 * k + 6] = k + 1
    scorer = SCORERS[track]()
    for name in map(str, range(images)):
        said = np.where(true <= found, true, 0)
        if track == "segmentation":
            scorer.add(truth_of(true > 0, name=name), EstimateImage(name, oyster=said > 0))
        else:
            scores = dict.fromkeys(range(1, 11), 0.9)
            scorer.add(from_planes(name, true), from_planes(name, said, scores=scores))
    return scorer.result()


def row_of(track, found, runs):
    """The row of a method that finds so many oysters on each sequence; in each of the runs, so many more."""
    made = [
        SimpleNamespace(record=SimpleNamespace(method="m", sequence=str(k)), result=result(track, count + more))
        for k, count in enumerate(found)
        for more in runs
    ]
    (row,) = TRACKS[track].dataset_rows(made)
    return row


@pytest.mark.parametrize("track", SCORERS)
def test_a_method_that_finds_the_same_in_each_run_has_the_row_of_one_run(track):
    once, thrice = (row_of(track, range(2, 9), runs) for runs in ((0,), (0, 0, 0)))
    assert (once.clips, thrice.clips, thrice.runs) == (7, 7, [3] * 7)
    assert thrice.metrics == pytest.approx(once.metrics, nan_ok=True)
    for key, interval in once.intervals.items():
        found = thrice.intervals[key]
        assert (found.low, found.high) == pytest.approx((interval.low, interval.high), nan_ok=True)
        assert found.reason == interval.reason
    key = "iou" if track == "segmentation" else "pq"
    assert once.intervals[key].known


@pytest.mark.parametrize("track", SCORERS)
def test_runs_make_no_interval_of_too_few_sequences_and_the_note_says_what_totals_are(track):
    row = row_of(track, (2, 5), (0, 1, 2))
    note = dataset_tables([row])[0].notes[0]
    assert note == (
        "All images of 2 sequences together, in 3 runs on each; totals are as of one run; 2 sequences: no 95% interval "
        "is possible with fewer than 6."
    )


def test_a_sequence_of_fewer_runs_counts_as_often_as_any_other():
    """A run that the machine lost has no result."""
    counts = [result("detection", found) for found in (9, 1)]
    whole = TRACKS["detection"].over_dataset("m", [[counts[0]] * 3, [counts[1]] * 2])
    even = TRACKS["detection"].over_dataset("m", [[counts[0]], [counts[1]]])
    assert whole.metrics == pytest.approx(even.metrics, nan_ok=True)
    assert whole.runs == [3, 2]
    several = [[result("detection", found)] * runs for found, runs in ((9, 3), (1, 2), (4, 2), (6, 3), (8, 1), (3, 1))]
    uneven, once = (TRACKS["detection"].over_dataset("m", made) for made in (several, [one[:1] for one in several]))
    for key, interval in once.intervals.items():
        found = uneven.intervals[key]
        assert (found.low, found.high) == pytest.approx((interval.low, interval.high), nan_ok=True)


def test_over_runs_that_differ_ratios_are_of_all_and_totals_their_means():
    row = row_of("segmentation", (2, 5), (0, 1, 2))
    assert row.metrics["iou"] == pytest.approx((2 + 3 + 4 + 5 + 6 + 7) / 60)
    assert (row.metrics["images"], row.metrics["truth_px"], row.metrics["estimate_px"]) == (4, 1440, 2 * 36 * (3 + 6))
    row = row_of("detection", (2, 5), (0, 1, 2))
    assert row.metrics["rq"] == pytest.approx(27 / (27 + 0.5 * (60 - 27)))
    assert [row.metrics[f"count_{key}"] for key in ("truth", "estimate", "error")] == [40, 18, -22]
    assert (row.metrics["images"], row.metrics["count_bias"]) == (4, pytest.approx(-5.5))


@pytest.mark.parametrize("track", SCORERS)
def test_totals_are_as_of_one_run_where_a_sequence_lacks_a_run(track):
    """The machine, not the method, failed there: it has no record."""
    made = [
        SimpleNamespace(record=SimpleNamespace(method="m", sequence=name), result=result(track, 4))
        for name, count in (("a", 3), ("b", 2))
        for _ in range(count)
    ]
    (row,) = TRACKS[track].dataset_rows(made)
    whole = row_of(track, (4, 4), (0,))
    assert row.metrics == pytest.approx(whole.metrics, nan_ok=True)
    assert "2 sequences together, in 2 to 3 runs on each; totals" in dataset_tables([row])[0].notes[0]


@pytest.mark.parametrize("track", SCORERS)
def test_a_method_that_lacks_a_sequence_is_in_no_table_over_the_data_set_of_those_that_ran_on_all(track):
    """The machine killed it there, as may be on a large and hard one, so that it has no record."""
    made = [
        SimpleNamespace(record=SimpleNamespace(method=method, sequence=name), result=result(track, found))
        for method, name, found in (("full", "easy", 9), ("full", "hard", 2), ("killed", "easy", 9))
    ]
    (row,) = TRACKS[track].dataset_rows(made)
    assert (row.method, row.clips) == ("full", 2)
    assert dataset_tables([row])[0].notes[1:] == ("Left out: killed, as it has no result on hard.",)
    failed = [
        SimpleNamespace(record=SimpleNamespace(method=method, sequence=f"s{k}"), result=what)
        for method, what in (("full", made[0].result), ("failed", None))
        for k in range(5)
    ]
    (row,) = TRACKS[track].dataset_rows([*made, *failed])
    assert dataset_tables([row])[0].notes[1] == (
        "Left out: killed, as it has no result on hard, s0, s1 and 3 more; failed, as it has no result on easy, hard, "
        "s0 and 4 more."
    )
    (alone,) = TRACKS[track].dataset_rows(made[2:])
    assert (alone.method, alone.clips) == ("killed", 1)
    assert len(dataset_tables([alone])[0].notes) == 1


@pytest.mark.parametrize("track", SCORERS)
def test_where_every_method_lacks_a_sequence_a_table_says_which_in_place_of_that_over_the_data_set(track):
    made = []
    for method, sequence in (("a", "s1"), ("b", "s2"), ("b", "s3")):
        scored = result(track, 9)
        about = {"track": track, "split": "", "metrics": scored.metrics, "reasons": scored.reasons}
        made.append(ImageRun(ResultRecord(sequence=sequence, method=method, **about), scored))
    found = TRACKS[track].show(made, (), None)
    assert found.data_set == []
    (table,) = found.first
    assert table.title == found.printed[0].title == "Over the data set"
    assert [row.values for row in table.rows] == [("a", "s2, s3"), ("b", "s1")]
    assert "No result on" in html_report(made, "oysterbench run", first=found.first)


def test_each_sequence_counts_once_in_the_curve_of_thresholds_whatever_its_number_of_runs():
    true = np.arange(100).reshape(10, 10) < 50
    clips = []
    for oyster, ground in ((0.9, 0.3), (0.35, 0.6)):
        scorer = ClipScorer()
        found = np.where(true, oyster, ground).astype(np.float32)
        scorer.add(truth_of(true), EstimateImage("a", probability=found))
        clips.append(scorer.result())
    rows = [
        TRACKS["segmentation"].over_dataset("m", [clips[:1] * a, clips[1:] * b]) for a, b in ((1, 1), (3, 1), (2, 3))
    ]
    for row in rows[1:]:
        assert row.metrics == pytest.approx(rows[0].metrics, nan_ok=True)
        np.testing.assert_array_equal(row.whole.curve.iou, rows[0].whole.curve.iou)
