"""What a rendered sequence tells of its images: names, masks, sizes, and how much seabed they show."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.annotations import open_labelled, open_truth
from oysterbench.annotations.truth import footprint_m2, footprint_rays
from oysterbench.cli.labelled import open_training_data
from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import transform
from oysterbench.sequence import CameraCalibration
from oysterbench.tracks.detection import TRACK as DETECTION
from oysterbench.tracks.segmentation import TRACK as SEGMENTATION

HEIGHT, WIDTH, FOCAL = 240, 320, 200.0


def camera(**options):
    matrix = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return CameraCalibration(WIDTH, HEIGHT, 1.0, matrix, np.zeros(5), np.eye(4), **options)


def test_photos_without_labels_are_not_taken_for_masks(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    pixels = np.random.default_rng(0).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "reef.png"), pixels)
    with pytest.raises(
        LabelError, match=r"masks of one channel, got the colour image reef\.png: .*oysterbench segment"
    ):
        open_truth(tmp_path)
    cv2.imwrite(str(tmp_path / "reef.png"), np.repeat(pixels[..., :1] // 128, 3, axis=2))
    assert [one.names for one in open_truth(tmp_path)] == [("reef",)]


def test_the_seabed_in_view_is_that_of_a_plane_below():
    down = transform(Rotation.from_euler("x", 180, degrees=True).as_matrix(), np.array([3.0, 4.0, -1.0]))
    level = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    expected = (WIDTH - 1) * (HEIGHT - 1) * (2.0 / FOCAL) ** 2
    assert footprint_m2(level, footprint_rays(camera()), down) == pytest.approx(expected, rel=1e-9)
    # Seen obliquely, a level bottom 2 m below shows the area between where the corners' rays meet it.
    tilt = Rotation.from_euler("x", 150, degrees=True)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], axis=-1) @ tilt.as_matrix().T
    depth = (-2.0 / rays[..., 2]).astype(np.float32)
    corners = [(rays * depth[..., None])[i, j, :2] for i, j in ((0, 0), (0, -1), (-1, -1), (-1, 0))]
    x, y = np.array(corners).T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    pose = transform(tilt.as_matrix(), np.zeros(3))
    assert footprint_m2(depth, footprint_rays(camera()), pose) == pytest.approx(area, rel=1e-5)


def test_behind_a_flat_port_less_is_in_view():
    level = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    open_water, behind_glass = (
        footprint_m2(level, footprint_rays(camera(**port)), np.eye(4))
        for port in ({}, {"port_m": 0.02, "port_index": 1.33})
    )
    assert 0.4 < behind_glass / open_water < 1 / 1.33**2 + 0.02


def test_empty_water_has_no_seabed():
    assert footprint_m2(np.zeros((HEIGHT, WIDTH), np.float32), footprint_rays(camera()), np.eye(4)) is None


def test_a_sequence_is_a_clip_with_the_truth_that_training_has(tiny_file):
    (clip,) = open_truth(tiny_file)
    labelled, living = open_labelled(tiny_file), oysterbench.open(tiny_file).living()
    assert clip.names == tuple(entry.name for entry in labelled.entries)
    assert clip.name == "tiny-01"
    for (truth, pixels), image in zip(clip.images(), labelled, strict=True):
        assert truth.name == image.name
        assert np.array_equal(pixels, image.pixels)
        assert np.array_equal(truth.oyster, image.oysters)
        ignored = np.zeros_like(image.ignore) if truth.ignore is None else truth.ignore
        assert np.array_equal(ignored, image.ignore)
        singles = [one for one in clip.instances(truth).instances if not one.crowd]
        assert len(singles) == len(np.unique(image.instances[(image.instances > 0) & image.oysters]))
        numbers = np.unique(truth.instances[truth.oyster & (truth.instances > 0)])
        assert np.isfinite(truth.heights_mm[numbers]).all()
        assert {number: truth.live[number] == 1 for number in numbers.tolist()}.items() <= living.items()
        assert [one.live for one in singles] == [float(living[number]) for number in numbers.tolist()]
        assert truth.footprint_m2 > 0.1  # a camera that looks ahead sees far


def test_a_true_mask_of_several_numbers_is_told_what_helps_for_truth(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.array([[0, 128, 255]], np.uint8))
    (clip,) = open_truth(tmp_path)
    with pytest.raises(LabelError, match=r"got 0, 128, 255\.\.\.; .*--ignore-value.*--truth-kind.*COCO") as error:
        list(clip.images())
    assert "--estimate-kind" not in str(error.value)
    (clip,) = open_truth(tmp_path, ignore_value=128)
    assert next(clip.images())[0].ignore.sum() == 1


def test_numbered_masks_of_a_labelled_folder_are_told_where_numbers_belong(tmp_path):
    for kind in ("images", "masks"):
        (tmp_path / kind).mkdir()
        cv2.imwrite(str(tmp_path / kind / "a.png"), np.array([[0, 1, 2]], np.uint16))
    with pytest.raises(LabelError, match=r"got \[1, 2\]; put numbers of oysters in instances/"):
        open_labelled(tmp_path)[0]


def sided(folder, text, *kinds):
    """A folder of three small images, of the kinds given, with that manifest."""
    for kind in kinds:
        (folder / kind).mkdir(exist_ok=True)
        for name in "abc":
            cv2.imwrite(str(folder / kind / f"{name}.png"), np.array([[0, 255, 255]], np.uint8))
    (folder / "manifest.csv").write_text(f"id,clip,split\n{text}")
    return folder


@pytest.mark.parametrize("labels", [("images", "masks"), ("plain",)])
def test_only_the_test_side_of_a_manifest_is_scored_and_that_is_said(tmp_path, labels):
    form = "plain/{0},one,{1}\n" if labels == ("plain",) else "{0},one,{1}\n"

    def clips(*sides):
        text = "".join(form.format(name, side) for name, side in zip("abc", sides, strict=True))
        return open_truth(sided(tmp_path, text, *labels))

    (clip,) = clips("train", "test", "test")
    assert [name[-1] for name in clip.names] == ["b", "c"]
    assert [truth.name[-1] for truth, _ in clip.images()] == ["b", "c"]
    assert clip.sides == "only images of the side test are scored, 2 in all, and not 1 of train"
    assert {name[-1] for name in clip.unscored} == {"a"}
    (clip,) = clips("train", "train", "val")
    assert len(clip.names) == 3
    assert clip.sides == (
        "no image is on a side test, so all are scored, 2 of train, 1 of val: a method may have learnt from them"
    )
    (clip,) = clips("a", "b", "b")
    assert "1 of a, 2 of b: a method may have learnt from them" in clip.sides
    for sides in (("Train", "TEST", "Test"), (" train", " test", "test ")):
        (clip,) = clips(*sides)
        assert [name[-1] for name in clip.names] == ["b", "c"], "as spreadsheets and people write them"
    for sides in (("", "", ""), ("test", "test", "test")):
        (clip,) = clips(*sides)
        assert (len(clip.names), clip.sides, clip.unscored) == (3, "", frozenset())


def test_nothing_is_said_of_sides_where_there_is_no_manifest(tmp_path):
    (sided(tmp_path, "", "plain") / "manifest.csv").unlink()
    (clip,) = open_truth(tmp_path / "plain")
    assert (len(clip.names), clip.sides, clip.unscored) == (3, "", frozenset())


@pytest.mark.parametrize("pictures", [False, True])
def test_of_coco_annotations_with_sides_the_test_side_is_scored_and_not_what_train_learns_from(tmp_path, pictures):
    images = [
        {"id": k, "file_name": f"{name}.png", "width": 3, "height": 1} | ({"split": side} if side else {})
        for k, (name, side) in enumerate({"a": "Train ", "b": " Test", "c": ""}.items())
    ]
    document = {"images": images, "annotations": [], "categories": [{"id": 1, "name": "oyster"}]}
    (tmp_path / "all.json").write_text(json.dumps(document))
    if pictures:
        for name in "abc":
            cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((1, 3), np.uint8))
        assert [entry.name for entry in open_training_data([str(tmp_path)]).entries] == ["a"]
    (clip,) = open_truth(tmp_path)
    assert (clip.names, clip.unscored) == (("b",), {"a", "c"})
    assert [truth.name for truth, _ in clip.images()] == ["b"]
    assert clip.sides == "only images of the side test are scored, 1 in all, and not 1 of train, 1 of no side"


@pytest.mark.parametrize("track", [SEGMENTATION, DETECTION])
def test_predictions_for_images_of_other_sides_are_no_error_and_results_say_what_was_scored(tmp_path, track):
    truth = sided(tmp_path, "a,one,train\nb,one,test\nc,two,test\n", "images", "masks", "instances", "predicted")
    evaluation = track.score_files(truth, tmp_path / "predicted", {})
    assert [record.sequence for record in evaluation.records] == ["one", "two"]
    for record in evaluation.records:
        assert any(note.startswith("only images of the side test") for note in record.notes)
    for path in (tmp_path / "predicted").glob("b.png"):
        path.unlink()
    with pytest.raises(LabelError, match="no prediction for b"):
        track.score_files(truth, tmp_path / "predicted", {})
