"""What is known of each sensor of a rig, as it travels in calibration.json. `T_base_x` takes points of x into
base_link."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array


@dataclass(frozen=True)
class CameraCalibration:
    """A camera: matrix (3, 3) in px, distortion, pose of its optical frame.

    distortion_model and distortion as in sensor_msgs/CameraInfo: plumb_bob (Brown-Conrady k1, k2, p1, p2[, k3]) or
    equidistant (Kannala-Brandt k1 to k4). Behind a flat port both are those in air: port_m is the distance from the
    pupil to the port, port_index the water's refractive index against air; None without one.
    """

    width: int
    height: int
    rate_hz: float
    matrix: Array
    distortion: Array
    T_base_cam: Array
    distortion_model: str = "plumb_bob"
    port_m: float | None = None
    port_index: float = 1.0


@dataclass(frozen=True)
class ImuCalibration:
    """Continuous noise densities, bias random walks, 1-sigma turn-on biases, and biases that wander as Gauss-Markov
    processes of a stationary 1 sigma and a correlation time (units as in `recipe.ImuRecipe`); pose."""

    rate_hz: float
    gyro_noise_density: float
    gyro_random_walk: float
    gyro_turn_on: float
    accel_noise_density: float
    accel_random_walk: float
    accel_turn_on: float
    gravity: float  # m/s^2
    T_base_imu: Array
    gyro_bias_instability: float = 0.0
    gyro_bias_tau_s: float = 100.0
    accel_bias_instability: float = 0.0
    accel_bias_tau_s: float = 100.0


@dataclass(frozen=True)
class SonarCalibration:
    """An imaging sonar: azimuths (beams,) rad, left of x positive; ranges (bins,) m; height of its fan, rad; frequency,
    Hz; amplitude of a pixel's step; pose."""

    beams: int
    bins: int
    azimuths_rad: Array
    ranges_m: Array
    vfov_rad: float
    frequency_hz: float
    amplitude_step: float
    T_base_sensor: Array


@dataclass(frozen=True)
class ScannerCalibration:
    """A scanning sonar: ranges (bins,) m; width of its beam, rad; amplitude of a number's step; pose at angle 0."""

    ranges_m: Array
    beam_rad: float
    amplitude_step: float
    T_base_sensor: Array


@dataclass(frozen=True)
class AltimeterCalibration:
    """An altimeter: width of its cone, rad; least and greatest range, m; pose, x along its axis."""

    beam_rad: float
    min_range_m: float
    max_range_m: float
    T_base_sensor: Array


@dataclass(frozen=True)
class DvlCalibration:
    """A DVL: pose; directions of its beams (4, 3), unit vectors in its frame; greatest range, m."""

    T_base_sensor: Array
    beam_directions: Array
    max_range_m: float


@dataclass(frozen=True)
class PressureCalibration:
    """A pressure sensor: pose; density of the water, kg/m^3, and pressure of the air over it, Pa."""

    T_base_sensor: Array
    density: float
    atmosphere: float


@dataclass(frozen=True)
class MagnetometerCalibration:
    """A magnetometer: pose."""

    T_base_sensor: Array


@dataclass(frozen=True)
class RigCalibration:
    """Every sensor of a rig; None or empty where it has none of the kind."""

    imu: ImuCalibration
    cameras: Mapping[str, CameraCalibration]
    sonars: Mapping[str, SonarCalibration] = field(default_factory=dict)
    scanners: Mapping[str, ScannerCalibration] = field(default_factory=dict)
    altimeters: Mapping[str, AltimeterCalibration] = field(default_factory=dict)
    dvl: DvlCalibration | None = None
    pressure: PressureCalibration | None = None
    magnetometer: MagnetometerCalibration | None = None


def rig_calibration(document: Mapping[str, Any]) -> RigCalibration:
    """From calibration.json. Raises LookupError, TypeError or ValueError where the document is not of its shape."""
    kinds = {"sonars": SonarCalibration, "scanners": ScannerCalibration, "altimeters": AltimeterCalibration}
    single = {"dvl": DvlCalibration, "pressure": PressureCalibration, "magnetometer": MagnetometerCalibration}
    values: dict[str, Any] = {
        key: {name: _calibration(kind, entry) for name, entry in document.get(key, {}).items()}
        for key, kind in kinds.items()
    }
    values |= {key: _calibration(kind, document[key]) for key, kind in single.items() if document.get(key)}
    return RigCalibration(
        imu=inertial_calibration(document["imu"]),
        cameras={name: camera_calibration(entry) for name, entry in document["cameras"].items()},
        **values,
    )


def inertial_calibration(entry: Mapping[str, Any]) -> ImuCalibration:
    """From an entry of calibration.json."""
    return _calibration(ImuCalibration, entry)


def camera_calibration(entry: Mapping[str, Any]) -> CameraCalibration:
    """From an entry of calibration.json."""
    port = entry.get("port")
    values = dict(entry) if port is None else {**entry, "port_m": port["distance_m"], "port_index": port["index"]}
    return _calibration(CameraCalibration, values)


def _calibration(kind: Any, entry: Mapping[str, Any]) -> Any:
    """A calibration from the keys of its entry; other keys are for other readers."""
    values: dict[str, Any] = {}
    for name, annotation in kind.__annotations__.items():
        if name not in entry and hasattr(kind, name):
            continue
        values[name] = _CONVERSIONS[annotation](entry[name])
    return kind(**values)


_CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "Array": lambda value: np.array(value, dtype=float),
    "int": int,
    "float": float,
    "float | None": float,
    "str": str,
}
