"""Predictions and truths are read from whatever holds them, and what is wrong is refused by name, in one line."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest

from oysterbench.annotations import open_labelled, open_predictions, open_truth, read_coco
from oysterbench.annotations.masks import check_names
from oysterbench.core.errors import LabelError
from oysterbench.evaluate.detection.instances import from_mask

MASK = np.zeros((6, 8), bool)
MASK[1:4, 2:6] = True
POLYGON = [2.0, 1.0, 6.0, 1.0, 6.0, 4.0, 2.0, 4.0]
COUNTS = [13, 3, 3, 3, 3, 3, 3, 3, 14]  # of MASK, column by column
PACKED = from_mask(MASK).mask
assert PACKED is not None


def write_png(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), values)


def predicted(folder, name="a", form="auto"):
    return open_predictions(folder, form).get(name)


def test_the_files_that_macos_writes_beside_others_are_no_images(tmp_path):
    for folder, values in (("images", np.zeros((6, 8, 3), np.uint8)), ("masks", MASK.astype(np.uint8))):
        write_png(tmp_path / folder / "a.png", values)
        (tmp_path / folder / "._a.png").write_bytes(bytes(4096))
    assert [entry.name for entry in open_labelled(tmp_path).entries] == ["a"]
    assert [clip.names for clip in open_truth(tmp_path / "masks")] == [("a",)]
    assert list(open_predictions(tmp_path / "masks").names) == ["a"]


@pytest.mark.parametrize("write", ["png8", "png01", "png16", "npy", "npz", "float"])
def test_masks_and_probabilities_are_read_from_every_form(tmp_path, write):
    if write.startswith("png"):
        values = (
            MASK.astype(np.uint16) * 65535
            if write == "png16"
            else MASK.astype(np.uint8) * (255 if write == "png8" else 1)
        )
        write_png(tmp_path / "clip" / "a.png", values)
    elif write == "npy":
        (tmp_path / "clip").mkdir()
        np.save(tmp_path / "clip" / "a.npy", MASK)
    else:
        (tmp_path / "clip").mkdir()
        np.savez(tmp_path / "clip" / "a.npz", MASK.astype(np.float32) if write == "float" else MASK)
    prediction = predicted(tmp_path, "clip/a")
    assert np.array_equal(prediction.mask(0.5), MASK)


def test_one_npz_holds_an_array_for_each_image(tmp_path):
    np.savez(tmp_path / "all.npz", **{"clip/a": MASK, "clip/b": ~MASK})
    predictions = open_predictions(tmp_path / "all.npz")
    assert predictions.names == ("clip/a", "clip/b")
    assert np.array_equal(predictions.get("clip/b").mask(0.5), ~MASK)


def test_numbers_of_classes_are_read_as_such(tmp_path):
    write_png(tmp_path / "a.png", MASK.astype(np.uint8) * 2)
    assert np.array_equal(predicted(tmp_path, form="classes").mask(0.5), MASK)


def cut(path):
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize(
    ("spoil", "form", "message"),
    [
        (
            lambda p: p.write_bytes(p.read_bytes()[:16] + b"\x7f" * 8 + p.read_bytes()[24:]),
            "auto",
            "larger than any image here",
        ),
        (lambda p: cut(p), "auto", r"a\.png: incomplete PNG file: its end is missing"),
        (lambda p: p.write_bytes(b""), "auto", r"a\.png: incomplete PNG file"),
        (lambda p: write_png(p, np.full((4, 4, 3), (1, 2, 3), np.uint8)), "auto", "expected one channel"),
        (lambda p: write_png(p, MASK.astype(np.uint8) * 3 + 1), "mask", "0 and one other number, got 1, 4"),
        (lambda p: write_png(p, MASK.astype(np.uint8) * 77), "classes", "a: unknown class 77; known classes: 0 water"),
    ],
)
def test_files_that_are_not_what_they_should_be_are_refused_by_name(tmp_path, spoil, form, message):
    write_png(tmp_path / "a.png", MASK.astype(np.uint8))
    spoil(tmp_path / "a.png")
    with pytest.raises(LabelError, match=message) as caught:
        predicted(tmp_path, form=form)
    assert "\n" not in str(caught.value)


def test_masks_of_0_and_1_among_probability_maps_are_not_guessed_at(tmp_path):
    write_png(tmp_path / "a.png", MASK.astype(np.uint8))
    write_png(tmp_path / "b.png", MASK.astype(np.uint8) * 200)
    predictions = open_predictions(tmp_path)
    for name in "ab":  # whichever is read, alone or first
        with pytest.raises(
            LabelError, match=r"a\.png has only 0 and 1.*b\.png greater.*say which they are \(--estimate-kind"
        ):
            predictions.get(name)


def test_small_numbers_of_16_bits_in_patches_are_those_of_single_oysters(tmp_path):
    """As `oysterbench segment` writes them, also where an image has one oyster, or none."""
    numbers = np.zeros((40, 60), np.uint16)
    numbers[5:15, 5:20], numbers[5:15, 20:40], numbers[20:30, 5:50] = 1, 2, 3
    write_png(tmp_path / "a.png", np.minimum(numbers, 1))
    write_png(tmp_path / "b.png", numbers)
    write_png(tmp_path / "c.png", numbers * 0)
    found = open_predictions(tmp_path)
    assert found.numbered
    assert (found.numbers("b") == numbers).all()
    assert (found.get("b").mask(0.5) == (numbers > 0)).all()
    assert found.numbers("a").max() == 1
    assert not found.get("c").mask(0.5).any()
    assert open_predictions(tmp_path, "probability").numbers("b") is None
    ramp = np.tile(np.arange(60, dtype=np.uint16) * 5, (40, 1))  # small, but in no patches
    write_png(tmp_path / "b.png", ramp)
    assert not open_predictions(tmp_path).numbered
    write_png(tmp_path / "b.png", numbers)
    write_png(tmp_path / "d.png", ramp * 200)  # a map of probabilities
    assert not open_predictions(tmp_path).numbered
    assert (open_predictions(tmp_path, "instances").numbers("b") == numbers).all()


def test_a_mask_in_another_format_is_told_apart_from_none(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"x")
    with pytest.raises(LabelError, match=r"no prediction for a \(a\.jpg is there, which is no \.png, \.npy, \.npz\)"):
        check_names(["a", "b"], ["b"], tmp_path)


def test_missing_and_further_predictions_are_refused_by_name(tmp_path):
    with pytest.raises(LabelError, match="no prediction for b; expected one prediction for each of 2 images"):
        check_names(["a", "b"], ["a"], tmp_path)
    with pytest.raises(LabelError, match="no image of the truth is named c, d, e and 1 more"):
        check_names(["a"], ["a", "c", "d", "e", "f"], tmp_path)
    with pytest.raises(
        LabelError, match=r"no prediction for a; .*, named as in the ground truth, e\.g\. a, got images/a$"
    ):
        check_names(["a"], ["images/a"], tmp_path)
    for place in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(LabelError, match="expected a"):
            open_predictions(place)


def document(**changes):
    """A COCO file of two images with one oyster."""
    one = {"id": 7, "image_id": 1, "category_id": 3, "segmentation": [POLYGON], "bbox": [2, 1, 4, 3], "area": 12}
    images = [{"id": k, "file_name": f"clip/{name}.jpg", "width": 8, "height": 6} for k, name in ((1, "a"), (2, "b"))]
    categories = [{"id": 3, "name": "oyster"}, {"id": 4, "name": "stone"}]
    return {"images": images, "categories": categories, "annotations": [one | changes]}


def wrote(path, content):
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    "segmentation",
    [
        [POLYGON],
        {"size": [6, 8], "counts": COUNTS},
        {"size": [6, 8], "counts": PACKED["counts"].decode()},
    ],
)
def test_coco_is_read_from_polygons_and_run_lengths(tmp_path, segmentation):
    file = read_coco(wrote(tmp_path / "x.json", document(segmentation=segmentation)))
    assert file.names == ("clip/a", "clip/b")
    assert np.array_equal(file.mask("clip/a", 0.5).oyster, MASK)
    assert not file.mask("clip/b", 0.5).oyster.any()
    (one,) = file.instances("clip/a", scored=False).instances
    assert (one.box, one.area) == ((2.0, 1.0, 4.0, 3.0), 12.0)
    assert one.mask["counts"] == from_mask(MASK).mask["counts"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_id": 9}, "image_id 9 matches none of"),
        ({"category_id": 9}, "category_id 9 matches no category; known: 3 oyster, 4 stone"),
        ({"segmentation": [POLYGON[:-1]]}, "at least three corners x y, got 7 numbers"),
        ({"segmentation": {"size": [8, 6], "counts": COUNTS}}, r"run lengths of the size \[6, 8\], got \[8, 6\]"),
        ({"segmentation": {"size": [6, 8], "counts": [40]}}, "add up to 48 pixels, got 40"),
        ({"segmentation": {"size": [6, 8], "counts": [60, -12]}}, "add up to 48 pixels, got \\[60, -12\\]"),
        ({"segmentation": {"size": [6, 8], "counts": "X1"}}, "add up to 48 pixels, got 'X1'"),
        ({"segmentation": {"size": [6, 8], "counts": "=3l"}}, "add up to 48 pixels, got '=3l'"),
        ({"segmentation": {"size": [6, 8]}}, "add up to 48 pixels, got None"),
        ({"segmentation": {"size": [6, 8], "counts": "P" * 99 + "0"}}, "add up to 48 pixels, got 'PPP"),
        ({"segmentation": {"size": [6, 8], "counts": "\xb2"}}, r"add up to 48 pixels, got '\\xb2'"),
        ({"segmentation": [[*POLYGON[:-1], 1e9]]}, "in or near the image of 8 x 6 px"),
        ({"segmentation": [[*POLYGON[:-1], 10**400]]}, "in or near the image of 8 x 6 px"),
        ({"bbox": [1, 2, 1e200, 1e200]}, r"in or near the image of 8 x 6, got \[1, 2, 1e\+200"),
        ({"image_id": [1]}, r"expected numbers or text as ids, got \[1\]"),
        ({"area": 10**400}, "expected 'area', a number, got 1000"),
        ({"area": math.nan}, "expected 'area', a number, got nan"),
        ({"bbox": [1, 2, -3, 4]}, r"expected 'bbox' as \[x, y, width, height\] in px, .* 8 x 6, got \[1, 2, -3, 4\]"),
    ],
)
def test_bad_annotations_are_refused_by_item(tmp_path, changes, message):
    with pytest.raises(LabelError, match=rf"x\.json: annotations\[0\]: .*{message}"):
        read_coco(wrote(tmp_path / "x.json", document(**changes))).instances("clip/a", scored=False)


@pytest.mark.parametrize("score", [None, float("nan"), "high", True])
def test_results_without_a_score_are_refused_by_item(tmp_path, score):
    truth = read_coco(wrote(tmp_path / "x.json", document()))
    result = {"image_id": 1, "category_id": 3, "segmentation": [POLYGON]} | ({} if score is None else {"score": score})
    file = read_coco(wrote(tmp_path / "r.json", [result]), truth)
    with pytest.raises(LabelError, match=r"r\.json: \[0\]: expected 'score', a number, got"):
        file.instances("clip/a", scored=True)


@pytest.mark.parametrize("score", [87.5, 1.001, -2])
def test_scores_that_are_no_probabilities_are_refused_by_item(tmp_path, score):
    """Of percentages, all would reach the threshold."""
    truth = read_coco(wrote(tmp_path / "x.json", document()))
    result = {"image_id": 1, "category_id": 3, "segmentation": [POLYGON], "score": score}
    file = read_coco(wrote(tmp_path / "r.json", [{**result, "score": 1}, result]), truth)
    for reads in (lambda: file.instances("clip/a", scored=True), lambda: file.mask("clip/a", 0.5)):
        with pytest.raises(LabelError, match=rf"r\.json: \[1\]: expected 'score' from 0 to 1, got {score:g}; divide"):
            reads()


def test_a_list_of_results_means_by_a_category_what_the_ground_truth_means(tmp_path):
    """Whose document has oysters (3) and stones (4); with oysters alone, results of one number are of them."""
    content = document()
    results = [{"image_id": 1, "category_id": k, "segmentation": [POLYGON], "score": 0.5} for k in (4, 3, 4)]
    truth = read_coco(wrote(tmp_path / "x.json", content))
    file = read_coco(wrote(tmp_path / "r.json", results), truth)
    assert [item.where for item in file.items["clip/a"]] == [f"{tmp_path / 'r.json'}: [1]"]
    for wrong in ({"category_id": 0}, {}):
        lone = {key: value for key, value in results[0].items() if key != "category_id"} | wrong
        with pytest.raises(LabelError, match=r"r\.json: \[0\]: category_id .* no category; known: 3 oyster, 4 stone"):
            read_coco(wrote(tmp_path / "r.json", [lone]), truth)
    content["categories"] = [{"id": 3, "name": "oyster"}]
    alone = read_coco(wrote(tmp_path / "x.json", content))
    file = read_coco(wrote(tmp_path / "r.json", results), alone)
    assert [item.where for item in file.items["clip/a"]] == [f"{tmp_path / 'r.json'}: [1]"]
    left_out = "left out: 2 of 3 results, of category_id 4; the ground truth knows only 3 oyster"
    assert file.notes == (f"{left_out} ({tmp_path / 'r.json'}: [0] and 1 more)",)
    for number, said in ((3, ""), (0, "all results have category_id 0, taken for the ground truth's 3 oyster")):
        same = [{**result, "category_id": number} for result in results]
        file = read_coco(wrote(tmp_path / "r.json", same), alone)
        assert len(file.items["clip/a"]) == 3
        assert "".join(file.notes) == said
    others = [{**result, "category_id": k} for k, result in enumerate(results)]
    with pytest.raises(LabelError, match=r"category_id 0, 1, 2, and the ground truth knows only 3 oyster: give its"):
        read_coco(wrote(tmp_path / "r.json", others), alone)
    assert read_coco(wrote(tmp_path / "r.json", []), alone).items["clip/a"] == ()


def test_doubled_ids_and_lists_without_images_are_refused(tmp_path):
    content = document()
    content["annotations"] *= 2
    with pytest.raises(LabelError, match=r"annotations\[1\]: id 7 is used twice"):
        read_coco(wrote(tmp_path / "x.json", content))
    content["images"] *= 2
    with pytest.raises(LabelError, match=r"images\[2\]: id 1 or file_name .* is used twice"):
        read_coco(wrote(tmp_path / "x.json", content))
    with pytest.raises(LabelError, match="expected ground truth in COCO form"):
        read_coco(wrote(tmp_path / "r.json", []))
    (tmp_path / "r.json").write_text("{")
    with pytest.raises(LabelError, match=r"r\.json: cannot be read as JSON"):
        read_coco(tmp_path / "r.json")


def test_files_that_differ_by_suffix_alone_keep_it(tmp_path):
    content = document()
    for image, file in zip(content["images"], ("clip/a.jpg", "clip/a.png"), strict=True):
        image["file_name"] = file
    assert read_coco(wrote(tmp_path / "x.json", content)).names == ("clip/a.jpg", "clip/a.png")


def test_clips_of_a_plain_folder_are_its_folders_or_what_the_manifest_says(tmp_path):
    for name in ("one/a", "one/b", "two/c"):
        write_png(tmp_path / f"{name}.png", MASK.astype(np.uint8) * 255)
    assert [(clip.name, clip.names) for clip in open_truth(tmp_path)] == [
        ("one", ("one/a", "one/b")),
        ("two", ("two/c",)),
    ]
    (tmp_path / "manifest.csv").write_text("id,clip\none/a,x\none/b,y\ntwo/c,x\n")
    assert [clip.name for clip in open_truth(tmp_path)] == ["x", "y"]
    (tmp_path / "manifest.csv").write_text("id,clip\none/a,x\n")
    with pytest.raises(LabelError, match="does not assign a clip to one/b"):
        open_truth(tmp_path)


def test_masks_that_a_manifest_lists_are_all_there_and_no_suffix_hides_one(tmp_path):
    for name in ("a.png", "b.PNG"):
        write_png(tmp_path / "x.png", MASK.astype(np.uint8) * 255)
        (tmp_path / "x.png").rename(tmp_path / name)
    (clip,) = open_truth(tmp_path)
    assert clip.names == ("a", "b")
    (tmp_path / "manifest.csv").write_text("id,clip\na,x\nb,x\nc,x\n")
    with pytest.raises(LabelError, match="lists 'c', but there is no c"):
        open_truth(tmp_path)
    (tmp_path / "manifest.csv").write_text("id,clip,split\na,x,test\nb,x,test\nc,x,train\n")
    (clip,) = open_truth(tmp_path)
    assert (clip.names, clip.unscored) == (("a", "b"), {"c"}), "what is not scored needs no mask"
    write_png(tmp_path / "b.png", MASK.astype(np.uint8) * 255)
    with pytest.raises(LabelError, match="expected one mask of this name, got another with the suffix in other case"):
        open_truth(tmp_path)


def test_a_number_of_the_truth_may_be_ignored_and_unknown_classes_are_refused(tmp_path):
    values = MASK.astype(np.uint8) * 2
    values[0, 0] = 255
    write_png(tmp_path / "a.png", values)
    ((truth, _),) = open_truth(tmp_path, "classes")[0].images()
    assert np.array_equal(truth.oyster, MASK)
    assert truth.ignore.sum() == 1
    with pytest.raises(LabelError, match=r"a\.png: unknown class 255; known classes: 0 water"):
        list(open_truth(tmp_path, "classes", ignore_value=7)[0].images())
    with pytest.raises(LabelError, match=r"a\.png: expected a mask of 0 and one other number, got 0, 2, 255"):
        list(open_truth(tmp_path)[0].images())


@pytest.mark.parametrize(
    ("values", "form", "message"),
    [
        (np.array([["1", "0"]]), "mask", "expected numbers or booleans, got <U1"),
        (np.array([[1 + 1j]]), "auto", "expected numbers or booleans, got complex128"),
        (np.array([[np.nan, 1.0]]), "mask", "expected a mask of 0 and one other number"),
        (np.array([[-1.0, 0.0]]), "mask", "expected a mask of 0 and one other number"),
        (np.array([[1.0, 0.0]]), "classes", "expected class numbers from 0 to 255, got float64"),
    ],
)
def test_arrays_of_other_values_than_their_form_has_are_refused(tmp_path, values, form, message):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(LabelError, match=message):
        predicted(tmp_path, form=form)


def test_files_that_are_no_arrays_or_claim_to_be_huge_are_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr("oysterbench.annotations.masks.MOST_BYTES", 1 << 20)
    np.save(tmp_path / "a.npy", MASK)
    header = (tmp_path / "a.npy").read_bytes()
    np.savez_compressed(tmp_path / "bomb.npz", np.zeros((1 << 11, 1 << 10), np.uint8))
    for name, data, message in (
        ("a.npy", header.replace(b"(6, 8)", b"(6**8"), "a.npy cannot be read as numpy arrays"),
        ("a.npy", (tmp_path / "bomb.npz").read_bytes(), "expected one array in an .npy, or several in an .npz"),
        ("b.npz", header, "expected one array in an .npy, or several in an .npz"),
        ("b.npz", (tmp_path / "bomb.npz").read_bytes(), "array arr_0: expected at most 1 MiB, got 2 MiB"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(LabelError, match=message):
            predicted(tmp_path, name[0])
