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


@pytest.mark.parametrize("place", [".", ".."])
@pytest.mark.parametrize(
    ("name", "text"), [("classes.txt", "barnacle\nOyster\n\n"), ("data.yml", "names: [barnacle, oyster]\n")]
)
def test_classes_have_the_names_of_other_files_too(name, text, place, tmp_path):
    folder = yolo_folder(tmp_path / "train", {"a": "0" + TRIANGLE, "b": "1" + TRIANGLE})
    before = open_labelled(folder).digest()
    (folder / place / name).write_text(text)
    found = open_labelled(folder)
    assert [bool(one.oysters.any()) for one in found] == [False, True]
    assert found.digest() != before


@pytest.mark.parametrize("name", ["reef", "reef-test"])
@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("classes.txt", "person\ncar\n"),
        ("classes.txt", "oyster\n"),
        ("coco128.yaml", "names: [person]\n"),
        ("coco128.yaml", "names: {\n"),
    ],
)
def test_class_names_beside_a_folder_that_is_no_part_of_an_export_are_of_other_sets(file, text, name, tmp_path):
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / file).write_text(text)
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("classes.txt", "barnacle\noyster\n"),
        ("data.yaml", "names: [barnacle, oyster]\ntrain: train/images\n"),
        ("reef.yml", "names: [barnacle, oyster]\n"),
    ],
)
def test_class_names_beside_a_folder_that_may_be_of_it_or_not_are_refused(file, text, tmp_path):
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE})
    (tmp_path / file).write_text(text)
    with pytest.raises(LabelError, match=rf"{file}: expected the names of the classes of reef/ in data\.yaml there"):
        open_labelled(folder)
    (folder / "data.yaml").write_text("names: [oyster]\n")
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("reef-train", ""),
        ("train2", ""),
        ("training", "train: ../training/images\n"),
        ("fold0", "train: [fold1/images, fold0/images]\nval: fold2/images\n"),
        ("all", "val: C:\\sets\\all\\images\n"),
        ("set", "path: ../data/set\ntrain: images\n"),
    ],
)
def test_a_data_yaml_above_is_of_a_folder_that_it_names_or_whose_name_ends_in_a_side(name, text, tmp_path):
    """Where the folder has barnacles alone, nothing else would tell that they are no oysters."""
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / "data.yaml").write_text(f"{text}names: [barnacle, oyster]\n")
    assert not open_labelled(folder)[0].oysters.any()


def sides_folder(root, *sides, prefix=""):
    """A YOLO data set with images/SIDE/ and labels/SIDE/, each with one oyster of class 1 in the image a."""
    for k, side in enumerate(sides):
        write_png(root / "images" / f"{prefix}{side}" / "a.png", picture(k))
        (root / "labels" / f"{prefix}{side}").mkdir(parents=True)
        (root / "labels" / f"{prefix}{side}" / "a.txt").write_text("1" + TRIANGLE)
    (root / "data.yaml").write_text("names: [barnacle, oyster]\n")
    return root


def test_folders_below_images_and_labels_are_sides(tmp_path):
    """As Ultralytics has them."""
    found = open_labelled(sides_folder(tmp_path / "reef", "train", "Valid", "test2017"))
    assert [(one.name, one.split) for one in found.entries] == [
        ("Valid/a", "val"),
        ("test2017/a", "test"),
        ("train/a", "train"),
    ]
    assert all(one.oysters.any() for one in found)
    assert [one.names for one in open_truth(tmp_path / "reef")] == [("test2017/a",)]
    (tmp_path / "reef" / "labels" / "train" / "a.txt").unlink()
    with pytest.raises(LabelError, match=r"image train/a has no labels/train/a\.txt"):
        open_labelled(tmp_path / "reef")


def test_a_manifest_has_clips_and_the_last_word_on_sides_in_folders(tmp_path):
    folder = sides_folder(tmp_path, "train", "val")
    (folder / "manifest.csv").write_text("id,clip,split\ntrain/a,one,test\nval/a,two,val\n")
    assert [(one.clip, one.split) for one in open_labelled(folder).entries] == [("one", "test"), ("two", "val")]
    (folder / "manifest.csv").write_text("id,clip\ntrain/a,one\nval/a,two\n")
    assert [(one.clip, one.split) for one in open_labelled(folder).entries] == [("one", "train"), ("two", "val")]


def test_a_folder_below_images_is_on_the_side_that_data_yaml_says_and_without_one_is_refused(tmp_path):
    folder = sides_folder(tmp_path, "0", "1", prefix="fold")
    with pytest.raises(LabelError, match=r"images/fold0: expected folders called train, val or test, or named under"):
        open_labelled(folder)
    with open(folder / "data.yaml", "a") as file:
        file.write("train: images/fold1\nval: [images/fold0]\n")
    assert [(one.name, one.split) for one in open_labelled(folder).entries] == [
        ("fold0/a", "val"),
        ("fold1/a", "train"),
    ]
    write_png(folder / "images" / "b.png", picture(2))
    with pytest.raises(
        LabelError, match=r"images/fold0/a\.png: expected .* files in images/ itself, and none in folders"
    ):
        open_labelled(folder)


def test_yaml_files_beside_parts_of_an_export_that_name_no_oysters_are_of_something_else(tmp_path):
    folder = yolo_folder(tmp_path / "Valid", {"a": "0" + TRIANGLE})
    for text in ("names: [person]\n", "names: {\n"):
        (tmp_path / "coco128.yaml").write_text(text)
        assert open_labelled(folder)[0].oysters.any()
        (folder / "coco128.yaml").write_text(text)
        with pytest.raises(LabelError, match=r"Valid/coco128\.yaml: "):
            open_labelled(folder)
        (folder / "coco128.yaml").unlink()


def test_class_names_in_a_yaml_file_of_any_name_are_not_ignored(tmp_path):
    folder = yolo_folder(tmp_path / "train", {"a": "0" + TRIANGLE})
    for place in (folder, tmp_path):
        (place / "settings.yaml").write_text("epochs: 3\n")
        (place / "reef.yaml").write_text("nc: 1\nnames: [oyster]\n")
        assert open_labelled(folder)[0].oysters.any()
        (place / "reef.yaml").write_text("nc: 2\nnames: [barnacle, oyster]\n")
        with pytest.raises(LabelError, match=r"reef\.yaml: expected the names of the classes in data\.yaml"):
            open_labelled(folder)
        (place / "reef.yaml").rename(place / "data.yaml")
        assert not open_labelled(folder)[0].oysters.any()
        (place / "data.yaml").unlink()


def test_a_list_of_classes_without_oysters_is_refused(tmp_path):
    folder = yolo_folder(tmp_path, {"a": ""})
    (folder / "classes.txt").write_text("crab\nshell\n")
    with pytest.raises(LabelError, match=r"classes\.txt: no class is named 'oyster'; its classes: 0 = crab, 1 = shell"):
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
