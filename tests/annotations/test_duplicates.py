"""Leakage: near duplicates across a split are found, and what only resembles is not taken for one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oysterbench.annotations import check_leakage, near_duplicates, open_labelled
from oysterbench.annotations.duplicates import MIN_CORRELATION
from oysterbench.core.errors import LabelError
from tests.helpers.labelled_folders import picture, write_png

SIZE = 200


def scene(seed: int) -> np.ndarray:
    """(300, 300, 3) a seabed with blobs, of which a frame shows a part."""
    rng = np.random.default_rng(seed)
    grey = np.full((300, 300), 90.0)
    for _ in range(120):
        centre = tuple(int(v) for v in rng.integers(0, 300, 2))
        cv2.circle(grey, centre, int(rng.integers(6, 22)), float(rng.uniform(30, 200)), -1)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def write_set(folder, pictures):
    for name, pixels in pictures.items():
        write_png(folder / "images" / f"{name}.png", pixels)
        write_png(folder / "masks" / f"{name}.png", np.zeros(pixels.shape[:2], np.uint8))
    return open_labelled(folder)


def test_a_frame_further_on_in_other_light_is_found_and_another_place_is_not(tmp_path):
    first, second = scene(1), scene(2)
    train = write_set(tmp_path / "train", {"one": first[:SIZE, :SIZE], "two": scene(3)[:SIZE, :SIZE]})
    moved = first[20 : 20 + SIZE, 30 : 30 + SIZE].astype(float)
    veiled = 0.5 * moved + 60 + np.linspace(0, 50, SIZE)[:, None, None]  # haze, and a lamp to one side
    test = write_set(
        tmp_path / "test",
        {"next": veiled.astype(np.uint8), "elsewhere": second[:SIZE, :SIZE], "copy": first[:SIZE, :SIZE]},
    )
    found = {pair.one: pair for pair in near_duplicates(test, train)}
    assert set(found) == {"next", "copy"}
    assert found["copy"].correlation == pytest.approx(1.0, abs=1e-3)
    assert found["next"].other == "one"


def test_one_image_on_both_sides_is_refused_by_name(tmp_path):
    one = write_set(tmp_path / "one", {"a": picture(1, SIZE, SIZE)})
    with pytest.raises(LabelError, match="'a' and 0 more images are in both the training and the test set"):
        check_leakage(one, one)


def test_the_real_images_repeat_one_scene_across_their_clips(shared_data):
    """The place at the end of the test clip closeup-a is seen again at the start of closeup-b, and closeup-c repeats
    closeup-b under other names."""
    folder = shared_data / "real-oysters"
    if not folder.is_dir():
        pytest.skip("real-oysters is absent")
    real = open_labelled(folder)
    ends = {"closeup-a-6071", "closeup-a-6072"}
    starts = real.where(lambda entry: entry.clip == "closeup-b" and entry.name <= "closeup-b-6080")
    (pair,) = near_duplicates(real.where(lambda entry: entry.name in ends), starts)
    assert (pair.one, pair.other) == ("closeup-a-6072", "closeup-b-6077")
    some = real.where(lambda entry: entry.name in ("closeup-b-6089", "closeup-b-6093"))
    again = near_duplicates(some, real.where(lambda entry: "closeup-c-7000" <= entry.name <= "closeup-c-7012"))
    assert [round(one.correlation, 2) for one in again] == [1.0, 1.0]
    far = real.where(lambda entry: entry.clip == "quadrat-a" and entry.name <= "quadrat-a-0003")
    assert near_duplicates(far, starts) == []
    assert MIN_CORRELATION < 0.5
