"""The clock of paths from KITTI folders: times.txt counts from the first image, whose own stamp may be any."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.trajectory import Trajectory
from oysterbench.methods.interfaces.slam import on_clock

PERIOD_NS = 50_000_000


def images(start_s: float, jitter_ns: int = 0) -> np.ndarray:
    """Stamps (640,) ns of a camera of 20 Hz."""
    return round(start_s * 1e9) + np.arange(640) * PERIOD_NS + np.random.default_rng(1).integers(0, jitter_ns + 1, 640)


def at(stamps_ns: np.ndarray) -> Trajectory:
    """A path with poses at these stamps."""
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps_ns), 1))
    return Trajectory(stamps_ns, np.zeros((len(stamps_ns), 3)), quaternions)


@pytest.mark.parametrize("start_s", [0.05, 5.0, 31.0, 1000.0, 1.7e9])
def test_stamps_of_times_txt_are_recognised_whenever_the_clock_starts(start_s):
    times = images(start_s)
    found = on_clock(at(times - times[0]), times)
    np.testing.assert_array_equal(found.stamps_ns, times)
    assert "count from the first image" in found.notes[-1]
    rounded = on_clock(at((times - times[0]) // 1_000_000 * 1_000_000), times)  # printed in milliseconds
    assert abs(rounded.stamps_ns - times).max() <= 1_000_000


def test_poses_between_the_images_are_recognised_by_where_they_begin():
    times = images(5.0)
    between = np.arange(10_000_000, times[-1] - times[0], PERIOD_NS)
    np.testing.assert_array_equal(on_clock(at(between), times).stamps_ns, between + times[0])


@pytest.mark.parametrize("start_s", [0.0, 0.05, 5.0, 31.0, 1000.0])
@pytest.mark.parametrize("part", [slice(None), slice(0, 50), slice(200, None), slice(3, None, 7)])
def test_stamps_of_the_sequence_stay(start_s, part):
    times = images(start_s)
    found = on_clock(at(times[part]), times)
    np.testing.assert_array_equal(found.stamps_ns, times[part])


def test_a_clock_whose_stamps_are_not_on_one_grid_tells_paths_that_begin_late_apart():
    times = images(5.0, jitter_ns=20_000_000)
    for part in (slice(150, 300), slice(101, 105)):
        np.testing.assert_array_equal(on_clock(at(times[part]), times).stamps_ns, times[part])
        np.testing.assert_array_equal(on_clock(at(times[part] - times[0]), times).stamps_ns, times[part])


def test_stamps_that_may_be_either_stay_and_a_note_says_so():
    times = images(5.0)
    found = on_clock(at(times[100:300]), times)
    np.testing.assert_array_equal(found.stamps_ns, times[100:300])
    assert "may count from the first image" in found.notes[-1]


def test_one_image_is_enough():
    assert on_clock(at(np.array([0])), np.array([7_000_000_000])).stamps_ns.tolist() == [7_000_000_000]
