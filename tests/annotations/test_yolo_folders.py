"""YOLO folders: which files name their classes, how sides are laid out, and what boxes are good for."""

from __future__ import annotations

import pytest

from oysterbench.annotations import open_labelled, open_truth
from oysterbench.core.errors import LabelError
from tests.helpers.labelled_folders import HEIGHT, WIDTH, picture, write_png, yolo_folder

TRIANGLE = " 0.25 0.25 0.75 0.25 0.75 0.75\n"


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


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("oyster, dead oyster", [True, True]),
        ("Live oyster, dead", [True, True]),
        ("barnacle, Oysters", [False, True]),
        ("juvenile oyster, oyster", "0"),
        ("oyster, spat", "1"),
        ("oyster, dead, barnacle", "1"),
    ],
)
def test_classes_are_of_oysters_by_their_names_as_categories_of_coco_files_are(names, found, tmp_path):
    """And refused where that is not sure, instead of left out, but only where they are drawn."""
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE, "b": "1" + TRIANGLE})
    (folder / "data.yaml").write_text(f"names: [{names}]\n")
    if isinstance(found, list):
        assert [bool(one.oysters.any()) for one in open_labelled(folder)] == found
        return
    with pytest.raises(LabelError, match=rf"\.txt:1: class {found} is called '.*', which could be of oysters or not"):
        list(open_labelled(folder))
    (folder / "labels" / f"{'ab'[int(found)]}.txt").write_text("")
    assert sum(one.oysters.any() for one in open_labelled(folder)) == 1


def test_a_list_of_classes_of_darknet_is_refused_unless_it_is_called_as_others_are(tmp_path):
    """All barnacles were read as oysters."""
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE})
    (folder / "obj.names").write_text("oyster\n")
    assert open_labelled(folder)[0].oysters.any()
    (folder / "obj.names").write_text("barnacle\noyster\n")
    with pytest.raises(
        LabelError, match=r"obj\.names: expected the names of the classes in classes\.txt, .* rename it"
    ):
        open_labelled(folder)
    (folder / "obj.names").rename(folder / "classes.txt")
    assert not open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize("name", ["reef", "reef-test"])
@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("classes.txt", "person\ncar\n"),
        ("classes.txt", "oyster\n"),
        ("coco.names", "person\ncar\n"),
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
        ("obj.names", "barnacle\noyster\n"),
        ("data.yaml", "names: [barnacle, oyster]\ntrain: train/images\n"),
        ("data.yaml", "names: [reef, oyster]\n"),
        ("data.yaml", "names: [barnacle, oyster]\npath: other\ntrain: reef/2024/train\n"),
        ("data.yaml", "names: [barnacle, oyster]\npath: /content/HERE\ntrain: images/train\n"),
        ("reef.yml", "names: [barnacle, oyster]\n"),
        ("data.yaml", "names: [barnacle, oyster]\ntrain: images/train2017\n"),
        ("data.yaml", "names: [barnacle, oyster]\ntrain: [reef1/images, reef2/images]\nval: reef3/images\n"),
    ],
)
def test_class_names_beside_a_folder_that_may_be_of_it_or_not_are_refused(file, text, tmp_path):
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE})
    (tmp_path / file).write_text(text.replace("HERE", tmp_path.name))
    with pytest.raises(
        LabelError, match=rf"{file}: expected the names of the classes of reef/ in (data.yaml|classes.txt) there"
    ):
        open_labelled(folder)
    (folder / "data.yaml").write_text("names: [oyster]\n")
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize("name", ["reef", "reef-test"])
@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("data.yaml", "path: other\ntrain: other/train/images\nval: images\n"),
        ("data.yaml", "path: /content/datasets/oysters-3\ntrain: train/images\n"),
        ("data.yaml", "path: ..\ntrain: [kelp/images, C:\\sets\\other\\images]\n"),
        ("data.yaml", "train: kelp-train/images\n"),
        ("other.yml", "train: other/images\n"),
    ],
)
def test_class_names_that_may_be_of_another_set_are_refused_whatever_the_folder_is_called(file, text, name, tmp_path):
    """The folder may be of a set that was moved, or be beside one of other classes: either is wrong without a word."""
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / file).write_text(f"{text}names: [barnacle, oyster]\n")
    with pytest.raises(LabelError, match=rf"{file}: expected the names of the classes of {name}/ in data\.yaml there"):
        open_labelled(folder)


