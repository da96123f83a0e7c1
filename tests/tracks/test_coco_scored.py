"""COCO results are scored against COCO truth; what is left out, or cannot be scored, is named beside the numbers."""

from __future__ import annotations

import json

import pytest

from oysterbench.tracks import TRACKS

SQUARES = [[10 * k, 5, 8, 8] for k in range(5)]


def corners(box):
    x, y, w, h = box
    return [[x, y, x + w, y, x + w, y + h, x, y + h]]


def items(**changes):
    """An annotation for each square; changes: of the first."""
    found = [
        {"id": k + 1, "image_id": 1, "category_id": 2, "bbox": box, "segmentation": corners(box), "score": 0.9}
        for k, box in enumerate(SQUARES)
    ]
    return [found[0] | changes, *found[1:]]


@pytest.fixture
def score(tmp_path):
    def call(truth, estimate, track="detection", categories=({"id": 2, "name": "oyster"},)):
        images = [{"id": 1, "file_name": "a.png", "width": 60, "height": 20}]
        document = {"images": images, "categories": categories, "annotations": truth}
        places = [tmp_path / "truth.json", tmp_path / "mine.json"]
        for place, content in zip(places, (document, estimate), strict=True):
            place.write_text(json.dumps(content))
        found = TRACKS[track].score_files(*places, {})
        (run,) = found.runs
        notes = " ".join(run.record.notes)
        assert all(note in " ".join(found.printed[0].notes) for note in run.record.notes)
        return run.record.metrics, notes.replace(str(tmp_path) + "/", "")

    return call


def test_results_of_other_categories_are_left_out_and_counted(score):
    fish = {**items()[0], "category_id": 1, "bbox": [0, 0, 3, 3], "segmentation": corners([0, 0, 3, 3])}
    metrics, notes = score(items(), [*items(), fish, fish])
    assert metrics["ap_mask"] == 1.0
    assert metrics["count_estimate"] == 5
    assert notes == (
        "left out: 2 of 7 results, of category_id 1; the ground truth knows only 2 oyster (mine.json: [5] and 1 more)"
    )
    assert score(items(), [*items(), fish], "segmentation")[0]["iou"] == 1.0
    metrics, notes = score(items(), [{**one, "category_id": 0} for one in items()])
    assert metrics["ap_mask"] == 1.0
    assert notes == "all results have category_id 0, taken for the ground truth's 2 oyster"
    assert score(items(), items())[1] == ""


def test_results_without_any_of_the_category_of_oysters_are_said_to_be_left_out(score):
    """As Roboflow exports ground truth: with a category 0 of the whole set, for which a program took its only class."""
    categories = [{"id": 0, "name": "oysters"}, {"id": 2, "name": "oyster"}]
    wrong = [{**one, "category_id": 0} for one in items()]
    metrics, notes = score(items(), wrong, categories=categories)
    assert metrics["ap_mask"] == 0.0
    assert notes == "left out: all 5 results, of category_id 0 oysters; in the ground truth, oysters are 2"
    for given in (items(), [*items(), *wrong], []):
        assert score(items(), given, categories=categories)[1] == ""


def test_an_oyster_of_the_truth_without_a_mask_is_named_as_the_reason_for_missing_metrics(score):
    metrics, notes = score(items(segmentation=[]), items())
    assert metrics["ap_mask"] != metrics["ap_mask"]
    assert metrics["ap_box"] == 1.0
    why = "no metrics of masks, as oysters of the ground truth have a box alone: 1 of 5 (truth.json: annotations[0])"
    assert notes == f"{why}; outline or remove them"


def test_a_result_without_a_mask_is_named_and_the_others_keep_theirs(score):
    metrics, notes = score(items(), items(segmentation=[]))
    assert metrics["ap_mask"] == pytest.approx(0.642, abs=0.001)  # among equal scores, the first is wrong
    assert notes == "oysters with a box alone overlap no mask: 1 of 5 (mine.json: [0])"
