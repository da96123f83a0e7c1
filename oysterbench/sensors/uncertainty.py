"""Imperfect calibration: how a calibration errs, the uncertainty that it states, and one draw for a whole rig.

Errors change what a method is given, never the world: poses and intrinsics are perturbed in calibration.json, in
camera_info and on /tf_static; where an error is in a sensor's output (its stamps, its velocities or the field that it
measures), the readings contain it, and the calibration states that there is none. So the vehicle follows the same path
and sees the same scene at any quality, and only what is known about it differs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams

UNCERTAINTY = "uncertainty"
"""Key of calibration.json that holds the uncertainty."""

DIGITS = 12  # to which numbers are rounded: the same bytes on any processor


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Standard deviations of the errors of a calibration, 1 sigma each.

    Ranges: for an ROV's camera calibrated in water with a target, the focal length is known to 0.2 to 0.5 %, the
    principal point to 2 to 5 px, the rotation relative to the IMU to 0.3 to 0.5 deg and its lever arm to 2 to 5 mm
    (Shortis 2015, Sensors 15(12), on underwater cameras; Rehder et al. 2016, ICRA, on cameras and IMUs; and practice).
    The two cameras of a pair are calibrated together, ten times better relative to each other.
    """

    focal_share: float  # of the focal length, both axes together
    aspect_share: float  # of the ratio of the focal lengths of the two axes
    principal_px: float  # per axis, in an image 640 px wide; the pose, estimated along with it, compensates for it
    radial: float  # of k1; k2 errs the other way by RADIAL_RATIO of it, so that the image's edge stays in place
    tangential: float  # of p1 and p2
    camera_deg: float  # per axis: all cameras relative to the IMU, besides what compensates for the principal point
    camera_m: float
    pair_deg: float  # per axis: one camera relative to the others
    pair_m: float
    time_offset_s: float  # all cameras, which share a trigger; 5 to 50 ms without synchronisation
    time_jitter_s: float  # of a frame's stamp: 1 to 5 ms over USB with a busy kernel
    mount_deg: float  # per axis: the mount of any other sensor
    mount_m: float
    dvl_scale: float  # of its velocity: 0.2 to 1 % (A50 data sheet: 1 %, and 0.1 % for the performance model)
    dvl_deg: float  # per axis, of its mount relative to the IMU: 0.5 to 1 deg unless surveyed
    hard_iron_ut: float  # per axis, after a swing of the compass (Gebre-Egziabher et al. 2006)
    soft_iron: float  # of each element


GOOD = Quality(
    focal_share=0.002,
    aspect_share=0.0003,
    principal_px=2.0,
    radial=0.004,
    tangential=0.0002,
    camera_deg=0.15,
    camera_m=0.002,
    pair_deg=0.015,
    pair_m=0.0002,
    time_offset_s=0.002,
    time_jitter_s=0.0005,
    mount_deg=0.5,
    mount_m=0.005,
    dvl_scale=0.002,
    dvl_deg=0.5,
    hard_iron_ut=0.3,
    soft_iron=0.005,
)
"""Calibration by an expert, in the same water, with hardware synchronisation: the lower end of the ranges."""

POOR = Quality(
    focal_share=0.005,
    aspect_share=0.001,
    principal_px=3.5,
    radial=0.01,
    tangential=0.0005,
    camera_deg=0.25,
    camera_m=0.005,
    pair_deg=0.05,
    pair_m=0.0005,
    time_offset_s=0.02,
    time_jitter_s=0.003,
    mount_deg=1.0,
    mount_m=0.01,
    dvl_scale=0.01,
    dvl_deg=1.0,
    hard_iron_ut=2.0,
    soft_iron=0.02,
)
"""Calibration of last season, with unsynchronised clocks: the upper end of the ranges."""

QUALITIES: Mapping[str, Quality] = {"good": GOOD, "poor": POOR}

RADIAL_RATIO = -1.5
REFERENCE_PX = 640.0  # width of the image that principal_px refers to


