"""COCO annotations of labelled frames."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import SequenceError
from oysterbench.sequence.export import export_sequence

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools


@pytest.fixture(scope="module")
def coco(folders):
    api = pytest.importorskip("pycocotools.coco")
    return api.COCO(str(folders["coco"] / "instances.json"))


def test_coco_loads_with_ids_from_1(coco, folders):
    assert sorted(coco.getImgIds()) == [1, 2, 3, 4]
    assert sorted(coco.getAnnIds()) == list(range(1, 9))
    assert {category["name"] for category in coco.loadCats(coco.getCatIds())} >= {"oyster", "stone", "plant"}
    assert min(coco.getCatIds()) == 1
    assert coco.loadCats([2])[0]["name"] == "oyster"
    for image in coco.loadImgs(coco.getImgIds()):
        assert (folders["coco"] / "images" / image["file_name"]).is_file()


def test_coco_polygons_give_back_each_mask(coco, sequence):
    labels = list(sequence.layer("cam_left", "instance"))
    for image, layer in zip(coco.loadImgs(coco.getImgIds()), labels, strict=True):
        assert image["stamp_ns"] == layer.stamp_ns
        assert image["clip"] == sequence.name
        found = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        assert {entry["instance"] for entry in found} == {7, 40_000}
        for entry in found:
            mask = layer.pixels == entry["instance"]
            assert np.array_equal(coco.annToMask(entry).astype(bool), mask)
            assert entry["area"] == mask.sum()
            assert entry["iscrowd"] == 0
            assert entry["category_id"] == 2
            assert entry["visibility"] == (0.5 if entry["instance"] == 7 else 1.0)
            y, x = np.nonzero(mask)
            assert entry["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
        assert len(found[0]["segmentation"]) == 2, "two pieces"


def test_coco_says_which_oysters_are_alive(coco, sequence):
    living = sequence.living()
    found = [one for one in coco.loadAnns(coco.getAnnIds()) if one["instance"] in living]
    assert {one["state"] for one in found} <= {"live", "dead"}
    assert all((one["state"] == "live") == living[one["instance"]] for one in found)
    assert len(found) == (0 if not living else len(coco.getAnnIds()))


def test_coco_images_are_the_frames_of_the_layers(coco, folders, sequence):
    frames = {image.stamp_ns: image.pixels for image in sequence.images("cam_left")}
    for image in coco.loadImgs(coco.getImgIds()):
        pixels = cv2.imread(str(folders["coco"] / "images" / image["file_name"]))
        assert np.array_equal(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), frames[image["stamp_ns"]])


@pytest.mark.parametrize("form", ["coco", "ply"])
def test_what_is_made_of_truth_cannot_be_had_without(sequence, tmp_path, form):
    with pytest.raises(SequenceError, match=r"truth.*no --no-truth, got --no-truth"):
        export_sequence(sequence, form, tmp_path / "out", truth=False)
    assert list(tmp_path.iterdir()) == []
