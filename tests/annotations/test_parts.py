"""The connected parts of masks."""

from __future__ import annotations

import numpy as np

from oysterbench.annotations.parts import connected_parts, speck_px, without_specks
from oysterbench.mapping.predicted import components


def two_oysters_and_specks():
    """A mask of two parts of 100 px, and of 30 single pixels."""
    mask = np.zeros((480, 640), bool)
    mask[10:20, 10:20] = mask[100:110, 100:110] = True
    mask[200:260:2, 300] = True
    return mask


def test_parts_are_connected_by_corners():
    numbers, means = connected_parts(np.eye(3, dtype=bool))
    assert numbers.max() == 1
    assert means is None


def test_scores_are_mean_probabilities():
    mask = two_oysters_and_specks()
    probability = np.where(mask, 0.9, 0.0)
    probability[100:105, 100:110] = 0.7
    numbers, means = connected_parts(mask, probability)
    assert len(means) == numbers.max() == 32
    assert np.allclose([means[numbers[15, 15] - 1], means[numbers[105, 105] - 1]], [0.9, 0.8])


def test_specks_are_no_oysters_of_a_map():
    mask = two_oysters_and_specks()
    assert 1 < speck_px(mask.shape) < 100
    assert set(np.unique(without_specks(connected_parts(mask)[0]))) == {0, 1, 2}
    seen = components(0, "left", mask, np.where(mask, 0.75, 0.0))
    numbers = np.unique(seen.numbers[seen.numbers > 0])
    assert [seen.scores[number] for number in numbers] == [0.75, 0.75]


def test_a_picture_twice_as_large_has_specks_four_times_as_large():
    assert np.isclose(speck_px((960, 1280)), 4 * speck_px((480, 640)))