@dataclass(frozen=True)
class ErrorModel:
    """Errors of the parameters of a sensor's calibration: e = sizes w, with causes w that are independent and standard
    normal; sizes (P, K). Names with a dot, such as `cameras.rotation_x`, are shared by all sensors that use them."""

    parameters: tuple[str, ...]
    causes: tuple[str, ...]
    sizes: Array

    @classmethod
    def of(cls, errors: Mapping[str, Mapping[str, float]]) -> ErrorModel:
        """Build from parameter -> cause -> size; a cause with the parameter's own name is shared with no other."""
        causes = tuple(dict.fromkeys(cause for row in errors.values() for cause in row))
        sizes = np.array([[row.get(cause, 0.0) for cause in causes] for row in errors.values()])
        return cls(tuple(errors), causes, sizes.reshape(len(errors), len(causes)))


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty that a calibration states: parameters, each `SENSOR.NAME_UNIT`, and the covariance (P, P) of their
    given minus true values, in their units."""

    parameters: tuple[str, ...]
    covariance: Array

    def of(self, sensor: str) -> Uncertainty:
        """Part of one sensor, or of `cameras`, which is what all cameras share; parameters are without its name."""
        at = [k for k, name in enumerate(self.parameters) if name.split(".")[0] == sensor]
        names = tuple(self.parameters[k].split(".", 1)[1] for k in at)
        return Uncertainty(names, self.covariance[np.ix_(at, at)])

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter. Raises KeyError where it is none of these."""
        if parameter not in self.parameters:
            raise KeyError(f"{parameter!r}; parameters: {', '.join(self.parameters)}")
        k = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[k, k]))

    def as_entry(self) -> dict[str, Any]:
        """JSON values of its entry in calibration.json."""
        return {"parameters": list(self.parameters), "covariance": self.covariance.tolist()}

    @classmethod
    def from_entry(cls, entry: Mapping[str, Any]) -> Uncertainty:
        """Read from an entry in calibration.json. Raises LookupError, TypeError or ValueError where it is malformed."""
        names = tuple(str(name) for name in entry["parameters"])
        return cls(names, np.array(entry["covariance"], dtype=float).reshape(len(names), len(names)))


def joined(models: Mapping[str, ErrorModel]) -> ErrorModel:
    """Join the models of all sensors, given by name: a full name that several sensors use is a single parameter."""
    errors: dict[str, dict[str, float]] = {}
    for sensor, model in models.items():
        causes = [_full(sensor, cause) for cause in model.causes]
        for name, row in zip(model.parameters, model.sizes.tolist(), strict=True):
            errors[_full(sensor, name)] = {cause: size for cause, size in zip(causes, row, strict=True) if size}
    return ErrorModel.of(errors)


def _full(sensor: str, name: str) -> str:
    return name if "." in name else f"{sensor}.{name}"


def uncertainty_of(model: ErrorModel) -> Uncertainty:
    """Covariance of the errors of a model."""
    sigmas = np.sqrt((model.sizes**2).sum(axis=1))
    shares = model.sizes / sigmas[:, None]
    # Correlations are rounded, so that where nothing is shared they are zero on any processor, and of one sign.
    correlation = np.round(shares @ shares.T, DIGITS) + 0.0
    return Uncertainty(model.parameters, np.round(sigmas, DIGITS)[:, None] * correlation * np.round(sigmas, DIGITS))


def draw_errors(model: ErrorModel, streams: Streams) -> dict[str, float]:
    """Draw the errors: parameter -> given minus true value. Each cause has a random stream of its own name."""
    causes = np.array([streams.generator("cause", name).standard_normal() for name in model.causes])
    drawn = (model.sizes * causes).sum(axis=1) if len(causes) else np.zeros(len(model.parameters))
    return dict(zip(model.parameters, np.round(drawn, DIGITS).tolist(), strict=True))


@dataclass(frozen=True)
class RigCalibration:
    """A rig's calibration in the layout of calibration.json: as given to methods, and the true one; and the errors by
    parameter, given minus true."""

    given: Mapping[str, Any]
    true: Mapping[str, Any]
    errors: Mapping[str, float]


def errors_of(errors: Mapping[str, float], *sensors: str) -> dict[str, float]:
    """Errors of some sensors, by parameters without the sensor's name."""
    wanted = {full: full.split(".", 1)[1] for full in errors if full.split(".", 1)[0] in sensors}
    return {name: errors[full] for full, name in wanted.items()}


def independent(sizes: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Error sizes of parameters that share no cause."""
    return {name: {name: size} for name, size in sizes.items()}


def axes(prefix: str, unit: str, names: Iterable[str] = "xyz") -> list[str]:
    """Names of a vector's parameters, such as rotation_x_rad."""
    return [f"{prefix}_{axis}_{unit}" for axis in names]


def mount_errors(degrees: float, metres: float) -> dict[str, dict[str, float]]:
    """Error sizes of a sensor's pose, independent per axis, in the parameters of `moved`."""
    turns = dict.fromkeys(axes("rotation", "rad"), float(np.radians(degrees)))
    return independent(turns | dict.fromkeys(axes("position", "m"), metres))


def moved(T: Array, errors: Mapping[str, float]) -> Array:
    """Pose (4, 4) of a sensor in base_link with errors: rotated by the rotation vector `rotation_*_rad` in the sensor's
    own frame, and displaced by `position_*_m` in base_link."""
    from scipy.spatial.transform import Rotation

    vector = [errors.get(name, 0.0) for name in axes("rotation", "rad")]
    shift = [errors.get(name, 0.0) for name in axes("position", "m")]
    given = np.array(T, dtype=float)
    given[:3, :3] = given[:3, :3] @ Rotation.from_rotvec(vector).as_matrix()
    given[:3, 3] += shift
    return np.round(given, DIGITS)
