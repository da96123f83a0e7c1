"""COCO results are scored against COCO truth; what is left out, or cannot be scored, is named beside the numbers."""

from __future__ import annotations

import json

import numpy as np
import pytest

from oysterbench.annotations import truth as truth_module
from oysterbench.core.errors import LabelError, MethodError
from oysterbench.tracks import TRACKS
from oysterbench.tracks.images import SAMPLES
from tests.helpers.labelled_folders import write_png

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


def write(place, content, categories=({"id": 2, "name": "oyster"},)):
    """A COCO file of annotations of one image; the path."""
    images = [{"id": 1, "file_name": "a.png", "width": 60, "height": 20}]
    place.write_text(json.dumps({"images": images, "categories": categories, "annotations": content}))
    return place


@pytest.fixture
def score(tmp_path):
    def call(truth, estimate, track="detection", categories=({"id": 2, "name": "oyster"},)):
        place, mine = write(tmp_path / "truth.json", truth, categories), tmp_path / "mine.json"
        mine.write_text(json.dumps(estimate))
        found = TRACKS[track].score_files(place, mine, {})
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
    categories = [{"id": 0, "name": "reef"}, {"id": 2, "name": "oyster"}]
    wrong = [{**one, "category_id": 0} for one in items()]
    metrics, notes = score(items(), wrong, categories=categories)
    assert metrics["ap_mask"] == 0.0
    assert notes == "left out: all 5 results, of category_id 0 reef; in the ground truth, oysters are 2"
    whole = [{"id": 0, "name": "oysters"}, {"id": 2, "name": "oyster"}]
    metrics, notes = score(items(), wrong, categories=whole)
    assert (metrics["ap_mask"], notes) == (1.0, "")
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


@pytest.mark.parametrize("folder", [".", "images"])
@pytest.mark.parametrize("given", [".", "all.json"])
def test_images_beside_annotations_or_in_images_are_run_on(folder, given, tmp_path):
    write(tmp_path / "all.json", items())
    pixels = np.full((20, 60, 3), 7, np.uint8)
    write_png(tmp_path / folder / "a.png", pixels)
    track = TRACKS["detection"]
    (sequence,) = track.run_sequences(None, {"mine": tmp_path / given}, {})
    assert sequence.name == (tmp_path.name if given == "." else "all")
    ((name, found),) = sequence.labelled.pictures()
    assert (name, found.tolist()) == ("a", pixels.tolist())
    ((_, (truth, seen)),) = sequence.labelled.single()
    assert (truth.instances.max(), sequence.labelled.shown("a", seen).tolist()) == (5, pixels.tolist())
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "mine.json").write_text(json.dumps(items()))
    (run,) = track.score_files(tmp_path / given, tmp_path / "results" / "mine.json", {}).runs
    assert run.record.metrics["ap_mask"] == 1.0
    write_png(tmp_path / folder / "a.png", pixels + 1)
    (again,) = track.run_sequences(None, {"mine": tmp_path / given}, {})
    assert again.origin != sequence.origin


@pytest.mark.parametrize("track", ["detection", "segmentation"])
def test_annotations_are_scored_whatever_images_are_beside_them(track, tmp_path):
    truth, mine = write(tmp_path / "all.json", items()), tmp_path / "mine.json"
    mine.write_text(json.dumps(items()))

    def scored():
        (run,) = TRACKS[track].score_files(truth, mine, {}).runs
        return run, str(run.record.metrics), run.record.truth_digest

    alone, *known = scored()
    write_png(tmp_path / "a.png", np.full((20, 60, 3), 200, np.uint8))
    whole, *same = scored()
    assert same == known
    assert whole.samples[0].jpeg != alone.samples[0].jpeg
    write_png(tmp_path / "a.png", np.full((40, 120, 3), 200, np.uint8))
    scaled, *same = scored()
    assert same == known
    assert scaled.samples[0].jpeg == alone.samples[0].jpeg
    (sequence,) = TRACKS[track].run_sequences(None, {"mine": truth}, {})
    with pytest.raises(LabelError, match="expected 60 x 20 px, as the COCO file says, got 120 x 40"):
        list(sequence.labelled.pictures())