@pytest.mark.parametrize(
    ("name", "file", "text"),
    [
        ("reef-test", "data.yaml", "path: reef\ntrain: images/train\n"),
        ("reef-test", "data.yaml", "path: ../datasets/Reef\ntrain: images/train\n"),
        ("reef_test", "barnacles.yaml", "path: /sets/reef\n"),
        ("reef-test", "data.yml", "train: a-train/images\nval: b-val/images\n"),
        ("reef", "data.yaml", "train: reef/images/train\nval: reef/images/val\n"),
        ("reef", "reef.yaml", "path: .\ntrain: [kelp/images, C:\\sets\\reef\\images\\train]\n"),
        ("reef", "data.yaml", "train: kelp/images\n"),
        ("Train", "barnacles.yaml", "train: train/images\n"),
        ("reef", "barnacles.yaml", "train: reef/train.txt\n"),
        ("reef", "coco128.yaml", "path: reef\ntrain: images/train2017\n"),
        ("reef", "barnacles.yaml", "path: reef\ntrain: lists/train.txt\n"),
        ("reef", "barnacles.yaml", "train: reef/images/train/*.png\nval: reef/JPEGImages\n"),
        ("reef", "barnacles.yaml", "path: .\ntrain: [reef/train.txt]\n"),
        ("reef", "data.yaml", "\N{BYTE ORDER MARK}"),
        ("val", "barnacles.yaml", "path: ../HERE\ntrain: images/train\nval: images/val\n"),
    ],
)
def test_class_names_without_oysters_that_may_be_of_this_set_are_refused(name, file, text, tmp_path):
    """They are of this very set where they list it, and data.yaml may be: barnacles were oysters without a word."""
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / file).write_text(f"{text}names: [barnacle, rock]\n".replace("HERE", tmp_path.name))
    with pytest.raises(LabelError, match=rf"{file}: expected the names of the classes .*in data\.yaml"):
        open_labelled(folder)
    (folder / "data.yaml").write_text("names: [oyster]\n")
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize("name", ["reef-test", "train", "datasets"])
@pytest.mark.parametrize(
    "text", ["path: kelp\ntrain: images/train\n", "path: ../datasets/coco8\nval: images/val\n", ""]
)
def test_class_names_without_oysters_that_list_another_set_are_of_that(text, name, tmp_path):
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / "kelp.yaml").write_text(f"{text}names: [kelp]\n")
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("reef-train", ""),
        ("train2", ""),
        ("reef-test", "train: reef-train/images\nval: reef-valid/images\n"),
        ("test2017", "train: train2017\nval: val2017\n"),
        ("reef_2024_test", "path: /home/bob/sets\ntrain: Reef_2024_train/images\n"),
        ("reef-test", "train: ../train/images\nval: ../valid/images\n"),
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


@pytest.mark.parametrize(
    ("name", "text"),
    [("train", "names: [fish]\n"), ("reef", "val: reef\nnames: [fish]\n"), ("reef-test", "names: [fish]\n")],
)
def test_a_data_yaml_above_that_is_of_a_folder_must_name_oysters(name, text, tmp_path):
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / "data.yaml").write_text(text)
    with pytest.raises(LabelError, match=r"data\.yaml: no class is named 'oyster'"):
        open_labelled(folder)


@pytest.mark.parametrize("name", ["train", "reef-test"])
def test_a_data_yaml_above_a_side_that_cannot_be_read_is_refused(name, tmp_path):
    folder = yolo_folder(tmp_path / name, {"a": "0" + TRIANGLE})
    (tmp_path / "data.yaml").write_text("names: {\n")
    with pytest.raises(LabelError, match=r"data\.yaml: not YAML"):
        open_labelled(folder)


@pytest.mark.parametrize("side", ["", "train"])
def test_class_names_beside_label_files_are_to_be_moved(side, tmp_path):
    """Where labelImg writes them."""
    folder = yolo_folder(tmp_path / "reef", {}) if side else yolo_folder(tmp_path / "reef", {"a": "1" + TRIANGLE})
    if side:
        sides_folder(folder, side)
        (folder / "data.yaml").unlink()
    (folder / "labels" / side / "classes.txt").write_text("barnacle\noyster\n")
    with pytest.raises(
        LabelError, match=r"classes\.txt: expected 0 = oyster, .*, got 0 = barnacle, 1 = oyster, .* move it"
    ):
        open_labelled(folder)
    (folder / "labels" / side / "classes.txt").rename(folder / "classes.txt")
    assert open_labelled(folder)[0].oysters.any()


