"""Labelled folders: each file in them is read, or refused by its name, whatever program wrote it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oysterbench.annotations import open_labelled, open_predictions, open_truth
from oysterbench.annotations.manifest import side_in
from oysterbench.core.errors import LabelError
from oysterbench.counting.sources import find_sources
from tests.helpers.labelled_folders import HEIGHT, WIDTH, picture, write_png, yolo_folder

TRIANGLE = " 0.25 0.25 0.75 0.25 0.75 0.75\n"
MASK = np.zeros((HEIGHT, WIDTH), np.uint8)
MASK[4:20, 8:40] = 255


def mask_folder(folder, *names):
    for k, name in enumerate(names):
        write_png(folder / "images" / f"{name}.png", picture(k))
        write_png(folder / "masks" / f"{name}.png", MASK)
    return folder


@pytest.mark.parametrize("kind", ["instances", "ignore"])
@pytest.mark.parametrize("name", ["a.tif", "a.bmp", "a.jpg"])
def test_numbers_and_ignored_pixels_in_another_format_are_refused(kind, name, tmp_path):
    write_png(mask_folder(tmp_path, "a") / kind / name, MASK)
    with pytest.raises(LabelError, match=rf"{kind}/{name}: expected \.png files alone, named as the images"):
        open_labelled(tmp_path)


@pytest.mark.parametrize("kind", ["instances", "ignore"])
def test_numbers_and_ignored_pixels_of_no_image_are_refused(kind, tmp_path):
    for name in ("a", "a_inst"):
        write_png(mask_folder(tmp_path, "a") / kind / f"{name}.png", MASK // 255)
    with pytest.raises(LabelError, match=rf"{kind}/a_inst\.png: no image a_inst in images/"):
        open_labelled(tmp_path)


def test_oysters_are_numbered_in_all_images_or_none_and_files_of_the_system_are_none(tmp_path):
    for kind in ("instances", "ignore"):
        write_png(mask_folder(tmp_path, "a", "b") / kind / "a.png", MASK // 255)
        (tmp_path / kind / ".DS_Store").write_bytes(b"x")
    with pytest.raises(LabelError, match=r"image b has no instances/b\.png, but others do; expected all or none"):
        open_labelled(tmp_path)
    write_png(tmp_path / "instances" / "b.png", MASK // 255)
    assert [bool(one.ignore.any()) for one in open_labelled(tmp_path)] == [True, False]


@pytest.mark.parametrize("layer", ["images", "masks", "instances", "ignore"])
def test_files_in_folders_below_are_refused_by_name_and_other_folders_are_none_of_the_set(layer, tmp_path):
    """As only those in images/ itself are read, and others would be left out."""
    for kind in ("images", "masks", "instances", "ignore"):
        write_png(tmp_path / kind / "a.png", MASK if kind == "masks" else MASK // 255)
    (tmp_path / layer / "old").mkdir()
    for name in ("notes.txt", "Thumbs.db", "._b.png"):
        (tmp_path / layer / "old" / name).write_bytes(b"x")
    for name in ("Thumbs.db", "desktop.ini"):
        (tmp_path / layer / name).write_bytes(b"x")
    write_png(tmp_path / layer / ".ipynb_checkpoints" / "a-checkpoint.png", MASK)
    assert len(open_labelled(tmp_path)) == 1
    write_png(tmp_path / layer / "sub" / "b.png", MASK)
    with pytest.raises(
        LabelError, match=rf"{layer}/sub/b\.png: expected .*\.png files in {layer}/ itself, and none in"
    ):
        open_labelled(tmp_path)


def test_files_of_systems_are_in_the_way_of_no_set(tmp_path):
    """Of macOS on a disk of another kind, of network storage, of Windows."""
    for place in (mask_folder(tmp_path / "masks", "a"), yolo_folder(tmp_path / "yolo", {"a": "0" + TRIANGLE})):
        for folder in place.iterdir():
            write_png(folder / "@eaDir" / "a.jpg" / "SYNOPHOTO_THUMB_M.png", MASK)
            (folder / "@eaDir" / "a.txt").touch()
            write_png(folder / "$RECYCLE.BIN" / "b.png", MASK)
            write_png(folder / "__MACOSX" / "images" / "a.png", MASK)
            (folder / "lost+found").mkdir()
            (folder / "old.png").mkdir()
        (place / "._dive.mcap").write_bytes(b"x")
        (place / "._instances.json").write_bytes(b"x")
        assert [entry.name for entry in open_labelled(place).entries] == ["a"]
        assert [one.names for one in open_truth(place)] == [("a",)]
    assert [one.name for one in find_sources([tmp_path / "masks"]).sources] == ["images/a"]


def test_text_files_below_labels_are_refused_where_they_may_be_the_labels_of_an_image(tmp_path):
    folder = yolo_folder(tmp_path, {"a": "0" + TRIANGLE})
    (folder / "labels" / "old").mkdir()
    (folder / "labels" / "old" / "readme.txt").touch()
    assert len(open_labelled(folder)) == 1
    (folder / "labels" / "old" / "a.txt").touch()
    with pytest.raises(LabelError, match=r"labels/old/a\.txt: expected \.txt files in labels/ itself"):
        open_labelled(folder)


def test_of_a_folder_of_sets_one_is_named(tmp_path):
    for side in ("train", "valid"):
        yolo_folder(tmp_path / side, {"a": "0" + TRIANGLE})
    for opened in (open_labelled, open_truth):
        with pytest.raises(LabelError, match=rf"got none of them itself, .* give one below, as {tmp_path}/train$"):
            opened(tmp_path)


def test_masks_in_hidden_folders_are_neither_predictions_nor_truth(tmp_path):
    folder = tmp_path / ".set"
    for name in ("a", ".ipynb_checkpoints/a-checkpoint", "deep/b", "deep/.trash/c"):
        write_png(folder / f"{name}.png", MASK)
    assert open_predictions(folder).names == ("a", "deep/b")
    assert sorted(name for one in open_truth(folder) for name in one.names) == ["a", "deep/b"]


@pytest.mark.parametrize("mode", ["LA", "RGBA", "RGBA on black"])
def test_a_mask_that_is_painted_in_the_transparency_is_refused(mode, tmp_path):
    """As white paint on a transparent white ground; as black paint on a transparent black one."""
    from PIL import Image

    paint = Image.fromarray(np.full_like(MASK, 0 if "black" in mode else 255))
    planes = [paint] * (1 if mode == "LA" else 3)
    painted = Image.merge(mode.partition(" ")[0], (*planes, Image.fromarray(MASK)))
    painted.save(mask_folder(tmp_path / "set", "a") / "masks" / "a.png")
    with pytest.raises(LabelError, match=r"masks/a\.png: expected one channel, got transparency"):
        open_labelled(tmp_path / "set")[0]
    with pytest.raises(LabelError, match=r"a\.png: expected one channel, got transparency"):
        open_predictions(tmp_path / "set" / "masks").get("a")
    with pytest.raises(LabelError, match=r"a\.png: expected one channel, got transparency"):
        list(open_truth(tmp_path / "set" / "masks")[0].images())


@pytest.mark.parametrize("opacity", [np.full_like(MASK, 255), MASK, MASK // 2])
def test_a_mask_whose_transparency_says_the_same_or_nothing_is_read(opacity, tmp_path):
    cv2.imwrite(str(mask_folder(tmp_path, "a") / "masks" / "a.png"), np.dstack([MASK] * 3 + [opacity]))
    assert np.array_equal(open_labelled(tmp_path)[0].oysters, MASK > 0)


@pytest.mark.parametrize("twice", ["images/a.JPG", "images/a.jpeg", "labels/a.TXT"])
def test_two_files_for_one_image_are_refused(twice, tmp_path):
    folder = yolo_folder(tmp_path, {"a": ""})
    (folder / twice).write_bytes(b"")
    with pytest.raises(LabelError, match=r"a\.\w+: expected one file named a here, got a\.\w+, too"):
        open_labelled(folder)


@pytest.mark.parametrize("heading", ["id,clip,Split", "ID,Clip,SPLIT"])
def test_columns_of_a_manifest_are_known_in_either_case(heading, tmp_path):
    manifest = f"{heading}\na,one,train\nb,two,test\n"
    folder = yolo_folder(tmp_path, {"a": "", "b": ""}, manifest)
    assert open_labelled(folder).splits == ("train", "test")
    assert [one.names for one in open_truth(folder)] == [("b",)]


def test_a_manifest_with_two_columns_of_one_name_is_refused(tmp_path):
    folder = yolo_folder(tmp_path, {"a": ""}, "id,clip,split,Split\na,one,test,train\n")
    with pytest.raises(LabelError, match=r"manifest\.csv:1: expected one column split, got 2"):
        open_labelled(folder)


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("seg-train", "train"),
        ("valid", "val"),
        ("reef_Validation", "val"),
        ("reef.v2-TEST", "test"),
        ("instances_val2017", "val"),
        ("contest", ""),
        ("test-hard", ""),
        ("rétest", ""),
    ],
)
def test_a_name_says_its_side_as_a_last_word_of_its_own(name, side):
    assert side_in(name) == side
