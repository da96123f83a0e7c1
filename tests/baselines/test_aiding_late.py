"""What the aiding promises of a Doppler log whose messages are late, and of pings that are wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.instants import History, instants
from oysterbench_baselines.common.aiding.ping_clock import PingClock, PingClockSettings
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.dead_reckoning import DeadReckoning
from tests.helpers import sensor_dive as dive

ALL = ("dvl", "pressure", "magnetometer")


def arrivals(jitter_s: float, n: int = 200, lost: slice = slice(0, 0)) -> tuple[Array, Array]:
    """Times (M,) s of pings 8 times a second, and of their messages, 0.1 s later by even odds of that jitter."""
    times = np.delete(np.arange(n) / 8.0, lost)
    spread = jitter_s * np.sqrt(12) * (np.random.default_rng(0).random(len(times)) - 0.5)
    return times, times + 0.1 + spread


def smoothed(stamps: Array) -> tuple[Array, Array]:
    """Times (M,) s that a clock makes of stamps, and their 1 sigma."""
    clock = PingClock(PingClockSettings())
    found = np.array([clock.late(round(stamp * 1e9)) for stamp in stamps])
    return stamps - found[:, 0], found[:, 1]


def test_the_clock_of_a_log_tells_when_it_pinged_three_times_better_than_its_stamps():
    times, stamps = arrivals(0.05)
    found, sigma = smoothed(stamps)
    error = (found - times)[50:]
    assert 3 * error.std() < (stamps - times).std()
    assert abs(error.mean() - 0.1) < 0.02  # of the latency it says nothing
    assert 0.3 < error.std() / sigma[50:].mean() < 2


def test_the_clock_of_a_log_without_jitter_leaves_its_stamps_as_they_are():
    _, stamps = arrivals(0.0)
    found, sigma = smoothed(stamps)
    np.testing.assert_allclose(found, stamps, atol=1e-6)
    assert sigma[-1] < 1e-3


def test_the_clock_goes_on_where_messages_were_lost():
    times, stamps = arrivals(0.01, lost=slice(80, 100))
    error = smoothed(stamps)[0] - times
    assert np.abs(error[60:] - 0.1).max() < 0.02


def test_an_instant_is_the_same_from_before_and_from_after():
    """The velocity half a second ago, from a state now; and that of now from a state then."""
    rng = np.random.default_rng(0)
    segment = Segment(np.full(100, 0.01), 0.3 * rng.standard_normal((100, 3)), rng.standard_normal((100, 3)))
    bias = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -0.1])
    ahead, behind = History(2.0), History(2.0)
    for k in range(100):
        part = Segment(segment.dt[k : k + 1], segment.gyro[k : k + 1], segment.accel[k : k + 1])
        ahead.add(part)
        behind.add(part)
        if k == 49:
            ahead.mark()
    start, down = np.array([0.4, -0.1, 0.2]), np.array([0.5, 1.0, -9.7])
    then = instants(ahead.about_mark(), np.array([0.5]), *bias)
    now = then.velocities(start, down)[0]
    back = instants(behind.about_end(), np.array([-0.5]), *bias)
    np.testing.assert_allclose(back.velocities(now, then.rotation[0].T @ down)[0], start, atol=1e-12)
    assert then.time[0] == pytest.approx(0.5)
    assert back.time[0] == pytest.approx(-0.5)


def reckon(sequence: dive.SensorDive):
    """RMSE of position, m, in odom, and what the method says."""
    estimate = DeadReckoning().run(sequence.for_method())
    return position_error(sequence, estimate.trajectory.positions), estimate


def position_error(sequence: dive.SensorDive, positions: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((positions - sequence.truth_from_start().positions) ** 2, axis=1))))


def late(sequence: dive.SensorDive, latency_s: float) -> None:
    """Messages of the log are stamped on arrival, half to one and a half of the latency late."""
    rng, last = np.random.default_rng(1), [0]

    def arrive(sample):
        last[0] = max(sample.stamp_ns + round(latency_s * 1e9 * rng.uniform(0.5, 1.5)), last[0] + 10**6)
        return dataclasses.replace(sample, stamp_ns=last[0])

    sequence.change("dvl", arrive)


@pytest.mark.slow
@pytest.mark.parametrize("latency_s", [0.1, 0.2])
def test_a_late_log_is_as_good_as_one_in_time(latency_s):
    vehicle, path = dive.rig(*ALL), dive.survey_path(40.0)
    in_time, slow = (dive.SensorDive(2, vehicle, path) for _ in range(2))
    late(slow, latency_s)
    (error, _), (late_error, estimate) = reckon(in_time), reckon(slow)
    assert late_error < 2 * error + 0.02
    assert estimate.info["refused"]["dvl"] < 5
    assert estimate.info["dvl_latency_s"] == pytest.approx(latency_s, abs=0.02)
