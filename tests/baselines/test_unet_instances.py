"""Oysters told apart: by hills of depth, each with a score that says how much it looks like one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench_baselines.learning.samples import depths
from oysterbench_baselines.unet.instances import Division, find_instances, means, moved


def discs(*places: tuple[int, int, int]) -> np.ndarray:
    y, x = np.mgrid[:60, :80]
    found = np.zeros((60, 80))
    for cx, cy, radius in places:
        found = np.maximum(found, ((x - cx) ** 2 + (y - cy) ** 2 <= radius**2) * 0.9)
    return found.astype(np.float32)


def hills(*places: tuple[int, int, int]) -> np.ndarray:
    """Depth (60, 80) of cones: 1 in the middle, 0 at the border."""
    y, x = np.mgrid[:60, :80]
    found = np.zeros((60, 80))
    for cx, cy, radius in places:
        found = np.maximum(found, 1 - np.hypot(x - cx, y - cy) / radius)
    return found.astype(np.float32)


def test_oysters_that_touch_are_told_apart_along_the_valley_between_them_and_share_no_pixel():
    places = (20, 30, 12), (42, 30, 12)
    oyster = discs(*places)
    found = find_instances(oyster, hills(*places))
    assert len(found.scores) == 2
    assert found.scores == pytest.approx([0.7] * 2, abs=0.02)  # cones are not what an outline says
    assert np.array_equal(found.labels > 0, oyster > 0.5)
    left, right = found.labels[30, 20], found.labels[30, 42]
    assert left != right
    assert (found.labels[:, :30][oyster[:, :30] > 0] == left).all()
    assert (found.labels[:, 33:55][oyster[:, 33:55] > 0] == right).all()


@pytest.mark.parametrize("count", [255, 256, 300])
def test_any_number_of_oysters_is_told_apart(count):
    oyster, depth = np.zeros((2, 160, 160), np.float32)
    for k in range(count):
        row, column = (slice(8 * n, 8 * n + 7) for n in divmod(k, 20))
        oyster[row, column] = 0.9
        depth[row, column] = depths(np.ones((7, 7), np.uint16)) / 255
    found = find_instances(oyster, depth, Division(smooth=0.1, area=4.0))
    assert found.areas.tolist() == [49] * count


def test_a_hill_that_hardly_stands_out_is_no_oyster_of_its_own():
    oyster = discs((20, 30, 12), (34, 30, 12))
    saddle = np.maximum(hills((20, 30, 12), (34, 30, 12)), 0.97 * discs((27, 30, 9)) / 0.9)
    assert len(find_instances(oyster, saddle).scores) == 1


def test_a_piece_without_a_hill_is_an_oyster_that_is_not_counted_and_gets_nothing_across_a_gap():
    oyster = discs((10, 30, 6), (40, 30, 6))
    found = find_instances(oyster, hills((10, 30, 6)))
    assert found.labels[30, 10] != found.labels[30, 40]
    assert (found.scores > 0.5).tolist() == [True, False]


def test_specks_are_no_oysters_and_nothing_gives_nothing():
    assert len(find_instances(discs((20, 30, 2)), discs(), Division(area=400)).scores) == 0
    empty = find_instances(discs(), discs())
    assert not empty.labels.any()


def test_a_large_picture_is_divided_as_a_small_one_and_its_masks_are_of_its_own_size():
    places = (20, 30, 12), (42, 30, 12)
    oyster, depth = (cv2.resize(plane, (1600, 1200)) for plane in (discs(*places), hills(*places)))
    found = find_instances(oyster, depth)
    assert len(found.scores) == 2
    assert np.array_equal(found.labels > 0, oyster > 0.5)


def test_scores_are_moved_so_that_a_half_is_where_as_many_are_counted_as_there_are():
    assert moved(np.array([0.0, 0.3, 1.0]), 0.3) == pytest.approx([0, 0.5, 1])
    scores = np.linspace(0.01, 0.99, 50)
    assert (np.diff(moved(scores, 0.2)) > 0).all()
    assert moved(scores, 0.5) == pytest.approx(scores)


def test_an_oyster_whose_depth_is_that_of_its_outline_is_surer_than_one_whose_depth_is_of_another():
    oyster = discs((20, 30, 12), (58, 30, 12))
    numbers = np.where(oyster > 0, 1 + (np.arange(80) >= 40), 0).astype(np.uint16)
    depth = depths(numbers).astype(np.float32) / 255
    sunk = np.where(numbers == 2, 0.5 * depth, depth).astype(np.float32)
    found = find_instances(oyster, sunk)
    right, wrong = found.scores[found.labels[30, [20, 58]] - 1]
    assert right == pytest.approx(0.9, abs=0.02)
    assert wrong < 0.8 * right


def test_a_small_oyster_is_less_sure_than_a_large_one_and_as_sure_in_a_picture_of_twice_the_size():
    oyster, depth = discs((15, 30, 3), (50, 30, 14)), hills((15, 30, 3), (50, 30, 14))
    found = find_instances(oyster, depth, Division(large=60.0))
    small, large = found.scores[found.labels[30, [15, 50]] - 1]
    assert small < 0.6 * large
    twice = find_instances(
        *(np.kron(plane, np.ones((2, 2), np.float32)) for plane in (oyster, depth)), Division(large=60.0)
    )
    assert twice.scores[twice.labels[60, [30, 100]] - 1] == pytest.approx([small, large], abs=0.05)


def test_the_state_of_an_oyster_is_the_mean_over_it():
    found = find_instances(discs((10, 30, 6), (40, 30, 6)), hills((10, 30, 6), (40, 30, 6)))
    left = np.zeros(found.labels.shape, np.float32)
    left[:, :25] = 1
    values = means(found, left)
    assert values[found.labels[30, 10] - 1] == pytest.approx(1)
    assert values[found.labels[30, 40] - 1] == pytest.approx(0)
