"""Counts as tables, annotations and a page that says what its numbers are worth."""

from __future__ import annotations

import csv
import json
import re
import shutil

import numpy as np
import pytest
from msgspec.structs import replace

from oysterbench.annotations.coco_set import coco_set
from oysterbench.counting.accuracy import Accuracy
from oysterbench.counting.least import EVERY_SIZE, Least
from oysterbench.counting.per_picture import plain
from oysterbench.counting.reading import Sampling
from oysterbench.counting.run import Counting, Settings
from oysterbench.counting.sources import find_sources
from oysterbench.counting.store import Store
from oysterbench.counting.survey import survey
from oysterbench.report.bars import count_bins, histogram_plot
from oysterbench.report.counting import Making, write_counts
from oysterbench.report.counting_page import drawn, evenly
from tests.helpers.image_methods import Boxed
from tests.helpers.people_pictures import Discs, discs, write, write_video
from tests.helpers.weights_made import FIGURE

PLACES = [(20, 30), (60, 30), (100, 30), (0, 90)]


@pytest.fixture
def folder(tmp_path):
    """Eight pictures of one to four discs, one strange, one broken, and a video of two seconds."""
    for k in range(7):
        write(tmp_path / "in" / f"{k} <ü>.png", discs(*PLACES[: k % 4 + 1]))
    write(tmp_path / "in" / "strange.png", discs())
    (tmp_path / "in" / "broken.jpg").write_bytes(b"\xff\xd8 no more")
    write_video(tmp_path / "in" / "dive.avi", [discs((60, 60))] * 20)
    return tmp_path / "in"


def counts(folder, out, method=None, accuracy=None, figures=(), **settings):
    method, store = method or Discs(), Store(out)
    counted = Counting(
        find_sources([folder]).sources, method, {"method": method.name}, store, Settings(**settings)
    ).run()
    further = {"accuracy": accuracy, "figures": figures, "least": settings.get("least", EVERY_SIZE)}
    found = survey("in", method.name, counted.pictures, counted.failures, **further)
    said = {"threshold": 0.5, "scale": {"kind": "plain", "mm_per_px": 2.0} if "scale" in settings else None}
    making = Making("oysterbench segment in", {"method": method.name, "versions": {}, "files": {}}, said)
    write_counts(found, counted, store, making, with_coco=True)
    return found


