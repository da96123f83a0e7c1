"""Which poses are compared: pairs made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.evaluate.slam.association import find_gaps
from oysterbench.evaluate.slam.pairs import (
    pairs_along,
    pairs_over_frames,
    pairs_over_time,
    run_of,
    segments,
)


def test_a_sub_path_ends_at_the_first_stamp_beyond_its_length_and_not_on_it():
    """KITTI's `dist[i] > dist[first] + length`: on poses a metre apart, 2 m end at the third pose on."""
    np.testing.assert_array_equal(segments(np.arange(6.0), 2.0), [[0, 3], [1, 4], [2, 5]])
    np.testing.assert_array_equal(segments(np.arange(6.0), 2.0, step=2), [[0, 3], [2, 5]])
    assert len(segments(np.arange(6.0), 5.0)) == 0


def test_a_sub_path_of_rpgs_ends_at_the_stamp_nearest_to_its_length():
    np.testing.assert_array_equal(segments(np.array([0, 1, 1.9, 3, 4.5]), 2.0, nearest=0.4), [[0, 2], [1, 3]])


def test_a_single_unanswered_stamp_is_a_gap():
    stamps = np.arange(7) * 10**9
    gaps = find_gaps(stamps, np.array([True, True, False, True, False, False, True]))
    assert (gaps.number, gaps.longest_s, gaps.first_fix_s) == (2, 3.0, 0.0)
    gaps = find_gaps(stamps, np.array([False, False, True, True, True, False, False]))
    assert (gaps.number, gaps.longest_s, gaps.first_fix_s) == (1, 2.0, 2.0)


def test_consecutive_pairs_begin_where_the_last_one_ended():
    stamps = np.round(np.array([0, 0.5, 1, 1.5, 2, 3.5, 4, 4.5, 5]) * 1e9).astype(np.int64)
    np.testing.assert_array_equal(pairs_over_time(stamps, 1.0, consecutive=True), [[0, 2], [2, 4], [5, 7]])
    np.testing.assert_array_equal(pairs_along(np.array([0, 0.4, 1.1, 1.8, 2.2]), 1.0, True), [[0, 2], [2, 4]])
    np.testing.assert_array_equal(pairs_over_frames(6, 2, True), [[0, 2], [2, 4]])


@pytest.mark.parametrize("consecutive", [True, False])
def test_a_single_pose_or_a_long_way_has_no_pairs(consecutive):
    assert pairs_over_time(np.array([5]), 1.0, consecutive).shape == (0, 2)
    assert pairs_along(np.array([0.0]), 1.0, consecutive).shape == (0, 2)
    assert pairs_along(np.array([0.0, 0.1, 0.2]), 1.0, consecutive).shape == (0, 2)
    assert pairs_over_frames(3, 5, consecutive).shape == (0, 2)


def test_indices_are_a_run_only_where_each_is_the_next():
    assert run_of(np.array([3, 4, 5])) == slice(3, 6)
    for index in ([3, 3, 5], [3, 5, 5], [4, 3, 6], [0, 2]):
        np.testing.assert_array_equal(run_of(np.array(index)), index)
