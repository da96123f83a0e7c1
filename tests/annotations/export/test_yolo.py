"""YOLO: polygons that give back each oyster, boxes around them, and clips that stay on one side."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from oysterbench.annotations import open_labelled, open_truth
from oysterbench.annotations.export import export_set
from oysterbench.annotations.export.examples import examples, key_of, parted
from oysterbench.annotations.export.yolo import joined_polygon, oyster_masks, with_val
from oysterbench.annotations.image import Entry, joined
from oysterbench.annotations.yolo import read_yolo
from oysterbench.core.errors import LabelError
from oysterbench.core.polygons import mask_polygons, rasterise
from oysterbench.counting.sources import find_sources
from tests.helpers.labelled_folders import yolo_folder

OYSTER = {0: "oyster"}


@pytest.fixture(scope="module")
def labelled(dive_file):
    return open_labelled(dive_file)


@pytest.fixture(scope="module")
def folder(labelled, tmp_path_factory):
    return export_set([labelled], "yolo", tmp_path_factory.mktemp("yolo") / "out")[0]


def found(folder: Path, key: str, ending: str) -> Path:
    (path,) = folder.glob(f"segment/{ending}/*/{key}.*")
    return path


def test_polygons_give_back_each_oyster_of_several_pieces_too(labelled, folder):
    pieces = 0
    for example in examples(labelled.entries):
        polygons = read_yolo(found(folder, example.key, "labels"), OYSTER)
        masks = list(oyster_masks(example))
        assert len(polygons) == len(masks) > 0
        for polygon, mask in zip(polygons, masks, strict=True):
            height, width = mask.shape
            assert np.array_equal(rasterise(polygon * [width, height], height, width), mask)
            pieces = max(pieces, len(mask_polygons(mask)))
    assert pieces > 1


def test_pieces_with_holes_are_joined_by_slits_that_cover_nothing():
    mask = np.zeros((40, 60), dtype=bool)
    mask[5:25, 5:25], mask[10:15, 10:18] = True, False
    mask[2:8, 40:55] = mask[30:38, 30:33] = True
    polygons = [np.array(polygon).reshape(-1, 2) for polygon in mask_polygons(mask)]
    assert len(polygons) == 3
    assert np.array_equal(rasterise(joined_polygon(polygons), *mask.shape), mask)


def test_boxes_are_around_the_same_oysters(labelled, folder):
    for example in examples(labelled.entries):
        (path,) = folder.glob(f"detect/labels/*/{example.key}.txt")
        rows = np.loadtxt(path, ndmin=2)
        assert (rows[:, 0] == 0).all()
        height, width = example.image.classes.shape
        for (_, x, y, w, h), mask in zip(rows, oyster_masks(example), strict=True):
            at = np.argwhere(mask)
            low, high = at.min(axis=0), at.max(axis=0) + 1
            np.testing.assert_allclose([x * width, y * height], (low + high)[::-1] / 2, atol=1e-4)
            np.testing.assert_allclose([w * width, h * height], (high - low)[::-1], atol=1e-4)


@pytest.mark.parametrize("task", ["segment", "detect"])
def test_data_yaml_leads_to_pictures_that_have_labels(folder, task):
    data = yaml.safe_load((folder / task / "data.yaml").read_text())
    assert data["names"] == {0: "oyster"}
    for part in ("train", "val"):
        pictures = sorted((folder / task / data[part]).iterdir())
        labels = sorted((folder / task / data[part].replace("images", "labels")).iterdir())
        assert [path.stem for path in pictures] == [path.stem for path in labels]
        assert pictures


def test_a_picture_takes_its_room_once(folder):
    for path in (folder / "segment" / "images").rglob("*.png"):
        assert os.path.samefile(path, folder / "detect" / path.relative_to(folder / "segment"))


def entry(name: str, clip: str) -> Entry:
    return Entry(name, clip, lambda: pytest.fail("it was read"), (Path("x.mcap"),))


def test_whole_clips_are_kept_for_validation_and_always_the_same():
    entries = [entry(f"clip-{k}/{n}", f"clip-{k}") for k in range(10) for n in range(3)]
    parts, notes = with_val({"train": entries})
    clips = {part: {one.clip for one in of} for part, of in parts.items()}
    assert len(clips["val"]) == 2
    assert not clips["val"] & clips["train"]
    assert len(parts["train"]) + len(parts["val"]) == 30
    assert "val is 2 of 10 clips" in notes[0]
    backwards, _ = with_val({"train": entries[::-1]})
    assert {one.clip for one in backwards["val"]} == clips["val"]


def test_where_clips_are_not_known_neighbours_by_name_stay_together_and_that_is_said():
    parts, notes = with_val({"train": [entry(f"{n:02d}", f"{n:02d}") for n in (3, 1, 2, 0, 4, 5, 6, 7, 8, 9)]})
    assert [one.name for one in parts["val"]] == ["08", "09"]
    assert len(parts["train"]) == 8
    assert "which images are of one clip is not known: val is the last 2 by name" in notes[0]
    assert "a column clip in manifest.csv" in notes[0]


def test_of_several_videos_the_ends_are_taken_and_that_is_said():
    names = [f"GX{video}_{k:06}" for video in range(8) for k in range(100 + 40 * video)]
    parts, notes = with_val({"train": [entry(name, name) for name in names]})
    assert {part: len(of) for part, of in parts.items()} == {"train": 1536, "val": 384}
    assert "val is the ends of 8 runs, 384 images, and may show the same ground as train" in notes[0]


def test_a_clip_that_is_named_after_its_first_image_is_kept_together_too():
    entries = [entry(f"dive{d}-{n:03}", f"dive{d}-000") for d in range(5) for n in range(10)]
    parts, notes = with_val({"train": entries})
    assert len({one.clip for one in parts["val"]}) == 1
    assert len(parts["val"]) == 10
    assert [note[:26] for note in notes] == ["val is 1 of 5 clips of tra"]


@pytest.mark.parametrize("clips", [1, 10])
def test_beside_clips_that_are_known_images_without_one_stay_together(clips):
    """And none of them is drawn alone, as a clip, from between two of train."""
    video = [entry(f"frame_{n:03}", f"frame_{n:03}") for n in range(100)]
    dives = [entry(f"dive-{k}/{n}", f"dive-{k}") for k in range(clips) for n in range(10)]
    parts, notes = with_val({"train": [*video, *dives]})
    held = [one.name for one in parts["val"]]
    assert [name for name in held if name.startswith("frame")] == [f"frame_{n:03}" for n in range(80, 100)]
    assert len(held) == 20 + (2 if clips == 1 else 20)
    assert len(notes) == 2
    assert "which images are of one clip is not known: val is the last 20 by name" in notes[1]


def test_the_only_clip_is_divided_by_time_and_that_is_said():
    parts, notes = with_val({"train": [entry(f"a/{n}", "a") for n in range(10)]})
    assert [one.name for one in parts["val"]] == ["a/8", "a/9"]
    assert "resembles the rest" in notes[0]
    parts, _ = with_val({"train": [entry("a/0", "a")]})
    assert parts["train"] == parts["val"]


def test_of_the_only_clip_all_cameras_are_divided_at_the_same_time():
    parts, _ = with_val({"train": [entry(f"a/{camera}/{n}", "a") for camera in "xy" for n in range(10)]})
    assert [one.name for one in parts["val"]] == ["a/x/8", "a/x/9", "a/y/8", "a/y/9"]
    parts, _ = with_val({"train": [entry(f"a/{camera}/{n}", "a") for camera in "xy" for n in range(3)]})
    assert [one.name for one in parts["val"]] == ["a/x/2", "a/y/2"]
    parts, _ = with_val({"train": [entry(f"a/{camera}/{n}", "a") for camera in "xy" for n in range(2)]})
    assert [one.name for one in parts["val"]] == ["a/x/1", "a/y/1"]


@pytest.mark.parametrize("count", [2, 4, 100])
def test_of_the_only_clip_some_images_are_left_to_train_on_whatever_their_names(count):
    for form in ("{:04}/left", "site{}-2024", "a/{}"):
        parts, _ = with_val({"train": [entry(form.format(n), "a") for n in range(count)]})
        assert (len(parts["train"]), len(parts["val"])) == (count - max(1, count // 5), max(1, count // 5))


def test_a_part_for_validation_is_taken_as_it_is():
    parts = {"train": [entry("a/0", "a")], "val": [entry("b/0", "b")]}
    assert with_val(parts) == (parts, [])


def pictures(folder: Path) -> list[str]:
    images = folder / "segment" / "images"
    return sorted(path.relative_to(images).as_posix() for path in images.rglob("*.png"))


def test_folders_called_as_roboflow_calls_them_are_these_parts(tmp_path):
    sides = ("train", "valid", "test")
    sets = [open_labelled(yolo_folder(tmp_path / "reef" / side, {f"of-{side}": ""})) for side in sides]
    out, notes = export_set(sets, "yolo", tmp_path / "out")
    assert pictures(out) == ["test/of-test.png", "train/of-train.png", "val/of-valid.png"]
    assert notes == ["1 train, 1 val, 1 test; class 0 is oyster"]


def test_images_of_one_name_in_several_sets_are_named_after_their_sets(tmp_path):
    """Such as frames of several videos; and sets of one name are numbered, as where they are trained on."""
    manifest = "id,clip\nframe_1,dive\nframe_2,dive\n"
    names = dict.fromkeys(("frame_1", "frame_2"), "")
    one, two = (open_labelled(yolo_folder(tmp_path / side / "reef", names, manifest)) for side in "ab")
    out, notes = export_set([one, two], "yolo", tmp_path / "out")
    assert len(pictures(out)) == 4
    assert {path.partition("/")[2] for path in pictures(out)} == {
        f"{name}_frame_{k}.png" for name in ("reef", "reef-2") for k in (1, 2)
    }
    assert notes[1].startswith("val is 1 of 2 clips of train: reef")
    with pytest.raises(
        LabelError, match=r"two images have the same name, frame_1 and frame_1: .* overlapping sets given"
    ):
        export_set([one, one], "yolo", tmp_path / "other")


def test_the_number_of_a_set_leads_to_the_name_of_no_other(tmp_path):
    places = ("x/reef", "y/reef", "z/reef-2", "w/reef-2")
    sets = [open_labelled(yolo_folder(tmp_path / place, {"a": ""})) for place in places]
    names = [entry.name for entry in joined(sets, "all").entries]
    assert names == ["reef/a", "reef-3/a", "reef-2/a", "reef-2-2/a"]


@pytest.mark.parametrize("side", ["valid", "Validation", "val"])
def test_the_side_for_validation_is_that_of_a_manifest_whatever_it_is_called(side, tmp_path):
    manifest = f"id,clip,split\na,one,train\nb,two,train\nc,three,{side}\n"
    source = yolo_folder(tmp_path / "reef", dict.fromkeys("abc", ""), manifest)
    out, _ = export_set([open_labelled(source)], "yolo", tmp_path / "out")
    assert pictures(out) == ["train/a.png", "train/b.png", "val/c.png"]


@pytest.mark.parametrize("side", ["test", "spring"])
def test_without_a_side_for_training_no_other_is_trained_on_and_that_is_said(side, tmp_path):
    source = yolo_folder(tmp_path / "reef", {"a": ""}, f"id,clip,split\na,one,{side}\n")
    out, notes = export_set([open_labelled(source)], "yolo", tmp_path / "out")
    for task in ("segment", "detect"):
        data = yaml.safe_load((out / task / "data.yaml").read_text())
        assert (data["train"], data["val"], data[side]) == ("images/train", f"images/{side}", f"images/{side}")
        assert [path.name for path in (out / task / "images").iterdir()] == [side]
        assert [(one.name, one.split) for one in open_labelled(out / task).entries] == [(f"{side}/a", side)]
    assert notes[1].startswith("no image is of a side train")


@pytest.mark.parametrize("below", ["", "segment"])
def test_what_is_written_is_read_back_with_its_sides(below, labelled, folder):
    """Given the folder of the export, or that of the polygons in it, which has the same oysters as that of boxes."""
    back = open_labelled(folder / below)
    assert (back.name, len(back)) == (below or folder.name, len(labelled))
    assert set(back.splits) == {"train", "val"}
    before = {key_of(image.name): image for image in labelled}
    for image in back:
        source = before[image.name.partition("/")[2]]
        assert np.array_equal(image.pixels, source.pixels)
        assert np.array_equal(image.oysters, source.oysters)
    (clip,) = open_truth(folder / below)
    assert len(clip.names) == len(back)


def test_boxes_that_are_written_are_a_ground_truth_for_single_oysters(labelled, folder):
    (clip,) = open_truth(folder / "detect")
    assert len(clip.names) == len(labelled)
    masks = {key_of(image.name): image.instances * image.oysters for image in labelled}
    for (found, seen), (name, pixels) in zip(clip.single(), clip.pictures(), strict=True):
        assert (seen, name) == (None, found.name)
        numbers = masks[name.partition("/")[2]]
        assert pixels.shape[:2] == numbers.shape
        assert len(found.instances) == len(np.unique(numbers[numbers > 0]))
        for one, number in zip(found.instances, np.unique(numbers[numbers > 0]), strict=True):
            rows, columns = np.nonzero(numbers == number)
            left, top = columns.min(), rows.min()
            expected = (left, top, columns.max() + 1 - left, rows.max() + 1 - top)
            assert one.box == pytest.approx(expected, abs=0.01)
    with pytest.raises(LabelError, match=r"labels/\w+/.*\.txt:1: has no segmentation: .* use `--track detection`"):
        clip.check_annotations(masks=True)
    clip.check_annotations(masks=False)


def test_a_file_under_two_names_is_counted_once(folder):
    found = find_sources([folder])
    assert len(found.sources) == len(found.repeated) == len(pictures(folder))


def test_the_part_of_a_folder_of_sequences_is_that_of_its_whole_name(dive_file, tmp_path):
    folder = tmp_path / "reef.v2-test"
    folder.mkdir()
    (folder / dive_file.name).symlink_to(dive_file)
    assert list(parted([open_labelled(folder)])) == ["test"]


def test_names_become_names_of_files():
    assert key_of("set/a b/cam.left/17") == "set_a-b_cam-left_17"
    assert key_of("牡蛎 (1)/कि\u3000é\udcff.x") == "牡蛎--1-_कि-é--x"
