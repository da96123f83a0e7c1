"""COCO annotations as other programs write them: what they mean is read, or refused, never guessed."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from oysterbench.annotations import joined, open_labelled, open_truth, read_coco
from oysterbench.core.errors import LabelError
from tests.helpers.labelled_folders import HEIGHT, WIDTH, picture, write_png

SQUARE = [8, 8, 24, 8, 24, 20, 8, 20]
FRACTIONS = [0.1, 0.1, 0.5, 0.1, 0.5, 0.5, 0.1, 0.5]


def coco_file(path, *annotations, categories=({"id": 1, "name": "oyster"},)):
    """A file of one image, beside it, and of annotations in it, of category 1 if they do not say another."""
    write_png(path.parent / f"{path.stem}.png", picture(0))
    document = {
        "images": [{"id": 1, "file_name": f"{path.stem}.png", "width": WIDTH, "height": HEIGHT}],
        "categories": list(categories),
        "annotations": [{"id": k, "image_id": 1, "category_id": 1, **one} for k, one in enumerate(annotations)],
    }
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize(
    ("annotation", "what"),
    [
        ({"segmentation": [FRACTIONS], "bbox": [0.1, 0.1, 0.4, 0.4]}, "'bbox' in px"),
        ({"segmentation": [FRACTIONS]}, "corners of polygons in px"),
        ({"segmentation": [[0, 0, 1.0000001, 0, 1, 0.5]]}, "corners of polygons in px"),
        ({"segmentation": [SQUARE], "bbox": [0.1, 0.1, 0.4, 0.4]}, "'bbox' in px"),
    ],
)
def test_fractions_of_the_image_are_no_pixels(annotation, what, tmp_path):
    path = coco_file(tmp_path / "a.json", annotation, annotation)
    with pytest.raises(
        LabelError, match=rf"a\.json: expected {what}, got fractions of width and height, \[0.*multiply"
    ):
        read_coco(path)


@pytest.mark.parametrize(
    "annotations",
    [
        [{"segmentation": [SQUARE], "bbox": [0, 0, 0, 0]}],
        [{"segmentation": [[0, 0, 1, 0, 1, 1, 0, 1]], "bbox": [0, 0, 1, 1]}],
        [{"segmentation": [SQUARE]}, {"segmentation": [FRACTIONS], "bbox": []}],
        [],
    ],
)
def test_a_pixel_in_the_corner_is_no_fraction(annotations, tmp_path):
    assert read_coco(coco_file(tmp_path / "a.json", *annotations)).names == ("a",)


@pytest.mark.parametrize(("value", "crowd"), [(0, False), (1, True), (False, False), (True, True), (None, False)])
def test_crowds_are_numbers_or_true_and_false(value, crowd, tmp_path):
    found = open_labelled(coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "iscrowd": value}))[0]
    assert (bool(found.ignore.any()), bool(found.oysters.any())) == (crowd, not crowd)


@pytest.mark.parametrize("value", ["0", "1", "", 2, [0]])
def test_another_crowd_is_refused(value, tmp_path):
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "iscrowd": value})
    with pytest.raises(LabelError, match=r"annotations\[0\]: expected 'iscrowd', 0 or 1 as a number"):
        open_labelled(path)[0]
    with pytest.raises(LabelError, match=r"annotations\[0\]: expected 'iscrowd', 0 or 1 as a number"):
        read_coco(path).instances("a", scored=False)


@pytest.mark.parametrize(
    ("state", "living"), [("Live", {1: True}), ("DEAD ", {1: False}), ("unknown", {}), ("", {}), (None, {})]
)
def test_states_are_read_in_either_case(state, living, tmp_path):
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "state": state})
    assert open_labelled(path)[0].living == living


@pytest.mark.parametrize(
    ("said", "live"),
    [
        ({"live": 0.9, "state": "dead"}, 0.0),
        ({"live": 0.2, "state": "Live"}, 1.0),
        ({"live": 0.9, "state": "live"}, 0.9),
        ({"live": 0.2, "state": "dead"}, 0.2),
        ({"live": 0.9, "state": "unknown"}, None),
        ({"live": 0.9, "state": ""}, 0.9),
        ({"live": None, "state": "live"}, 1.0),
        ({"live": None}, None),
    ],
)
def test_a_state_that_was_corrected_by_hand_goes_before_the_probability_beside_it(said, live, tmp_path):
    """As `segment --coco` writes probabilities, and messages ask for states."""
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], **said})
    assert open_labelled(path)[0].living == ({} if live is None else {1: live >= 0.5})
    (one,) = read_coco(path).instances("a", scored=False).instances
    assert one.live == pytest.approx(math.nan if live is None else live, nan_ok=True)


@pytest.mark.parametrize("state", ["alive", 1, False])
def test_another_state_is_refused(state, tmp_path):
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "state": state})
    with pytest.raises(LabelError, match=r"annotations\[0\]: expected 'state', live, dead or unknown, got"):
        open_labelled(path)[0]


def test_cvat_says_states_among_its_attributes(tmp_path):
    said = ({"attributes": {"state": "Dead"}}, {"attributes": {"state": "dead"}, "state": "live"}, {"attributes": []})
    path = coco_file(tmp_path / "a.json", *({"segmentation": [SQUARE], **one} for one in said))
    assert read_coco(path).living("a") == {1: False, 2: True}


@pytest.mark.parametrize("state", ["__undefined__", "", None])
def test_a_state_that_was_not_chosen_in_cvat_is_none(state, tmp_path):
    said = ({"category_id": 1}, {"category_id": 2}, {"category_id": 2, "live": 0.8})
    categories = named(("oyster", "none"), ("oyster", "shell"), ("dead oyster", "shell"))
    items = ({"segmentation": [SQUARE], "attributes": {"state": state}, **one} for one in said)
    path = coco_file(tmp_path / "a.json", *items, categories=categories)
    assert read_coco(path).living("a") == {2: False, 3: True}


@pytest.mark.parametrize("state", ["alive", "Living", "open", True, ["live"]])
def test_another_state_in_cvat_is_refused(state, tmp_path):
    """Beside some that are dead, the others would be left out without a word."""
    items = ({"segmentation": [SQUARE], "attributes": {"state": one}} for one in ("dead", state))
    path = coco_file(tmp_path / "a.json", *items)
    with pytest.raises(
        LabelError, match=r"annotations\[1\]: expected 'state', live, dead or unknown, got .* or rename"
    ):
        read_coco(path).living("a")


def named(*categories):
    """Categories of such names and supercategories, numbered from 0."""
    return [{"id": k, "name": name, "supercategory": above} for k, (name, above) in enumerate(categories)]


ROBOFLOW = named(("oyster", "none"), ("live", "oyster"), ("dead", "oyster"))
OF_A_PROJECT = named(("oysters-x2zq1", "none"), ("Live", "oysters-x2zq1"), ("Dead", "oysters-x2zq1"))
OF_A_REEF = [*named(("reef", ""), ("live_oysters", "reef"), ("Dead Oyster", "reef"), ("stone", "reef"))]


@pytest.mark.parametrize("categories", [ROBOFLOW, OF_A_PROJECT, OF_A_REEF])
def test_categories_of_live_and_dead_oysters_are_oysters_with_that_state(categories, tmp_path):
    """Roboflow puts its classes, which have oysters, below one that has none, and that may be called oyster."""
    said = [
        {"category_id": 1},
        {"category_id": 2},
        {"category_id": 2, "live": 0.8},
        {"category_id": 1, "state": "dead"},
    ]
    path = coco_file(tmp_path / "a.json", *({"segmentation": [SQUARE], **one} for one in said), categories=categories)
    assert open_labelled(path)[0].living == {1: True, 2: False, 3: True, 4: False}
    (clip,) = open_truth(path)
    assert [one.live for one in clip.instances(next(clip.images())[0]).instances] == [1.0, 0.0, 0.8, 0.0]


@pytest.mark.parametrize("name", ["Oyster", "oysters", " OYSTERS"])
def test_oysters_are_named_in_either_case_and_number(name, tmp_path):
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE]}, categories=[{"id": 1, "name": name}])
    assert open_labelled(path)[0].oysters.any()


@pytest.mark.parametrize(
    ("other", "above"), [("spat", "oyster"), ("barnacle", "Oysters"), ("live", "coral"), ("dead", "")]
)
def test_a_category_that_may_be_of_oysters_is_refused_where_it_is_annotated(other, above, tmp_path):
    categories = named(("oyster", "none"), (other, above), ("stone", ""))
    assert len(read_coco(coco_file(tmp_path / "a.json", categories=categories)).items["a"]) == 0
    annotations = ({"segmentation": [SQUARE], "category_id": k} for k in (0, 1))
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    with pytest.raises(LabelError, match=rf"annotations\[1\]: its category, '{other}', could be of oysters or not"):
        read_coco(path)


@pytest.mark.parametrize(
    "categories",
    [
        named(("oyster", ""), ("live", ""), ("dead", ""), ("rock", "")),
        named(("live oyster", "none"), ("oyster", "none"), ("Dead", "none"), ("rock", "none")),
        named(("oyster", "bivalve"), ("dead", "coral")),
        named(("oyster", "shellfish"), ("adult", "oyster"), ("juvenile oyster", "oyster")),
        named(("oyster", "bivalve"), ("oyster drill", "oysters")),
    ],
)
def test_what_may_be_oysters_beside_others_is_never_left_out_without_a_word(categories, tmp_path):
    """Nor counted as oysters: also where they have a category or a supercategory of their own."""
    annotations = ({"segmentation": [SQUARE], "category_id": one["id"]} for one in categories)
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    with pytest.raises(LabelError, match=r"annotations\[[12]\]: its category, .* could be of oysters or not"):
        read_coco(path)


@pytest.mark.parametrize(
    "names",
    [
        ("oyster", "alive", "dead"),
        ("oyster", "living oyster", "dead oyster"),
        ("oyster_alive", "oyster_dead"),
        ("live oyster", "dead oyster", "Oyster (unknown)"),
        ("dead oyster", "Pacific oyster"),
        ("oyster", "spat"),
        ("oyster", "oyster-shell"),
    ],
)
@pytest.mark.parametrize("above", ["", "none", "oysters", "reef"])
def test_a_name_with_the_word_oyster_or_of_a_state_that_is_not_known_is_not_left_out_without_a_word(
    names, above, tmp_path
):
    categories = named(*((name, above) for name in names))
    annotations = ({"segmentation": [SQUARE], "category_id": one["id"]} for one in categories)
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    with pytest.raises(LabelError, match=r"its category, .* could be of oysters or not: expected .*: rename it$"):
        read_coco(path)


@pytest.mark.parametrize("above", ["coral", "mussels", "shell"])
@pytest.mark.parametrize("below_all", [False, True])
def test_states_alone_of_something_else_are_no_oysters(above, below_all, tmp_path):
    """Also where the file has nothing else, but the supercategory, as of Roboflow."""
    categories = named(("live", above), ("dead", above), *([(above, "none")] if below_all else []))
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "category_id": 0}, categories=categories)
    with pytest.raises(LabelError, match=r"no category is named 'oyster'; its categories: live, dead"):
        read_coco(path)


@pytest.mark.parametrize("above", ["", "none", "type", "oyster-health", "live", None])
def test_states_alone_and_nothing_else_are_oysters(above, tmp_path):
    categories = named(("live", above), ("dead", above))
    annotations = ({"segmentation": [SQUARE], "category_id": k} for k in (0, 1))
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    assert read_coco(path).living("a") == {1: True, 2: False}


@pytest.mark.parametrize("above", ["", "none", "shell", "oyster", "live"])
def test_states_alone_beside_beside_oysters_and_nothing_else_are_oysters(above, tmp_path):
    categories = named(("oyster", above), ("live", above), ("dead", above))
    annotations = ({"segmentation": [SQUARE], "category_id": k} for k in (0, 1, 2))
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    assert read_coco(path).living("a") == {2: True, 3: False}


def test_what_is_beside_oysters_in_a_project_of_oysters_is_something_else(tmp_path):
    categories = named(("oysters", "none"), ("oyster", "oysters"), ("barnacle", "oysters"))
    annotations = ({"segmentation": [SQUARE], "category_id": k} for k in (1, 2))
    path = coco_file(tmp_path / "a.json", *annotations, categories=categories)
    assert len(read_coco(path).items["a"]) == 1


def test_two_categories_of_one_id_are_refused_and_of_one_name_are_one(tmp_path):
    categories = named(("oyster", "none"), ("oyster", "oyster"))
    annotations = [{"segmentation": [SQUARE], "category_id": k} for k in (0, 1)]
    assert len(read_coco(coco_file(tmp_path / "a.json", *annotations, categories=categories)).items["a"]) == 2
    categories[0]["id"] = 1
    with pytest.raises(LabelError, match=r"categories: id 1 is used twice"):
        read_coco(coco_file(tmp_path / "a.json", categories=categories))


def test_a_file_is_named_as_itself_and_by_roboflow_as_its_folder(tmp_path):
    for name in ("site/reef-test", "site/reef-val", "valid/_annotations.coco", "site/reef"):
        path = tmp_path / f"{name}.json"
        path.parent.mkdir(exist_ok=True)
        coco_file(path)
        assert open_labelled(path).name == (path.parent.name if "coco" in name else path.stem)
    assert open_labelled(tmp_path / "valid").name == "valid"


def test_sets_of_one_name_are_numbered_and_the_same_set_twice_is_refused(tmp_path):
    """Such as instances.json of several sites, or train/ of several exports."""
    for site in "xyz":
        (tmp_path / site).mkdir()
    sets = [open_labelled(coco_file(tmp_path / site / "all.json")) for site in "xyz"]
    assert [entry.name for entry in joined(sets, "both").entries] == ["all/all", "all-2/all", "all-3/all"]
    assert joined(sets, "both").clips == ("all/all", "all-2/all", "all-3/all")
    with pytest.raises(LabelError, match=r"^both: two images are named 'all/all', both of .*x/all\.png: give it once$"):
        joined([*sets, sets[0]], "both")


LAYOUTS = {
    "CVAT": ("annotations/instances_default.json", "images/default"),
    "CVAT without subsets": ("annotations/instances_default.json", "images"),
    "COCO 2017": ("annotations/instances_train2017.json", "train2017"),
    "FiftyOne": ("labels.json", "data"),
    "Label Studio": ("result.json", "images"),
    "Roboflow": ("_annotations.coco.json", "."),
}


def laid(root, file, folder):
    """A COCO file of one image, with the image in another folder below root."""
    (root / file).parent.mkdir(parents=True, exist_ok=True)
    path = coco_file(root / file, {"segmentation": [SQUARE]})
    (root / folder).mkdir(parents=True, exist_ok=True)
    path.with_suffix(".png").rename(root / folder / "a.png")
    path.write_text(path.read_text().replace(f"{path.stem}.png", "a.png"))
    return path


@pytest.mark.parametrize("layout", LAYOUTS)
def test_images_are_found_where_programs_put_them(layout, tmp_path, monkeypatch):
    path = laid(tmp_path / "reef", *LAYOUTS[layout])
    (path.parent / f"._{path.name}").write_bytes(b"x")  # as macOS writes on other file systems
    for place in (path, tmp_path / "reef"):
        assert open_labelled(place)[0].oysters.any()
        ((name, pixels),) = open_truth(place)[0].pictures()
        assert name == "a"
        assert pixels is not None
    assert open_labelled(tmp_path / "reef").name == "reef"
    monkeypatch.chdir(path.parent)
    assert open_labelled(path.name)[0].oysters.any()


def test_images_of_another_subset_are_not_taken_for_those_of_a_file(tmp_path):
    path = laid(tmp_path, "annotations/instances_val2017.json", "train2017")
    with pytest.raises(LabelError, match=r"instances_val2017\.json: image 1: no file a\.png in any of .*val2017"):
        open_labelled(path)


def test_an_image_in_two_places_is_refused(tmp_path):
    path = laid(tmp_path, "annotations/instances_default.json", "images/default")
    (tmp_path / "images" / "a.png").symlink_to(tmp_path / "images" / "default" / "a.png")
    assert open_labelled(path)[0].oysters.any()
    (tmp_path / "images" / "a.png").unlink()
    write_png(tmp_path / "images" / "a.png", picture(1))
    for opened in (open_labelled, open_truth):
        with pytest.raises(LabelError, match=r"a\.png could be .*images/a\.png or .*default/a\.png: rename or remove"):
            opened(path)


@pytest.mark.parametrize("text", ["{}", '{"images": 3}', "[]", "no JSON"])
@pytest.mark.parametrize("folder", ["dive", "annotations"])
def test_masks_are_read_whatever_else_lies_in_annotations(folder, text, tmp_path):
    write_png(tmp_path / folder / "a.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    (tmp_path / "annotations").mkdir(exist_ok=True)
    (tmp_path / "annotations" / "meta.json").write_text(text)
    assert [(one.name, one.names) for one in open_truth(tmp_path)] == [(folder, (f"{folder}/a",))]


def test_a_folder_of_masks_with_a_coco_file_in_annotations_is_refused(tmp_path):
    """Their clips differ, and the masks may have been corrected since."""
    path = laid(tmp_path, "annotations/instances_default.json", "dive")
    path.write_text(path.read_text().replace("a.png", "dive/a.png"))
    assert open_truth(tmp_path)[0].coco is not None
    write_png(tmp_path / "dive" / "a-mask.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(
        LabelError, match=r"expected masks or COCO annotations, got both, such as .*a-mask\.png and .*def"
    ):
        open_truth(tmp_path)
    assert open_truth(path)[0].coco is not None
    write_png(tmp_path / "dive" / "a-mask.png", picture(2))
    assert open_truth(tmp_path)[0].coco is not None


@pytest.mark.parametrize("overview", [False, True])
def test_masks_that_have_the_names_of_their_images_are_not_taken_for_these(overview, tmp_path):
    """As is usual; also where another picture lies before them."""
    path = laid(tmp_path, "annotations/instances_default.json", ".")
    for name in "ab":
        write_png(tmp_path / f"{name}.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    if overview:
        write_png(tmp_path / "_overview.png", picture(2))
    with pytest.raises(LabelError, match=r"expected masks or COCO annotations, got both, such as .*a\.png and .*def"):
        open_truth(tmp_path)
    assert open_truth(path)[0].coco is not None


def test_of_several_files_one_is_asked_for(tmp_path):
    for side in ("train", "val"):
        path = tmp_path / "annotations" / f"instances_{side}2017.json"
        path.parent.mkdir(exist_ok=True)
        coco_file(path)
    for opened in (open_labelled, open_truth):
        with pytest.raises(LabelError, match=r"2 JSON files: give the COCO file .* as .*/instances_train2017\.json$"):
            opened(tmp_path)


def test_folders_in_names_may_be_divided_as_on_windows(tmp_path):
    """As Label Studio writes there."""
    path = laid(tmp_path, "result.json", "images")
    content = json.loads(path.read_text())
    content["images"][0]["file_name"] = "images\\a.png"
    path.write_text(json.dumps(content))
    assert [entry.name for entry in open_labelled(tmp_path).entries] == ["images/a"]
    content["images"][0]["file_name"] = "..\\a.png"
    path.write_text(json.dumps(content))
    with pytest.raises(LabelError, match="leads out of it"):
        open_labelled(tmp_path)


def test_states_of_something_else_are_no_oysters_of_a_map_either(tmp_path):
    categories = named(("live", "coral"), ("oyster", ""), ("rock", ""))
    path = coco_file(tmp_path / "a.json", {"segmentation": [SQUARE], "category_id": 0}, categories=categories)
    with pytest.raises(LabelError, match="its category, 'live', could be of oysters or not"):
        read_coco(path, oysters_alone=True)
