"""Labelled images: every form gives what was put into it, and what is wrong is named."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.annotations import LabelledSet, joined, open_labelled, open_truth, write_folder
from oysterbench.annotations.export.examples import Example
from oysterbench.core.errors import LabelError
from oysterbench.core.polygons import mask_polygons, rasterise
from oysterbench.recipe import OYSTER
from oysterbench.sequence.countable import LEAST_PIXELS, LEAST_VISIBILITY, countable
from oysterbench.sequence.export import export_sequence
from tests.helpers.labelled_folders import HEIGHT, WIDTH, image, picture, write_png, yolo_folder

SQUARE = "0 0.25 0.25 0.75 0.25 0.75 0.75 0.25 0.75\n"


# Polygons


@pytest.mark.parametrize("seed", range(5))
def test_polygons_along_the_borders_of_a_mask_give_it_back(seed):
    mask = np.random.default_rng(seed).random((23, 31)) < 0.6
    found = np.zeros_like(mask)
    for polygon in mask_polygons(mask):
        found ^= rasterise(np.reshape(polygon, (-1, 2)), *mask.shape)
    assert np.array_equal(found, mask)


@pytest.mark.parametrize("seed", range(5))
def test_a_polygon_holds_the_pixels_whose_centres_are_in_it(seed):
    rng = np.random.default_rng(seed)
    polygon = rng.uniform(-10, 50, (7, 2))  # crosses itself, and leaves the image
    mask = rasterise(polygon, 30, 40)
    for row, column in zip(rng.integers(0, 30, 200), rng.integers(0, 40, 200), strict=True):
        x, y = column + 0.5, row + 0.5
        ends = np.roll(polygon, -1, axis=0)
        crossings = sum(
            (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0
            for (x0, y0), (x1, y1) in zip(polygon, ends, strict=True)
        )
        assert mask[row, column] == bool(crossings % 2)


# YOLO


def test_yolo_polygons_become_masks_and_the_smaller_one_lies_on_top(tmp_path):
    inner = "0 0.375 0.375 0.5 0.375 0.5 0.5 0.375 0.5\n"
    found = open_labelled(yolo_folder(tmp_path / "set", {"a": inner + SQUARE, "b": ""}))
    assert [entry.name for entry in found.entries] == ["a", "b"]
    assert np.array_equal(found[0].pixels, picture(0))
    assert found[0].oysters.sum() == HEIGHT * WIDTH / 4
    assert (found[0].instances == 1).sum() == HEIGHT * WIDTH / 64
    assert not found[1].oysters.any()


def test_a_polygon_that_leaves_the_image_ends_at_its_border(tmp_path):
    found = open_labelled(yolo_folder(tmp_path / "set", {"a": "0 -0.5 -0.5 0.5 -0.5 0.5 0.5 -0.5 0.5\n"}))
    assert found[0].oysters.sum() == HEIGHT * WIDTH / 4


def test_a_manifest_gives_clips_splits_and_order(tmp_path):
    manifest = 'id, clip ,split,more\n b,two, test,1\na ,"one",train ,2\n'  # blanks, as editors and people leave them
    found = open_labelled(yolo_folder(tmp_path / "set", {"a": SQUARE, "b": ""}, manifest))
    assert [(e.name, e.clip, e.split) for e in found.entries] == [("b", "two", "test"), ("a", "one", "train")]
    assert [entry.name for entry in found.of_split("train").entries] == ["a"]
    with pytest.raises(LabelError, match="no image of split 'val'; its splits: test, train"):
        found.of_split("val")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_what_a_spreadsheet_or_editor_saves_as_utf_8_is_read(mark, tmp_path):
    rows = (("id", "clip", "split"), ("a", "Bänke, Süd", "train"), ("b", "two", "test"), ("", "", ""))
    folder = yolo_folder(tmp_path / "set", {"a": SQUARE, "b": ""})
    with open(folder / "manifest.csv", "w", newline="", encoding="utf-8-sig") as file:
        csv.writer(file, delimiter=mark).writerows(rows)
    (folder / "labels" / "a.txt").write_text(SQUARE, encoding="utf-8-sig")
    found = open_labelled(folder)
    assert [(one.name, one.clip, one.split) for one in found.entries] == list(rows[1:-1])
    assert found[0].oysters.sum() == HEIGHT * WIDTH / 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 1 0 1 1\n", r"a.txt:1: class 1 is not an oyster; known classes: 0 = oyster"),
        (SQUARE + "0 0.1 0.2 0.3 0.4\n", r"a.txt:2: expected at least three corners x y, got 4 numbers: a box"),
        ("0 0 0 nan 0 1 1\n", r"a.txt:1: expected corners as fractions"),
        ("0 0 0 416 0 416 416\n", r"a.txt:1: expected corners as fractions"),
        ("oyster 0 0 1 0 1 1\n", r"a.txt:1: expected numbers"),
    ],
)
def test_a_bad_line_of_labels_is_refused_by_file_and_line(text, message, tmp_path):
    found = open_labelled(yolo_folder(tmp_path / "set", {"a": text}))
    with pytest.raises(LabelError, match=message):
        found[0]


@pytest.mark.parametrize("names", ["  0: crab\n  1: oyster\n", "[crab, Oysters]\n"])
@pytest.mark.parametrize("place", [".", ".."])
def test_classes_have_the_names_of_data_yaml(names, place, tmp_path):
    folder = yolo_folder(tmp_path / "all" / "train", {"a": "1" + SQUARE[1:], "b": SQUARE})
    before = open_labelled(folder).digest()
    (folder / place / "data.yaml").write_text(f"names: {names}" if "[" in names else f"names:\n{names}")
    found = open_labelled(folder)
    assert found[0].oysters.sum() == HEIGHT * WIDTH / 4
    assert not found[1].oysters.any()
    assert found.digest() != before
    (folder / "labels" / "b.txt").write_text("2" + SQUARE[1:])
    with pytest.raises(LabelError, match=r"b\.txt:1: class 2 is not an oyster; known classes: 0 = crab, 1 = oyster"):
        open_labelled(folder)[1]


def test_a_data_yaml_that_says_nothing_new_leaves_a_set_what_it_was(tmp_path):
    """Whose ever paths are in it."""
    folder = yolo_folder(tmp_path / "set", {"a": SQUARE})
    before = open_labelled(folder).digest()
    (folder / "data.yaml").write_text("path: /home/somebody\nnames: [oyster]\n")
    assert open_labelled(folder).digest() == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("names: [crab, shell]\n", "no class is named 'oyster'; its classes: 0 = crab, 1 = shell: rename"),
        ("names: {a: oyster}\n", "names: expected a list, or number: name, got"),
        ("names: oyster\n", "names: expected a list, or number: name, got 'oyster'"),
        ("names: [\n", "not YAML; expected the names of the classes"),
    ],
)
def test_a_data_yaml_that_names_no_oyster_is_refused(text, message, tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": SQUARE})
    (folder / "data.yaml").write_text(text)
    with pytest.raises(LabelError, match=rf"data\.yaml: {message}"):
        open_labelled(folder)


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ("id,clip\na,one\n", "does not list images/b"),
        ("id,clip\na,one\nb,one\nc,one\n", "lists 'c', but images/ has no such image"),
        ("id,clip\na,one\na,two\n", "'a' is listed twice"),
        ("id,clip,split\na,one,train\nb,one,\n", "'b' has no split"),
        ("id,video\na,one\n", "missing: clip"),
    ],
)
def test_a_manifest_that_does_not_fit_the_images_is_refused(manifest, message, tmp_path):
    with pytest.raises(LabelError, match=message):
        open_labelled(yolo_folder(tmp_path / "set", {"a": "", "b": ""}, manifest))


def test_images_and_labels_without_each_other_are_named(tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": "", "b": ""})
    (folder / "labels" / "b.txt").unlink()
    with pytest.raises(LabelError, match=r"image b has no labels/b\.txt"):
        open_labelled(folder)
    (folder / "images" / "b.png").unlink()
    (folder / "labels" / "c.txt").write_text("")
    with pytest.raises(LabelError, match=r"labels/c\.txt has no image"):
        open_labelled(folder)


# Images


def test_a_truncated_jpeg_is_refused_and_not_half_grey(tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": ""})
    (folder / "images" / "a.png").unlink()
    data = cv2.imencode(".jpg", picture(0))[1].tobytes()
    (folder / "images" / "a.jpg").write_bytes(data[:-40])
    with pytest.raises(LabelError, match=r"a\.jpg: (the JPEG ends before its end marker|not an image)"):
        open_labelled(folder)[0]


def test_a_jpeg_is_whole_whatever_a_camera_appended_to_it(tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": ""})
    (folder / "images" / "a.png").unlink()
    data = cv2.imencode(".jpg", picture(0))[1].tobytes()
    for suffix in (".jpg", ".png"):  # whatever its name says
        (folder / "images" / f"a{suffix}").write_bytes(data + b"SEFT" * 9)
        assert open_labelled(folder)[0].pixels.shape == (HEIGHT, WIDTH, 3)
        (folder / "images" / f"a{suffix}").unlink()


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("channels", [1, 3])
def test_labelled_images_of_more_than_8_bits_are_read_as_counted_ones(bits, channels, tmp_path):
    ramp = np.linspace(0, 255, HEIGHT * WIDTH).astype(np.uint16).reshape(HEIGHT, WIDTH)
    ramp = np.stack([np.roll(ramp, k) for k in range(channels)], axis=-1)
    folder = yolo_folder(tmp_path / "set", {"a": ""})
    write_png(folder / "images" / "a.png", (ramp << (bits - 8)).squeeze())
    assert np.array_equal(open_labelled(folder)[0].pixels, np.broadcast_to(ramp, (HEIGHT, WIDTH, 3)))


@pytest.mark.parametrize("data", [b"", b"not a picture"])
def test_what_is_no_image_is_refused(data, tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": ""})
    (folder / "images" / "a.png").write_bytes(data)
    with pytest.raises(LabelError, match=r"a\.png: not an image that can be decoded"):
        open_labelled(folder)[0]


# Folders of masks


def test_what_is_written_as_a_folder_is_read_back(tmp_path):
    images = [image(k, clip="one" if k < 2 else "two") for k in range(3)]
    images[1].ignore[:5] = True
    assert write_folder(images, tmp_path / "set", {"one-0": "train", "one-1": "train", "two-2": "test"}) == 3
    found = open_labelled(tmp_path / "set")
    assert found.clips == ("one", "two")
    assert len(found.of_split("train")) == 2
    for mine, other in zip(images, found, strict=True):
        for key in ("pixels", "classes", "instances", "ignore"):
            assert np.array_equal(getattr(mine, key), getattr(other, key)), key


def test_without_instances_what_hangs_together_is_one(tmp_path):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[4:10, 4:10] = mask[20:30, 20:30] = 255
    write_png(tmp_path / "images" / "a.png", picture(0))
    write_png(tmp_path / "masks" / "a.png", mask)
    found = open_labelled(tmp_path)[0]
    assert sorted(np.bincount(found.instances.ravel())[1:]) == [36, 100]


def test_masks_that_do_not_fit_are_named(tmp_path):
    write_png(tmp_path / "images" / "a.png", picture(0))
    write_png(tmp_path / "masks" / "a.png", np.zeros((HEIGHT, WIDTH + 1), np.uint8))
    with pytest.raises(LabelError, match=f"expected the size of the image, {WIDTH} x {HEIGHT}, got {WIDTH + 1} x"):
        open_labelled(tmp_path)[0]
    write_png(tmp_path / "masks" / "a.png", np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH).astype(np.uint8))
    with pytest.raises(LabelError, match=r"masks/a\.png: expected 0 and one other value"):
        open_labelled(tmp_path)[0]
    write_png(tmp_path / "masks" / "b.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(LabelError, match=r"masks/b\.png has no image"):
        open_labelled(tmp_path)


# COCO


def coco_file(folder, segmentation, **more):
    """A file of one image and one annotation."""
    write_png(folder / "a.png", picture(0))
    document = {
        "images": [{"id": 3, "file_name": "a.png", "width": WIDTH, "height": HEIGHT, "clip": "one"}],
        "categories": [{"id": 7, "name": "oyster"}, {"id": 8, "name": "stone"}],
        "annotations": [{"id": 1, "image_id": 3, "category_id": 7, "segmentation": segmentation, **more}],
    }
    (folder / "all.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("name", ["../a.png", "images/../../a.png", "ABSOLUTE"])
def test_a_coco_file_cannot_name_an_image_outside_its_folder(tmp_path, name):
    place = coco_file(tmp_path / "set", [[0, 0, 8, 0, 8, 8]]) / "all.json"
    (tmp_path / "set" / "images").mkdir()
    write_png(tmp_path / "a.png", picture(0))
    name = name.replace("ABSOLUTE", str(tmp_path / "a.png"))
    place.write_text(place.read_text().replace("a.png", name))
    with pytest.raises(LabelError, match=r"all\.json: image 3: expected a file_name relative to this folder"):
        open_labelled(place.parent)


def test_a_coco_file_may_name_its_own_images_absolutely(tmp_path):
    place = coco_file(tmp_path, [[8, 8, 24, 8, 24, 20, 8, 20]]) / "all.json"
    place.write_text(place.read_text().replace("a.png", str(tmp_path / "a.png")))
    assert open_labelled(place.parent)[0].oysters.sum() == 16 * 12


def test_coco_polygons_crowds_and_other_categories(tmp_path):
    box = [8, 8, 24, 8, 24, 20, 8, 20]
    assert open_labelled(coco_file(tmp_path, [box]))[0].oysters.sum() == 16 * 12
    crowd = open_labelled(coco_file(tmp_path, [box], iscrowd=1))[0]
    assert crowd.ignore.sum() == 16 * 12
    assert not crowd.oysters.any()
    assert not open_labelled(coco_file(tmp_path, [box], category_id=8))[0].oysters.any()


@pytest.mark.parametrize(("state", "alive"), [("live", True), ("dead", False)])
def test_a_coco_file_says_which_oysters_are_alive(state, alive, tmp_path):
    folder = coco_file(tmp_path, [[8, 8, 24, 8, 24, 20, 8, 20]], state=state)
    assert open_labelled(folder)[0].living == {1: alive}
    (clip,) = open_truth(folder / "all.json")
    assert [one.live for one in clip.instances(next(clip.images())[0]).instances] == [alive]


def test_own_labels_are_scored_and_exported_with_the_states_of_their_coco_file(tmp_path):
    folder = coco_file(tmp_path / "set", [[8, 8, 24, 8, 24, 20, 8, 20]], state="dead")
    (tmp_path / "set" / "images").mkdir()
    (folder / "a.png").rename(folder / "images" / "a.png")
    (clip,) = open_truth(folder)
    ((found, _),) = clip.single()
    assert [one.live for one in found.instances] == [0.0]
    assert [one["state"] for one in Example("a", open_labelled(folder)[0], ".png", b"").objects()] == ["dead"]


def test_without_a_category_for_oysters_a_coco_file_is_told_how_to_say_states(tmp_path):
    place = coco_file(tmp_path, [[8, 8, 24, 8, 24, 20]]) / "all.json"
    place.write_text(place.read_text().replace('"oyster"', '"live"'))
    with pytest.raises(LabelError, match=r"its categories: live, stone; .* \"state\": \"live\" or \"dead\""):
        open_labelled(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("image_id", 99, r"annotations\[0\]: image_id 99 matches none of"),
        ("category_id", 99, r"annotations\[0\]: category_id 99 matches no category"),
        ("segmentation", {"size": [1, 1], "counts": [1]}, r"annotations\[0\]: expected run lengths of the size"),
        ("segmentation", [[1, 2, 3]], r"annotations\[0\]: expected polygons of at least three corners"),
    ],
)
def test_a_bad_annotation_is_refused_by_its_place(key, value, message, tmp_path):
    folder = coco_file(tmp_path, [[8, 8, 24, 8, 24, 20]])
    document = json.loads((folder / "all.json").read_text())
    document["annotations"][0][key] = value
    (folder / "all.json").write_text(json.dumps(document))
    with pytest.raises(LabelError, match=message):
        open_labelled(folder)[0]


def test_a_rendered_sequence_and_its_coco_export_have_the_same_oysters(tiny_file, tmp_path):
    folder, _ = export_sequence(oysterbench.open(tiny_file), "coco", tmp_path / "coco")
    rendered, exported = open_labelled(tiny_file), open_labelled(folder)
    assert len(rendered) == len(exported) == 5
    assert any(one.oysters.any() for one in rendered)
    assert any(one.ignore.any() for one in rendered)
    for one, other in zip(rendered, exported, strict=True):
        assert np.array_equal(one.pixels, other.pixels)
        assert np.array_equal(one.oysters & ~one.ignore, other.oysters)
        assert np.array_equal(one.ignore, other.ignore)
        assert one.clip == "tiny-01"
        assert one.conditions == {"camera": "cam_front"}


# Rendered sequences


def test_oysters_too_small_or_too_hidden_to_count_are_ignored():
    instances = np.zeros((20, 20), np.uint16)
    instances[:4, :4], instances[8:10, 8:10], instances[12:18, 12:18], instances[0, 10:] = 1, 2, 3, 4
    classes = np.where(instances > 0, OYSTER, 1).astype(np.uint8)
    classes[0, 10:] = 3  # a stone, however small, is background as before
    visibility = np.full(instances.shape, np.nan, np.float32)
    visibility[instances > 0] = 1.0
    visibility[instances == 3] = 0.99 * LEAST_VISIBILITY
    assert (instances == 1).sum() == LEAST_PIXELS
    kept, ignore = countable(classes, instances, visibility)
    assert set(np.unique(kept)) == {0, 1, 4}
    assert np.array_equal(ignore, np.isin(instances, (2, 3)))


# Sets


def test_sets_joined_keep_their_images_apart(tmp_path):
    one = open_labelled(yolo_folder(tmp_path / "one", {"a": SQUARE}))
    other = open_labelled(yolo_folder(tmp_path / "other", {"a": ""}))
    both = joined([one, other], "both")
    assert [entry.name for entry in both.entries] == ["one/a", "other/a"]
    assert [(image.name, image.clip) for image in both] == [(entry.name, entry.clip) for entry in both.entries]
    with pytest.raises(LabelError, match="two images are named 'a'"):
        LabelledSet("twice", [*one.entries, *other.entries])


def test_a_digest_changes_with_labels_pictures_and_sides(tmp_path):
    folder = yolo_folder(tmp_path / "set", {"a": SQUARE, "b": ""}, "id,clip,split\na,one,train\nb,two,test\n")
    digests = {open_labelled(folder).digest()}
    assert open_labelled(folder).digest() in digests
    (folder / "labels" / "b.txt").write_text(SQUARE)
    digests.add(open_labelled(folder).digest())
    write_png(folder / "images" / "a.png", picture(9))
    digests.add(open_labelled(folder).digest())
    (folder / "manifest.csv").write_text("id,clip,split\na,one,train\nb,two,train\n")
    digests.add(open_labelled(folder).digest())
    assert len(digests) == 4


def test_what_holds_no_labels_or_could_be_two_things_is_refused(tmp_path):
    with pytest.raises(LabelError, match="no such file or folder"):
        open_labelled(tmp_path / "absent")
    with pytest.raises(LabelError, match="got none of them"):
        open_labelled(tmp_path)
    for kind in ("images", "labels", "masks"):
        (tmp_path / kind).mkdir()
    with pytest.raises(LabelError, match="got what could be yolo or masks"):
        open_labelled(tmp_path)
