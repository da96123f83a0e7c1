"""A clock that is off is told of where it costs much, and nothing is said where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam import SlamSettings, score
from oysterbench.evaluate.slam.time_offset import shift

SECONDS = np.arange(0, 40, 0.05)


def path(noise_m=0.0):
    """A winding path with varying speed and heading; stamps from 1000 s on."""
    t = SECONDS + 0.8 * np.sin(0.5 * SECONDS)
    positions = np.stack([2 * np.cos(0.4 * t), 1.5 * np.sin(0.55 * t), 0.2 * np.sin(0.9 * t)], axis=1)
    positions += np.random.default_rng(1).normal(0, noise_m, positions.shape)
    yaw = 0.5 * np.sin(0.7 * t) + 0.3 * np.sin(1.9 * t)
    quaternions = np.stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    return Trajectory((1e9 * (1000 + SECONDS)).astype(np.int64), positions, quaternions)


@pytest.mark.parametrize(("offset_s", "side"), [(0.1, "late"), (-0.1, "early")])
def test_an_offset_of_the_clock_is_told_with_what_it_costs_and_what_to_type(offset_s, side):
    (note,) = score(path(), shift(path(0.005), offset_s)).notes
    assert f"0.100 s {side}" in note
    assert "--time-offset estimate" in note
    mended = score(path(), shift(path(0.005), offset_s), SlamSettings(time_offset_s="estimate"))
    assert f"{mended.metrics['ate_rmse_m']:.3g} m instead of" in note


@pytest.mark.parametrize("noise_m", [0.0, 0.02])
def test_nothing_is_said_of_a_clock_that_is_right(noise_m):
    assert score(path(), path(noise_m)).notes == ()


def test_nothing_is_said_where_another_error_is_the_greater_one():
    off = path()
    drift = 0.5 * np.linspace(0, 1, len(SECONDS))[:, None]
    drifting = Trajectory(off.stamps_ns, off.positions + drift, off.quaternions)
    assert not any("--time-offset" in note for note in score(path(), shift(drifting, 0.01)).notes)


def test_nothing_is_said_of_an_offset_that_was_given():
    late = shift(path(0.005), 0.1)
    assert score(path(), late, SlamSettings(time_offset_s=-0.05)).notes == ()
