"""What a sequence gives: measurements, calibrations, and the views that a method and an evaluator have of it."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.errors import MethodError
from oysterbench.geometry import Array
from oysterbench.samples import Image, ImuSample
from oysterbench.trajectory import Trajectory


@dataclass(frozen=True)
class CameraCalibration:
    """A camera: matrix (3, 3) in px, distortion, pose of its optical frame.

    distortion_model and distortion as in sensor_msgs/CameraInfo: plumb_bob (Brown-Conrady k1, k2, p1, p2[, k3]) or
    equidistant (Kannala-Brandt k1 to k4).
    """

    width: int
    height: int
    rate_hz: float
    matrix: Array
    distortion: Array
    T_base_cam: Array
    distortion_model: str = "plumb_bob"


@dataclass(frozen=True)
class ImuCalibration:
    """Continuous noise densities, bias random walks, 1-sigma turn-on biases (units as in `recipe.ImuRecipe`), pose."""

    rate_hz: float
    gyro_noise_density: float
    gyro_random_walk: float
    gyro_turn_on: float
    accel_noise_density: float
    accel_random_walk: float
    accel_turn_on: float
    gravity: float  # m/s^2
    T_base_imu: Array


class Sequence(ABC):
    """Sensors of one run of a vehicle, in time order, and the truth if the file holds it."""

    name: str
    cameras: Mapping[str, CameraCalibration]
    imu_calibration: ImuCalibration
    metadata: Mapping[str, str]

    @abstractmethod
    def images(self, camera: str) -> Iterator[Image]:
        """Colour frames of a camera, in time order."""

    @abstractmethod
    def imu(self) -> Iterator[ImuSample]:
        """Inertial samples, in time order."""

    @abstractmethod
    def truth(self) -> Trajectory:
        """True poses T_map_base. Raises SequenceError where the file has none."""

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """From the first stamp to the last, s."""

    @abstractmethod
    def contents(self) -> list[tuple[str, str, int]]:
        """Name, type and number of messages of each topic."""

    def stream(self, *cameras: str) -> Iterator[ImuSample | Image]:
        """Inertial samples and the frames of `cameras` (all by default), merged in time order.

        At one stamp the inertial sample comes first, so that a frame is always preceded by all inertial samples
        up to its stamp.
        """
        sources: list[Iterator[ImuSample | Image]] = [self.imu()]
        sources += [self.images(camera) for camera in (cameras or tuple(self.cameras))]
        return heapq.merge(*sources, key=lambda item: (item.stamp_ns, isinstance(item, Image)))

    def for_method(self) -> Sequence:
        """The same sensors without the truth: what a method is given."""
        return SensorsOnly(self)


class SensorsOnly(Sequence):
    """A sequence whose truth cannot be reached."""

    def __init__(self, sequence: Sequence) -> None:
        self.name = sequence.name
        self.cameras = sequence.cameras
        self.imu_calibration = sequence.imu_calibration
        self.metadata = {"sequence": sequence.name}
        self._duration_s = sequence.duration_s
        self._contents = [row for row in sequence.contents() if not row[0].startswith("/truth")]
        images, imu = sequence.images, sequence.imu
        # Only the two iterators are kept, in closures, not the sequence: nothing here leads to the truth by name.
        self._images = lambda camera: images(camera)
        self._imu = lambda: imu()

    def images(self, camera: str) -> Iterator[Image]:
        return self._images(camera)

    def imu(self) -> Iterator[ImuSample]:
        return self._imu()

    @property
    def duration_s(self) -> float:
        return self._duration_s

    def contents(self) -> list[tuple[str, str, int]]:
        return list(self._contents)

    def truth(self) -> Trajectory:
        raise MethodError("a method does not see the truth: Sequence.truth() is for evaluators")


def imu_arrays(samples: Iterator[ImuSample]) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps (N,) ns, gyro (N, 3) rad/s and accel (N, 3) m/s^2 of all samples."""
    rows = list(samples)
    return (
        np.array([row.stamp_ns for row in rows], dtype=np.int64),
        np.array([row.gyro for row in rows]).reshape(-1, 3),
        np.array([row.accel for row in rows]).reshape(-1, 3),
    )