@pytest.mark.parametrize("place", ["labels", "labels/train", "labels/val", ".", "images", "images/val"])
@pytest.mark.parametrize(
    "names", ["barnacle\noyster\n", "oyster\nbarnacle\n", "dog\ncat\n", "b\nOyster\n\n", "", "spat\noyster"]
)
def test_class_names_among_label_files_are_to_be_those_of_data_yaml(place, names, tmp_path):
    folder = sides_folder(tmp_path / "reef", "train", "val")
    (folder / place / "classes.txt").write_text(names)
    if names[:1] in ("b", "") or (names == "dog\ncat\n" and not place.startswith("labels")):
        assert len(open_labelled(folder)) == 2
    else:
        with pytest.raises(
            LabelError, match=r"classes\.txt: expected 0 = barnacle, 1 = oyster, .*, got 0 = .* delete it"
        ):
            open_labelled(folder)


@pytest.mark.parametrize("text", [b"oyster\nfish\n", b"oyster\n\xe9toile\n", b"Auster\nFisch\n"])
@pytest.mark.parametrize("place", [".", "images"])
def test_a_list_elsewhere_may_have_more_classes_be_in_another_language_or_unreadable(place, text, tmp_path):
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE})
    (folder / "data.yaml").write_text("names: [oyster]\n")
    (folder / place / "classes.txt").write_bytes(text)
    assert open_labelled(folder)[0].oysters.any()


def test_an_image_may_be_called_classes(tmp_path):
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE, "classes": "0" + TRIANGLE})
    assert [one.name for one in open_labelled(folder).entries] == ["a", "classes"]


@pytest.mark.parametrize("beside", ["", "data.yaml"])
def test_one_class_may_be_listed_among_label_files(beside, tmp_path):
    folder = yolo_folder(tmp_path / "reef", {"a": "0" + TRIANGLE})
    if beside:
        (folder / beside).write_text("names: [oyster]\n")
    (folder / "labels" / "classes.txt").write_text("oyster\n")
    assert [one.name for one in open_labelled(folder).entries] == ["a"]


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


def test_yolo_folders_with_boxes_are_a_truth_with_their_clips_and_sides(tmp_path):
    lines = {"a": "0 0.5 0.5 0.25 0.5\n", "b": "0 0.25 0.25 0.75 0.25 0.75 0.75\n", "c": ""}
    manifest = "id,clip,split\na,one,test\nb,two,test\nc,two,train\n"
    clips = open_truth(yolo_folder(tmp_path, lines, manifest))
    assert [(one.name, one.names) for one in clips] == [("one", ("a",)), ("two", ("b",))]
    (first, second) = (next(clip.single())[0].instances for clip in clips)
    assert [one.box for one in first] == [(0.375 * WIDTH, 0.25 * HEIGHT, 0.25 * WIDTH, 0.5 * HEIGHT)]
    assert [one.mask is None for one in (*first, *second)] == [True, False]
    digests = {clip.digest for clip in clips}
    (tmp_path / "labels" / "a.txt").write_text("0 0.5 0.5 0.5 0.5\n")
    assert not digests & {clip.digest for clip in open_truth(tmp_path)}


@pytest.mark.parametrize("other", ["0 0.5 0.5 0.25 0.5\n", "3 0.5 0.5 0.25 0.5\n", "a word\n"])
def test_labels_of_a_side_that_is_not_scored_change_nothing(other, tmp_path):
    folder = yolo_folder(tmp_path, {"a": "0" + TRIANGLE, "b": ""}, "id,clip,split\na,one,test\nb,two,train\n")
    (before,) = open_truth(folder)
    (folder / "labels" / "b.txt").write_text(other)
    (clip,) = open_truth(folder)
    assert (clip.digest, clip.coco, clip.notes) == (before.digest, None, ())
    ((_, seen),) = clip.single()
    assert seen is not None
    (folder / "labels" / "a.txt").write_text("0 0.5 0.5 0.5 0.5\n")
    (boxes,) = open_truth(folder)
    assert [len(one.instances) for one, _ in boxes.single()] == [1]


@pytest.mark.parametrize(
    ("line", "said"), [("0 0.5 0.5 -0.1 0.2", "a box of centre, width and"), ("0 20 20 9 9", "corners as fractions")]
)
def test_a_wrong_box_is_refused_by_file_and_line(line, said, tmp_path):
    with pytest.raises(LabelError, match=rf"labels/a\.txt:2: expected {said}"):
        open_truth(yolo_folder(tmp_path, {"a": f"0 0.5 0.5 0.1 0.1\n{line}\n"}))


def test_polygons_are_not_read_to_see_that_there_are_no_boxes(tmp_path, monkeypatch):
    """They are read once, with their images."""
    folder = yolo_folder(tmp_path, {"a": "0" + TRIANGLE, "b": "\n0" + TRIANGLE})
    monkeypatch.setattr("oysterbench.annotations.yolo_boxes.read_outlines", lambda *_: pytest.fail("read"))
    assert open_truth(folder)[0].coco is None
