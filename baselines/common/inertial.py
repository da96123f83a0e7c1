"""Inertial samples, cut at the stamps of other sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import ImuMeasurement


@dataclass(frozen=True)
class Segment:
    """Inertial measurements between two stamps: dt (N,) s, and over each the mean gyro, accel (N, 3), SI, IMU frame."""

    dt: Array
    gyro: Array
    accel: Array

    @property
    def duration(self) -> float:
        return float(self.dt.sum())

    @staticmethod
    def join(segments: list[Segment]) -> Segment:
        """Consecutive segments as one."""
        if not segments:
            return Segment(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
        return Segment(
            np.concatenate([s.dt for s in segments]),
            np.concatenate([s.gyro for s in segments]),
            np.concatenate([s.accel for s in segments]),
        )


class SampleBuffer:
    """Collects samples and hands out what lies between consecutive cuts.

    Between samples the signal is taken to be linear, so that the mean over an interval is that of its ends: an error
    of second order in the sampling interval. After the last sample the signal is held.
    """

    def __init__(self) -> None:
        self._samples: list[ImuMeasurement] = []
        self._cut: ImuMeasurement | None = None

    def add(self, sample: ImuMeasurement) -> None:
        self._samples.append(sample)

    def cut(self, stamp_ns: int) -> Segment:
        """The measurements from the last cut (or the first sample) to `stamp_ns`."""
        inside = [sample for sample in self._samples if sample.stamp_ns <= stamp_ns]
        after = self._samples[len(inside) :]
        nodes = ([self._cut] if self._cut is not None else []) + inside
        if not nodes:
            return Segment.join([])
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
        return Segment(dt[real], (0.5 * (gyro[1:] + gyro[:-1]))[real], (0.5 * (accel[1:] + accel[:-1]))[real])


def relative_rotation(segment: Segment, gyro_bias: Array) -> Array:
    """R_start_end (3, 3): the rotation over a segment."""
    rotation = np.eye(3)
    for step in Rotation.from_rotvec((segment.gyro - gyro_bias) * segment.dt[:, None]).as_matrix():
        rotation = rotation @ step
    return rotation