def table(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_tables_have_a_line_per_picture_and_oyster_and_leave_empty_what_is_not_known(folder, tmp_path):
    out = tmp_path / "out"
    counts(folder, out)
    pictures = {row["image"]: row for row in table(out / "images.csv")}
    assert list(pictures)[-1] == "broken"
    assert "ends before" in pictures["broken"]["failure"]
    assert pictures["broken"]["oysters"] == ""
    assert (pictures["3 <ü>"]["oysters"], pictures["3 <ü>"]["cut_by_edge"], pictures["3 <ü>"]["live"]) == (
        "4",
        "1",
        "2",
    )
    assert (pictures["strange"]["unlike"], pictures["0 <ü>"]["unlike"]) == ("yes", "no")
    assert pictures["0 <ü>"]["area_m2"] == pictures["0 <ü>"]["oysters_per_m2"] == ""
    assert (pictures["dive.avi/000010"]["frame"], float(pictures["dive.avi/000010"]["time_s"])) == ("10", 1.0)
    oysters = table(out / "oysters.csv")
    assert len(oysters) == sum(int(row["oysters"] or 0) for row in pictures.values())
    assert {row["state"] for row in oysters} == {"live", "dead"}
    assert oysters[0]["length_mm"] == ""


def test_a_scale_fills_in_areas_densities_and_lengths(folder, tmp_path):
    counts(folder, tmp_path, scale=plain(2.0))
    first = table(tmp_path / "images.csv")[0]
    assert float(first["area_m2"]) == pytest.approx(0.24 * 0.32)
    assert float(first["oysters_per_m2"]) == pytest.approx(1 / (0.24 * 0.32), abs=1e-3)
    assert float(table(tmp_path / "oysters.csv")[0]["length_mm"]) == pytest.approx(42, abs=2)
    assert json.loads((tmp_path / "summary.json").read_text())["measures"]["per_m2"]["value"] > 0


def test_without_oysters_the_tables_still_have_their_heads(tmp_path):
    write(tmp_path / "in" / "a.png", discs())
    counts(tmp_path / "in", tmp_path / "out")
    assert (tmp_path / "out" / "oysters.csv").read_text().startswith("image,time_s,number,")
    assert table(tmp_path / "out" / "oysters.csv") == []


def test_annotations_give_back_every_mask(tmp_path):
    pytest.importorskip("pycocotools")
    write(tmp_path / "out" / "images" / "a.png", discs(*PLACES))
    counts(tmp_path / "out" / "images", tmp_path / "out")
    (image,) = coco_set(tmp_path / "out" / "instances.json")
    assert np.array_equal(image.oysters, discs(*PLACES)[..., 0] > 0)
    assert image.instances.max() == 4
    first = json.loads((tmp_path / "out" / "instances.json").read_text())["annotations"][0]
    assert (first["score"], first["live"], first["iscrowd"]) == (0.9, 0.0, 0)


def test_annotations_name_files_as_they_are_called(tmp_path):
    names = ["a.jpg", "a.png", "b.png.png", "deep er/c.tif"]
    for name in names:
        write(tmp_path / "in" / name, discs(*PLACES))
    counts(tmp_path / "in", tmp_path / "out")
    written = json.loads((tmp_path / "out" / "instances.json").read_text())["images"]
    assert sorted(one["file_name"] for one in written) == names
    shutil.copy(tmp_path / "out" / "instances.json", tmp_path / "in")
    assert len(coco_set(tmp_path / "in" / "instances.json")) == 4


def test_annotations_of_boxes_have_no_masks(tmp_path):
    write(tmp_path / "in" / "a.png", discs(*PLACES))
    counts(tmp_path / "in", tmp_path / "out", Boxed())
    annotations = json.loads((tmp_path / "out" / "instances.json").read_text())["annotations"]
    assert len(annotations) == 4
    assert not any("segmentation" in one for one in annotations)
    assert "% covered" not in (tmp_path / "out" / "index.html").read_text()


def words(path):
    """What a page says, without its pictures."""
    text = re.sub(r"<style>.*?</style>|src=\"data:[^\"]*\"", "", path.read_text(), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", text).split())


def test_the_page_says_what_its_numbers_are_worth(folder, tmp_path):
    counts(folder, tmp_path)
    page, said = (tmp_path / "index.html").read_text(), words(tmp_path / "index.html")
    assert "18 oysters in 8 images and 2 frames of 1 video, by discs." in said
    assert "1 could not be counted" in said
    assert "1 of 10 images are unlike the training data of discs" in said
    assert "how to measure it" in said
    assert "oysterbench run discs --track detection --on LABELLED --out check" in said
    assert 'href="videos/dive.avi.mp4"' in page
    assert page.count("data:image/jpeg;base64,") == 10, "each picture once"
    assert "&lt;ü&gt;" in page
    assert "<ü>" not in page
    assert not re.search(r'(src|href)="(?!data:|#|overlays/|videos/)', page), "nothing from elsewhere"


def test_the_page_says_how_far_counts_are_off_where_that_was_measured(folder, tmp_path):
    counts(folder, tmp_path, accuracy=Accuracy(200.0, 230.0, "my-labels", True))
    said = words(tmp_path / "index.html")
    assert (
        "(my-labels), discs counted 230 oysters where 200 are labelled: 15 % too many, but with different weights"
        in said
    )
    assert "how to measure it" not in said


@pytest.mark.parametrize(("counted", "error"), [(200.0, "as many."), (199.0, "0.5 % too few.")])
def test_a_count_that_is_right_is_not_called_too_few(folder, tmp_path, counted, error):
    counts(folder, tmp_path, accuracy=Accuracy(200.0, counted, "mine", threshold=0.5))
    assert f"where 200 are labelled: {error}" in words(tmp_path / "index.html")


def test_the_page_says_how_the_check_counted_otherwise(folder, tmp_path):
    counts(folder, tmp_path, accuracy=Accuracy(200.0, 230.0, "mine", threshold=0.5), least=Least(area_px=49.0))
    told = "15 % too many. Unlike this page, that check counts what is smaller than 49 px, too."
    assert told in words(tmp_path / "index.html")
    counts(folder, tmp_path, accuracy=Accuracy(200.0, 230.0, "mine", threshold=0.25))
    assert "that check counts from a score of 0.25, not 0.5." in words(tmp_path / "index.html")
    counts(folder, tmp_path, accuracy=Accuracy(200.0, 230.0, "mine", threshold=0.5))
    assert "Unlike this page" not in words(tmp_path / "index.html")


def test_the_summary_leaves_open_what_a_method_cannot_tell(folder, tmp_path):
    counts(folder, tmp_path / "told")
    assert json.loads((tmp_path / "told" / "summary.json").read_text())["dead"] > 0
    counts(folder, tmp_path / "boxed", Boxed())
    summary = json.loads((tmp_path / "boxed" / "summary.json").read_text())
    assert (summary["live"], summary["dead"]) == (None, None)


def test_the_page_says_what_the_card_of_the_weights_says(folder, tmp_path):
    bias = replace(FIGURE, method="discs", track="detection", metric="count_bias", heading="Count bias", unit="oysters")
    counts(folder, tmp_path, figures=[replace(bias, value=2.5, low=1.0, high=4.0)])
    said = words(tmp_path / "index.html")
    assert "on other images than yours: count bias on seg-val 2.500 oysters (1.000 to 4.000) per image." in said


def test_the_page_of_a_method_that_does_not_know_the_strange_says_so(folder, tmp_path):
    counts(folder, tmp_path, Boxed())
    assert "boxed has no test of whether images are unlike" in words(tmp_path / "index.html")


def test_a_page_of_nothing_but_failures_is_a_page(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "broken.jpg").write_bytes(b"\xff\xd8 no more")
    found = counts(tmp_path / "in", tmp_path / "out", sampling=Sampling(1.0))
    assert found.pictures == ()
    assert "Nothing could be counted." in words(tmp_path / "out" / "index.html")


def test_a_page_shows_some_of_many_pictures_evenly(folder, tmp_path):
    found = counts(folder, tmp_path)
    some = [one.name for one in evenly(found.pictures, 3)]
    assert some == [found.pictures[k].name for k in (0, 4, 9)]
    assert evenly(found.pictures, 50) == list(found.pictures)
    assert evenly([], 3) == []


def test_pictures_to_be_labelled_are_drawn_at_random_and_always_the_same():
    names = [f"{k:03d}" for k in range(200)]
    some = drawn(names)
    assert some == drawn(names) == sorted(set(some))
    assert len(some) == 20
    assert 60 < np.mean([int(name) for name in some]) < 140
    assert drawn(names[:3]) == names[:3]
    assert drawn([]) == []


@pytest.mark.parametrize(("most", "width"), [(0, 1), (23, 1), (24, 2), (100, 5), (12345, 1000)])
def test_a_histogram_has_whole_bins_that_hold_every_count(most, width):
    values = [0, most, most // 2]
    edges, heights = count_bins(values)
    assert edges[1] - edges[0] == width
    assert sum(heights) == 3
    assert len(heights) <= 24
    assert histogram_plot(values, "t", "x", "y").count("<title>") == len(set(np.digitize(values, edges)))
