"""Inertial samples, cut at the stamps of other sensors, and integrated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import ImuMeasurement

MOST_RATE, MOST_FORCE = 10.0, 50.0
"""Rad/s and m/s^2 beyond which a sample is a fault of the unit or of its bus: no vehicle under water turns or is struck
like this, and a single one would move the path by metres."""
LONGEST_GAP_S = 0.1
"""Time without samples beyond which nothing is known of the motion: twice the interval of a unit of 20 Hz."""


def is_plausible(sample: ImuMeasurement) -> bool:
    """Whether a vehicle can have moved like this; false for what is not a number, too."""
    return bool(sample.gyro @ sample.gyro < MOST_RATE**2 and sample.accel @ sample.accel < MOST_FORCE**2)


@dataclass(frozen=True)
class Segment:
    """Inertial measurements between two stamps: dt (N,) s, and over each the mean gyro, accel (N, 3), SI, IMU frame.

    gap_s: the longest time without a sample in it, which may have begun before it.
    """

    dt: Array
    gyro: Array
    accel: Array
    gap_s: float = 0.0

    @property
    def duration(self) -> float:
        return float(self.dt.sum())

    @property
    def has_gap(self) -> bool:
        """Whether samples are missing for so long that the motion is unknown."""
        return self.gap_s > LONGEST_GAP_S

    def first(self, count: int) -> Segment:
        """Its first `count` measurements, as views that take no memory of their own."""
        return Segment(self.dt[:count], self.gyro[:count], self.accel[:count], self.gap_s)

    def after(self, count: int) -> Segment:
        """It without its first `count` measurements."""
        return Segment(self.dt[count:], self.gyro[count:], self.accel[count:], self.gap_s)

    @staticmethod
    def join(segments: list[Segment]) -> Segment:
        """Consecutive segments as one."""
        if not segments:
            return Segment(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
        return Segment(
            np.concatenate([s.dt for s in segments]),
            np.concatenate([s.gyro for s in segments]),
            np.concatenate([s.accel for s in segments]),
            max(s.gap_s for s in segments),
        )


class SampleBuffer:
    """Buffer of samples, which hands out what lies between consecutive cuts.

    Between samples the signal is taken to be linear, so that the mean over an interval is that of its ends: an error
    of second order in the sampling interval. After the last sample the signal is held. Samples that no motion explains
    are left out; refused: how many.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._samples: list[ImuMeasurement] = []
        self._cut: ImuMeasurement | None = None
        self._sampled_ns: int | None = None  # stamp of the last sample before the last cut

    def add(self, sample: ImuMeasurement) -> None:
        if is_plausible(sample):
            self._samples.append(sample)
        else:
            self.refused += 1

    def cut(self, stamp_ns: int) -> Segment:
        """The measurements from the last cut (or the first sample) to `stamp_ns`."""
        inside = [sample for sample in self._samples if sample.stamp_ns <= stamp_ns]
        after = self._samples[len(inside) :]
        nodes = ([self._cut] if self._cut is not None else []) + inside
        if not nodes:
            return Segment.join([])
        # Without a later sample, the gap reaches at least to the cut.
        sampled = [sample.stamp_ns for sample in inside] + [after[0].stamp_ns if after else stamp_ns]
        gap_ns = max(np.diff(sampled if self._sampled_ns is None else [self._sampled_ns, *sampled]), default=0)
        self._sampled_ns = inside[-1].stamp_ns if inside else self._sampled_ns
        last = nodes[-1]
        if last.stamp_ns < stamp_ns:
            if after:
                share = (stamp_ns - last.stamp_ns) / (after[0].stamp_ns - last.stamp_ns)
                gyro = last.gyro + share * (after[0].gyro - last.gyro)
                accel = last.accel + share * (after[0].accel - last.accel)
                last = ImuMeasurement(stamp_ns, gyro, accel)
            else:
                last = ImuMeasurement(stamp_ns, last.gyro, last.accel)
            nodes.append(last)
        self._cut, self._samples = last, after
        stamps = np.array([node.stamp_ns for node in nodes], dtype=np.int64)
        dt = np.diff(stamps) * 1e-9
        gyro = np.array([node.gyro for node in nodes])
        accel = np.array([node.accel for node in nodes])
        real = dt > 0
        gyro, accel = (0.5 * (gyro[1:] + gyro[:-1]))[real], (0.5 * (accel[1:] + accel[:-1]))[real]
        return Segment(dt[real], gyro, accel, float(gap_ns) * 1e-9)


def relative_rotation(segment: Segment, gyro_bias: Array) -> Array:
    """R_start_end (3, 3): the rotation over a segment."""
    rotation = np.eye(3)
    for step in Rotation.from_rotvec((segment.gyro - gyro_bias) * segment.dt[:, None]).as_matrix():
        rotation = rotation @ step
    return rotation


@dataclass(frozen=True)
class Integral:
    """Inertial integrals from the first of K stamps to each, in the IMU frame at the first.

    rotation (K, 3, 3): R_0_k. rate (K, 3, 3): integral of R, so that a change db of the gyro bias turns R_0_k by
    -rate db (rotation vector in frame 0). velocity, position (K, 3): of the specific force. velocity_rate,
    position_rate (K, 3, 3): minus their derivatives by the accelerometer bias. time (K,) s.
    """

    time: Array
    rotation: Array
    rate: Array
    velocity: Array
    position: Array
    velocity_rate: Array
    position_rate: Array


def integrate(segments: list[Segment], gyro_bias: Array) -> Integral:
    """Integrals at the K = len(segments) + 1 ends of segments, for a gyro bias and no accelerometer bias."""
    whole = Segment.join(segments)
    steps = Rotation.from_rotvec((whole.gyro - gyro_bias) * whole.dt[:, None]).as_matrix()
    half_steps = Rotation.from_rotvec(0.5 * (whole.gyro - gyro_bias) * whole.dt[:, None]).as_matrix()
    rotation = np.empty((len(steps) + 1, 3, 3))
    rotation[0] = np.eye(3)
    for k, step in enumerate(steps):
        rotation[k + 1] = rotation[k] @ step
    middle = rotation[:-1] @ half_steps  # attitude in the middle of the interval: second-order integration
    dt = whole.dt[:, None, None]
    force = (middle @ whole.accel[:, :, None])[..., 0]
    velocity = _cumulate(force * whole.dt[:, None])
    velocity_rate = _cumulate(middle * dt)
    position = _cumulate((velocity[:-1] + 0.5 * force * whole.dt[:, None]) * whole.dt[:, None])
    position_rate = _cumulate((velocity_rate[:-1] + 0.5 * middle * dt) * dt)
    ends = np.concatenate([[0], np.cumsum([len(s.dt) for s in segments])]).astype(int)
    time = _cumulate(whole.dt)
    rate = velocity_rate
    return Integral(
        time[ends], rotation[ends], rate[ends], velocity[ends], position[ends], velocity_rate[ends], position_rate[ends]
    )


def _cumulate(steps: Array) -> Array:
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
