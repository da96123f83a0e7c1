"""What integers mean is judged by all files; what could be numbers of oysters or probabilities is refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from PIL import Image

from oysterbench.annotations import open_predictions
from oysterbench.annotations.forms import in_patches
from oysterbench.core.errors import LabelError
from tests.annotations.test_predictions import write_png


def numbers_of(count):
    """Oysters of 8 x 8 px in rows, some of which touch."""
    plane = np.zeros((120, 160), np.uint16)
    for k in range(count):
        row, column = divmod(k, 14)
        plane[2 + 9 * row : 10 + 9 * row, 2 + 11 * column : 10 + 11 * column + 3 * (k % 2)] = k + 1
    return plane


NUMBERS = numbers_of(150)
MASK = NUMBERS > 0
SOFT = cv2.GaussianBlur(MASK.astype(np.float32), (0, 0), 1.5)
COARSE = cv2.resize(cv2.resize(SOFT, (40, 30), interpolation=cv2.INTER_AREA), (160, 120), interpolation=0)


@pytest.mark.parametrize(
    "numbers",
    [
        NUMBERS.astype(np.uint8),
        numbers_of(3).astype(np.uint8),
        (NUMBERS % 4).astype(np.uint8),  # classes
        NUMBERS + np.uint16(24000) * MASK,  # as in Cityscapes
        NUMBERS * np.uint16(400),
    ],
)
def test_numbers_of_oysters_are_never_read_as_probabilities(tmp_path, numbers):
    write_png(tmp_path / "a.png", numbers * 0)
    write_png(tmp_path / "b.png", numbers)
    count = len(np.unique(numbers)) - 1
    said = rf"b\.png: expected a mask .* got {count} values up to {numbers.max()}, .*--estimate-kind instances, probab"
    for name in "ab":
        with pytest.raises(LabelError, match=said) as caught:
            open_predictions(tmp_path).get(name)
    assert "\n" not in str(caught.value)
    assert (open_predictions(tmp_path, "instances").get("b").mask(0.5) == (numbers > 0)).all()
    assert open_predictions(tmp_path, "probability").get("b").probability is not None


@pytest.mark.parametrize(
    "values",
    [
        SOFT,
        COARSE,
        1 / (1 + np.exp(-60 * (SOFT - 0.5))),  # sure, but for edges
        np.round(5 * SOFT) / 5,  # levels
        0.07 * SOFT,  # of an untrained network
        np.where(SOFT > 0.9, 1.0, np.where(SOFT > 0.3, 0.5, 0.0)),
    ],
)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_maps_of_probabilities_remain_so(tmp_path, values, kind):
    most = np.iinfo(kind).max
    write_png(tmp_path / "a.png", np.round(values * most).astype(kind))
    found = open_predictions(tmp_path).get("a")
    assert found.probability == pytest.approx(values, abs=0.6 / most)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_faint_maps_are_judged_by_their_folder(tmp_path, kind):
    """Among maps of probabilities, one of 0 and 1 alone is one too, which is said; among masks nothing is guessed."""
    most = np.iinfo(kind).max
    write_png(tmp_path / "a.png", np.round(1.4 * SOFT).astype(kind))
    write_png(tmp_path / "b.png", np.round(10 * SOFT).astype(kind))
    write_png(tmp_path / "c.png", np.round(most * SOFT).astype(kind))
    found = open_predictions(tmp_path)
    assert [float(found.get(name).probability.max() * most) for name in "abc"] == pytest.approx([1, 10, most], rel=0.02)
    assert not found.get("a").mask(0.5).any()
    (note,) = found.notes
    assert note == f"read as probabilities of 0 and 1/{most}, as other files have many values: {tmp_path}/a.png"
    assert open_predictions(tmp_path, "probability").notes == ()
    for levels in (MASK * 1.0, np.round(2 * SOFT) / 2):  # no map of probabilities for sure
        write_png(tmp_path / "b.png", np.round(levels * most).astype(kind))
        write_png(tmp_path / "c.png", np.round(levels * most).astype(kind))
        with pytest.raises(LabelError, match=r"a\.png has only 0 and 1, .* mask or probability, of a map --masks-kind"):
            open_predictions(tmp_path).get("a")


def test_faint_maps_alone_are_refused_with_the_option_that_reads_them(tmp_path):
    faint = np.round(10 * SOFT).astype(np.uint8)
    write_png(tmp_path / "a.png", faint)
    said = r"a\.png: .* got 10 values up to 10, which could be .*, or probabilities of which none .* is above 3\.9%; .*"
    with pytest.raises(LabelError, match=said + "--estimate-kind instances, probability"):
        open_predictions(tmp_path).get("a")
    assert open_predictions(tmp_path, "probability").get("a").probability == pytest.approx(faint / 255)


@pytest.mark.parametrize(("kind", "number"), [(np.uint8, 2), (np.uint8, 100), (np.uint8, 255), (np.uint16, 100)])
def test_zero_and_one_other_number_in_all_files_are_a_mask(tmp_path, kind, number):
    write_png(tmp_path / "a.png", MASK.astype(kind) * kind(number))
    write_png(tmp_path / "b.png", np.zeros_like(MASK, dtype=kind))
    assert (open_predictions(tmp_path).get("a").mask(0.5) == MASK).all()
    assert not open_predictions(tmp_path).get("b").mask(0.5).any()
    write_png(tmp_path / "b.png", np.full(MASK.shape, number // 2, kind))
    assert open_predictions(tmp_path, "probability").get("a").mask(0.5).any() == (number == 255)


def test_masks_in_other_files_say_what_to_do(tmp_path):
    palette = Image.fromarray(MASK.astype(np.uint8))
    palette.putpalette([0, 0, 0, 250, 0, 0])
    palette.save(tmp_path / "a.png")
    with pytest.raises(
        LabelError, match=r"a\.png: expected one channel, got a palette.*; save the numbers as a grey PNG"
    ):
        open_predictions(tmp_path).get("a")
    (tmp_path / "a.png").rename(tmp_path / "a.JPG")
    with pytest.raises(LabelError, match=r"per image, got \.JPG files; save masks as \.png"):
        open_predictions(tmp_path)
    np.savez(tmp_path / "all.npz", a=MASK.astype(int))
    with pytest.raises(LabelError, match=r"got int64; store a mask as bool, .*--estimate-kind mask, instances or"):
        open_predictions(tmp_path / "all.npz").get("a")
    assert (open_predictions(tmp_path / "all.npz", "mask").get("a").mask(0.5) == MASK).all()


def test_a_constant_map_is_no_mask(tmp_path):
    write_png(tmp_path / "a.png", np.full((6, 8), 40, np.uint8))
    assert not open_predictions(tmp_path).get("a").mask(0.5).any()


def test_patches_may_be_split_and_touch():
    assert in_patches(NUMBERS)
    split = NUMBERS.copy()
    split[::9] = 0
    split[6::9] = 0
    assert in_patches(split)
    assert not in_patches(np.tile(np.arange(160, dtype=np.uint8), (120, 1)))


@pytest.mark.parametrize("other", [MASK, SOFT], ids=["bool", "float"])
def test_files_of_other_types_change_nothing_in_how_integers_are_read(tmp_path, other):
    np.save(tmp_path / "b.npy", other)
    write_png(tmp_path / "a.png", NUMBERS)
    found = open_predictions(tmp_path)
    assert (found.get("a").oyster == MASK).all()
    assert (found.numbers("a") == NUMBERS).all()
    assert found.numbers("b") is None
    write_png(tmp_path / "a.png", MASK * np.uint8(128))
    assert (open_predictions(tmp_path).get("a").oyster == MASK).all()
    for files in (found, open_predictions(tmp_path)):
        read = files.get("b")
        assert ((read.oyster if other is MASK else read.probability) == other).all()
    for numbers in (NUMBERS.astype(np.uint8), numbers_of(3).astype(np.uint8)):
        write_png(tmp_path / "a.png", numbers)
        with pytest.raises(LabelError, match=r"a\.png: expected a mask"):
            open_predictions(tmp_path).get("a")
    np.save(tmp_path / "c.npy", NUMBERS.astype(np.int64))
    write_png(tmp_path / "a.png", NUMBERS)
    with pytest.raises(LabelError, match="got int64"):
        open_predictions(tmp_path).get("c")


def test_what_is_refused_or_noted_has_the_names_and_numbers_of_its_file(tmp_path):
    write_png(tmp_path / "a.png", MASK.astype(np.uint8))
    write_png(tmp_path / "b.png", MASK * np.uint8(2))
    with pytest.raises(LabelError, match=r"b\.png: .* 255 is 1, got 1 values up to 2, .* above 0\.8%"):
        open_predictions(tmp_path).get("a")
    for faint, full in ((np.uint8, np.uint16), (np.uint16, np.uint8)):
        write_png(tmp_path / "a.png", MASK.astype(faint))
        write_png(tmp_path / "b.png", np.round(SOFT * np.iinfo(full).max).astype(full))
        (note,) = open_predictions(tmp_path).notes
        assert f"0 and 1/{np.iinfo(faint).max}," in note
        assert note.endswith("a.png")
        write_png(tmp_path / "b.png", MASK * full(255))
        write_png(tmp_path / "a.png", MASK * faint(255))
        assert all((open_predictions(tmp_path).get(name).mask(0.5) == MASK).all() for name in "ab")
    for name, most in (("b", 200), ("c", 250)):
        write_png(tmp_path / f"{name}.png", MASK * np.uint8(100) + (SOFT > 0.9) * np.uint8(most - 100))
    write_png(tmp_path / "a.png", MASK.astype(np.uint8))
    with pytest.raises(LabelError, match=r"a\.png has only 0 and 1, .*c\.png greater values, .* with 255 for 1"):
        open_predictions(tmp_path).get("a")
