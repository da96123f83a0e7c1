"""Measurements: the content of one message of each sensor. Sensors make them, files store them, readers return them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array


@dataclass(frozen=True, repr=False)
class Image:
    """One camera frame.

    pixels: (H, W, 3) uint8 RGB; or a layer: depth (H, W) float32 m along the optical axis from the true pupil, 0 =
    none; class (H, W) uint8 (`recipe.CLASSES`); instance (H, W) uint16, 0 = none; normals (H, W, 3) float32, outward,
    in the optical frame; visibility (H, W) float32, unoccluded fraction of the instance at a pixel, NaN = none; light
    (H, W, 3) float32, 1 = a white matte surface in full daylight: clean (without water), and direct + forward_scatter +
    backscatter + snow, which add up to what reaches the lens; dynamic (H, W) uint8, 1 = moves by itself; flow (H, W, 2)
    float32 px to the right and down until the image of the next frame, NaN = none; transmittance (H, W) float32,
    fraction of green light that arrives through the water, 0 = none.
    """

    stamp_ns: int
    camera: str
    pixels: NDArray[Any]

    def __repr__(self) -> str:
        return f"<Image of {self.camera} at {self.stamp_ns}: {self.pixels.shape} {self.pixels.dtype}>"

    def _repr_png_(self) -> bytes:
        from oysterbench.core.display import png

        return png(self.pixels)


@dataclass(frozen=True)
class ImuMeasurement:
    """Angular rate (3,) rad/s and specific force (3,) m/s^2, both in the IMU frame."""

    stamp_ns: int
    gyro: Array
    accel: Array


@dataclass(frozen=True)
class DvlMeasurement:
    """Velocity over ground (3,) m/s in the DVL's frame (x forward, y left, z up), NaN without bottom lock.

    covariance (3, 3) (m/s)^2, that of the reported velocity; figure_of_merit: its 1-sigma size, m/s; altitude: above
    the bottom along the DVL's -z, m, NaN without lock. Per beam (4,): directions (4, 3) unit vectors in the DVL's
    frame, range along the beam in m and velocity along it in m/s (both NaN where not valid), valid.
    """

    stamp_ns: int
    velocity: Array
    covariance: Array
    figure_of_merit: float
    altitude: float
    beam_directions: Array
    beam_ranges: Array
    beam_velocities: Array
    beam_valid: NDArray[np.bool_]


@dataclass(frozen=True)
class PressureMeasurement:
    """Absolute pressure, Pa, and the variance of its noise, Pa^2."""

    stamp_ns: int
    pressure: float
    variance: float


@dataclass(frozen=True)
class MagneticMeasurement:
    """Magnetic field (3,) T in the magnetometer's frame, and the variance of its noise per axis, T^2."""

    stamp_ns: int
    field: Array
    variance: float


@dataclass(frozen=True)
class RangeMeasurement:
    """Range of an altimeter's echo, m along its axis; +inf where there is no echo within its maximum range."""

    stamp_ns: int
    sensor: str
    range: float


@dataclass(frozen=True)
class SonarImage:
    """One ping of an imaging sonar: amplitudes (bins, beams) uint16, near to far, beams from left (+) to right.

    Amplitude 1 is `SonarCalibration.amplitude_step`; the bins' ranges and the beams' azimuths are in the calibration.
    """

    stamp_ns: int
    sensor: str
    pixels: NDArray[np.uint16]


@dataclass(frozen=True)
class ScanPing:
    """One ping of a scanning sonar: amplitudes (bins,) uint16, near to far, at the head's angle (rad, left of x)."""

    stamp_ns: int
    sensor: str
    angle: float
    amplitudes: NDArray[np.uint16]


@dataclass(frozen=True)
class Cloud:
    """Labelled point cloud of a sonar's returns.

    points (N, 3) float32 m in the sensor's frame; intensity (N,) float32 dB relative to a perfect scatterer that fills
    the beam at 1 m; classes (N,) uint8 (`recipe.CLASSES`); instances (N,) uint16, 0 = none.
    """

    stamp_ns: int
    sensor: str
    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]


@dataclass(frozen=True)
class VehicleState:
    """State from compass, tilt and pressure sensors and altimeter: heading rad (from east, counter-clockwise), pitch
    rad (bow down positive), depth m below the mean water surface, altitude m above the bottom.

    In a rollout it leaves out the vehicle's sway, which the image shows, and the heading continues beyond -pi and pi;
    in labelled images it is that of the image."""

    heading: float
    pitch: float
    depth: float
    altitude: float