def test_only_the_images_that_are_shown_are_read(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(truth_module, "read_coco_picture", lambda file, image: read.append(file))
    truth, mine = tmp_path / "all.json", tmp_path / "mine.json"
    images = [{"id": k, "file_name": f"{k}.png", "width": 60, "height": 20} for k in range(9)]
    for k in range(9):
        (tmp_path / f"{k}.png").write_bytes(b"")
    document = {"images": images, "categories": [{"id": 2, "name": "oyster"}], "annotations": items()}
    for path in (truth, mine):
        path.write_text(json.dumps(document))
    TRACKS["detection"].score_files(truth, mine, {})
    assert 0 < len(read) <= SAMPLES


def test_two_clips_of_one_name_are_refused_before_anything_runs(tmp_path):
    places = {name: tmp_path / name for name in ("one", "two")}
    for place in places.values():
        place.mkdir()
        write(place / "all.json", items())
    with pytest.raises(MethodError, match="two sequences are named 'all': their results would overwrite each other"):
        TRACKS["detection"].run_sequences(None, {name: place / "all.json" for name, place in places.items()}, {})


def test_images_of_annotations_with_boxes_alone_are_run_on_too(tmp_path):
    write(tmp_path / "all.json", items(segmentation=[]))
    write_png(tmp_path / "a.png", np.zeros((20, 60, 3), np.uint8))
    (sequence,) = TRACKS["detection"].run_sequences(None, {"mine": tmp_path}, {})
    assert [pixels.shape for _, pixels in sequence.labelled.pictures()] == [(20, 60, 3)]


@pytest.mark.parametrize("track", ["detection", "segmentation"])
def test_annotations_that_cannot_be_scored_are_refused_before_anything_runs(track, tmp_path):
    """Not as a failure of each method, when all have run."""
    write(tmp_path / "all.json", [*items(), items()[0] | {"id": 9, "segmentation": [[1, 2, 3]]}])
    with pytest.raises(LabelError, match=r"all.json: annotations\[5\]: expected polygons of at least three corners"):
        TRACKS[track].run_sequences(None, {"mine": tmp_path / "all.json"}, {})
    write(tmp_path / "all.json", items(iscrowd="0"))
    with pytest.raises(
        LabelError, match=r"all.json: annotations\[0\]: expected 'iscrowd', 0 or 1 as a number, got '0'"
    ):
        TRACKS[track].run_sequences(None, {"mine": tmp_path / "all.json"}, {})


@pytest.mark.parametrize("changes", [{"bbox": []}, {"bbox": [-3, 5, 80, 8]}, {"area": None}])
def test_boxes_and_areas_are_not_looked_at_where_masks_alone_are_scored(tmp_path, changes):
    write(tmp_path / "all.json", items(**changes))
    (sequence,) = TRACKS["segmentation"].run_sequences(None, {"mine": tmp_path / "all.json"}, {})
    assert sequence.labelled.names == ("a",)


def test_boxes_alone_are_refused_before_anything_runs_where_masks_are_scored(tmp_path):
    write(tmp_path / "all.json", items(segmentation=[]))
    with pytest.raises(LabelError, match=r"annotations\[0\]: has no segmentation.* use `--track detection`"):
        TRACKS["segmentation"].run_sequences(None, {"mine": tmp_path / "all.json"}, {})


def test_annotations_without_their_images_say_where_these_belong(tmp_path):
    (sequence,) = TRACKS["detection"].run_sequences(None, {"mine": write(tmp_path / "all.json", items())}, {})
    with pytest.raises(LabelError, match=r"a: expected an image .* their file_name, beside these or in images/ there"):
        sequence.write_input("images", tmp_path / "out", None)
