"""Stamps that were printed with too few digits, so that poses of several times have the same."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory import read_trajectory

TIMES = 1767225600 + 0.05 * np.arange(400)
PLACES = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.05, 400))


def written(tmp_path, stamps, places=PLACES):
    path = tmp_path / "poses.txt"
    turns = 0.2 * places
    rows = zip(stamps, places, np.sin(turns), np.cos(turns), strict=True)
    path.write_text("".join(f"{t} {x:.6f} 0 0 0 0 {s:.9f} {c:.9f}\n" for t, x, s, c in rows))
    return path


@pytest.mark.parametrize(
    ("form", "got"),
    [
        ("{:.6g}", "got 1 for 400 poses, which all have the same"),  # C++ by default
        ("{:.9e}", "got 21 for 400 poses, which look rounded to 1 s"),
        ("{:.0f}", "which look rounded to 1 s"),
    ],
)
def test_stamps_with_too_few_digits_are_refused_with_the_way_to_print_them(form, got, tmp_path):
    path = written(tmp_path, map(form.format, TIMES))
    with pytest.raises(TrajectoryError) as caught:
        read_trajectory(path)
    assert got in str(caught.value)
    assert "print at least 9 decimals (C++: std::fixed << std::setprecision(9)" in str(caught.value)
    assert "or, if these are several poses of one time, keep one of them (--duplicates" in str(caught.value)
    assert len(read_trajectory(path, duplicates="first")) == len({form.format(t) for t in TIMES})


def test_two_poses_at_each_stamp_that_are_of_one_time_are_not_taken_for_rounded(tmp_path):
    """As motion capture has them, a hair apart, or a program that writes what it predicted and what it measured."""
    twice = np.repeat(TIMES[::2], 2)
    hair = np.repeat(PLACES[::2], 2) + np.tile([0.0, 1e-4], 200)
    assert len(read_trajectory(written(tmp_path, (f"{t:.3f}" for t in twice), hair))) == 200
    thrice = np.repeat(TIMES[::3], 3)[:400]
    near = np.repeat(PLACES[::3], 3)[:400] + np.tile([0.0, 0.015, 0.03], 134)[:400]
    assert len(read_trajectory(written(tmp_path, (f"{t:.3f}" for t in thrice), near))) == 134
    jumps = np.repeat(PLACES[::2], 2) + np.tile([0.0, 1.0], 200)
    with pytest.raises(TrajectoryError, match="expected one pose for each timestamp"):
        read_trajectory(written(tmp_path, (f"{t:.3f}" for t in twice), jumps))
