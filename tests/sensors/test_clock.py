"""Stamps, and messages that do not arrive."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.sensors.clock import kept, stamps
from oysterbench.sensors.pressure import PressureRecipe

EPOCH = 1_767_225_600_000_000_000


def losing(share, burst=1.0):
    return PressureRecipe(dropout=share, dropout_burst=burst)


def runs(arrived):
    """Lengths of the runs of losses."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], arrived, [True]]).astype(int)))
    return np.diff(edges)[::2]


def test_stamps_are_whole_nanoseconds_that_never_drift():
    found = stamps(3_000_001, 300.0, EPOCH)
    assert found.dtype == np.int64
    assert found[:4].tolist() == [EPOCH, EPOCH + 3_333_333, EPOCH + 6_666_667, EPOCH + 10_000_000]
    assert found[-1] == EPOCH + 10_000 * 10**9


def test_an_offset_of_the_clock_shifts_every_stamp():
    assert np.array_equal(stamps(50, 20.0, EPOCH, 12.5) - stamps(50, 20.0, EPOCH), np.full(50, 12_500_000))
    assert stamps(1, 20.0, EPOCH, -0.25)[0] == EPOCH - 250_000


@pytest.mark.parametrize(("share", "burst"), [(0.02, 1.0), (0.1, 5.0), (0.5, 1.0), (0.3, 40.0), (0.9, 20.0)])
def test_losses_have_the_share_and_the_bursts_asked_for(share, burst):
    arrived = kept(1_000_000, losing(share, burst), Streams(3))
    assert np.mean(~arrived) == pytest.approx(share, rel=0.05)
    assert runs(arrived).mean() == pytest.approx(burst, rel=0.05)


def test_bursts_forget_how_long_they_have_lasted():
    lengths = runs(kept(1_000_000, losing(0.2, 4.0), Streams(5)))
    for least in (1, 2, 5, 10):
        assert np.mean(lengths[lengths >= least] == least) == pytest.approx(1 / 4.0, rel=0.05)


def test_the_first_message_is_lost_as_often_as_any_other():
    arrived = np.stack([kept(30, losing(0.3, 3.0), Streams(seed)) for seed in range(3000)])
    assert np.mean(~arrived, axis=0) == pytest.approx(np.full(30, 0.3), abs=0.035)


def test_losses_do_not_depend_on_how_many_messages_follow():
    long, short = (kept(n, losing(0.2, 3.0), Streams(8)) for n in (5000, 700))
    assert np.array_equal(long[:700], short)


def test_nothing_is_lost_unless_asked_for_and_cameras_lose_frames_alike():
    assert kept(1000, losing(0.0), Streams(1)).all()
    (camera,) = load_split("slam-mini").rig.camera
    dark = dataclasses.replace(camera, dropout=0.25, dropout_burst=2.0)
    assert np.array_equal(kept(1000, dark, Streams(1)), kept(1000, losing(0.25, 2.0), Streams(1)))


def test_two_sensors_lose_different_messages():
    a, b = (kept(20_000, losing(0.3, 3.0), Streams(1).at(name)) for name in ("imu", "pressure"))
    assert np.corrcoef(a, b)[0, 1] == pytest.approx(0.0, abs=0.05)


def test_hardly_any_losses_and_hardly_any_messages_are_possible():
    assert kept(1000, losing(1e-15), Streams(1)).all()
    arrived = kept(100_000, losing(0.9, 9.0), Streams(1))  # the shortest bursts that leave one message between them
    assert np.mean(~arrived) == pytest.approx(0.9, abs=0.01)
    assert not np.any(arrived[1:] & arrived[:-1])
