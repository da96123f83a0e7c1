"""Recent instants relative to a state: how the vehicle has turned and accelerated between them.

A sensor that reports late saw the vehicle where it was, while an estimator has it where it is: the inertial
measurements link the two, backwards in time as well as forwards.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.inertial import Segment, integrate


@dataclass(frozen=True)
class Record:
    """Inertial measurements around an instant: a segment (N,) that starts `before_s` (s) before it."""

    segment: Segment
    before_s: float


class History:
    """Inertial measurements since a mark and of `reach_s` (s) before it."""

    def __init__(self, reach_s: float) -> None:
        self._reach_s = reach_s
        self._segments = deque[Segment]()
        self._kept_s = self._since_s = 0.0
        self._marked = False

    @property
    def since_s(self) -> float:
        """Time (s) from the mark to the end; from the start where there is no mark."""
        return self._since_s

    def add(self, segment: Segment) -> None:
        self._segments.append(segment)
        self._kept_s += segment.duration
        self._since_s += segment.duration
        wanted = self._reach_s + (self._since_s if self._marked else 0.0)
        while self._kept_s - self._segments[0].duration > wanted:
            self._kept_s -= self._segments.popleft().duration

    def mark(self) -> None:
        """Set the mark to the present end: at a keyframe."""
        self._marked, self._since_s = True, 0.0

    def about_end(self) -> Record:
        return Record(Segment.join(list(self._segments)), self._kept_s)

    def about_mark(self) -> Record:
        return Record(Segment.join(list(self._segments)), self._kept_s - self._since_s)


@dataclass(frozen=True)
class Instants:
    """K instants relative to a state of attitude R and velocity v, u = R^T v: at each the velocity is

    rotation^T (u + time R^T g + gained), in the IMU's frame of that instant.

    time (K,) s, after the state; rotation (K, 3, 3) from there to the state's frame; gained (K, 3) m/s, by the specific
    force less its bias, in the state's frame; accel (K, 3, 3): its derivative by that bias; rate (K, 3) rad/s.
    """

    time: Array
    rotation: Array
    gained: Array
    accel: Array
    rate: Array

    def velocities(self, start: Array, down: Array) -> Array:
        """Velocities (K, 3) m/s, given u and R^T g (3,)."""
        there = start + self.time[:, None] * down + self.gained
        return np.asarray(np.einsum("kji,kj->ki", self.rotation, there))


def instants(record: Record, times: Array, gyro_bias: Array, accel_bias: Array) -> Instants:
    """Instants at times (K,) s after a record's instant, clipped to what it holds; biases (3,)."""
    segment, before = record.segment, record.before_s
    if not len(segment.dt):  # nothing has happened yet
        segment = Segment(np.full(1, 1e-9), gyro_bias[None], accel_bias[None])
    nodes = np.concatenate([[0.0], np.cumsum(segment.dt)]) - before
    times = np.clip(times, nodes[0], nodes[-1])
    wanted, inverse = np.unique(np.concatenate([[0.0], times]), return_inverse=True)
    # Within an IMU step the signal is taken to be its mean, so that a step may be cut anywhere.
    cuts = np.union1d(nodes, wanted)
    step = np.clip(np.searchsorted(nodes, 0.5 * (cuts[1:] + cuts[:-1])) - 1, 0, len(segment.dt) - 1)
    ends = np.searchsorted(cuts, wanted)
    parts = [
        Segment(np.diff(cuts[first : last + 1]), segment.gyro[step[first:last]], segment.accel[step[first:last]])
        for first, last in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True)
    ]
    integral = integrate(parts, gyro_bias)
    velocity = integral.velocity - integral.velocity_rate @ accel_bias
    # integral: relative to the start of the record, with one more node than wanted; the state's is `origin`.
    at, origin = inverse + 1, inverse[0] + 1
    back = integral.rotation[origin].T
    at = at[1:]
    return Instants(
        integral.time[at] - integral.time[origin],
        back @ integral.rotation[at],
        (velocity[at] - velocity[origin]) @ back.T,
        back @ -(integral.velocity_rate[at] - integral.velocity_rate[origin]),
        segment.gyro[step[np.maximum(ends[at - 1] - 1, 0)]] - gyro_bias,
    )
