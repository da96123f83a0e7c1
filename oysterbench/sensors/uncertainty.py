"""Calibration as measured: how a calibration errs, what it says of that, and one draw of it for a whole rig.

What a method is given is the truth plus the error of a calibration, never the world: poses and intrinsics are moved in
calibration.json, in camera_info and on /tf_static; where the error lies in what a sensor says, in its stamps, its
velocities or the field that it feels, the readings have it, and the calibration says that they had none. So the vehicle
goes the same way and sees the same at any quality, and only what is known of it differs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams

UNCERTAINTY = "uncertainty"
"""Key of calibration.json."""

DIGITS = 12  # to which numbers are rounded: the same bytes on any processor


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Standard deviations of what a calibration finds, 1 sigma each.

    Ranges: of an ROV's camera calibrated in water with a target, the focal length is known to 0.2 to 0.5 %, the
    principal point to 2 to 5 px, the rotation to the inertial unit to 0.3 to 0.5 deg and its lever arm to 2 to 5 mm
    (Shortis 2015, Sensors 15(12), on underwater cameras; Rehder et al. 2016, ICRA, on cameras and inertial units; and
    practice). The two cameras of a pair are calibrated together, ten times better against each other.
    """

    focal_share: float  # of the focal length, both axes together
    aspect_share: float  # of the one axis' focal length against the other's
    principal_px: float  # per axis, of a picture 640 px wide; the pose found along with it makes up for it
    radial: float  # of k1; k2 errs the other way by RADIAL_RATIO of it, so that the picture's edge stays
    tangential: float  # of p1 and p2
    camera_deg: float  # per axis: all cameras against the inertial unit, beside what makes up for the principal point
    camera_m: float
    pair_deg: float  # per axis: one camera against the others
    pair_m: float
    time_offset_s: float  # all cameras, one trigger; 5 to 50 ms where nothing synchronises them
    time_jitter_s: float  # of a frame's stamp, 1 to 5 ms by USB and a busy kernel
    mount_deg: float  # per axis: any other sensor's mount
    mount_m: float
    dvl_scale: float  # of its velocity: 0.2 to 1 % (A50 data sheet: 1 %, and 0.1 % of the performance model)
    dvl_deg: float  # per axis, of its mount against the inertial unit: 0.5 to 1 deg unless surveyed
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
"""By an expert, in this water, with hardware that synchronises: the lower end of the ranges."""

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
"""Last season's, and clocks that nothing synchronises: the upper end."""

QUALITIES: Mapping[str, Quality] = {"good": GOOD, "poor": POOR}

RADIAL_RATIO = -1.5
REFERENCE_PX = 640.0  # width of the picture that principal_px is of


@dataclass(frozen=True)
class ErrorModel:
    """How the parameters of a sensor's calibration err: e = sizes w, over causes w that are independent and standard
    normal. sizes (P, K). Names with a dot, such as `cameras.rotation_x`, are shared by all that name them."""

    parameters: tuple[str, ...]
    causes: tuple[str, ...]
    sizes: Array

    @classmethod
    def of(cls, errors: Mapping[str, Mapping[str, float]]) -> ErrorModel:
        """From parameter -> cause -> size; a cause of the parameter's own name is one that nothing else shares."""
        causes = tuple(dict.fromkeys(cause for row in errors.values() for cause in row))
        sizes = np.array([[row.get(cause, 0.0) for cause in causes] for row in errors.values()])
        return cls(tuple(errors), causes, sizes.reshape(len(errors), len(causes)))


@dataclass(frozen=True)
class Uncertainty:
    """What a calibration says of its own errors: parameters, each `SENSOR.NAME_UNIT`, and the covariance (P, P) of what
    is given of them less what is true, in their units."""

    parameters: tuple[str, ...]
    covariance: Array

    def of(self, sensor: str) -> Uncertainty:
        """The part of one sensor, or of `cameras`, which is what all cameras share: parameters without its name."""
        at = [k for k, name in enumerate(self.parameters) if name.split(".")[0] == sensor]
        names = tuple(self.parameters[k].split(".", 1)[1] for k in at)
        return Uncertainty(names, self.covariance[np.ix_(at, at)])

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter. KeyError where it is none of these."""
        if parameter not in self.parameters:
            raise KeyError(f"{parameter!r}; parameters: {', '.join(self.parameters)}")
        k = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[k, k]))

    def as_entry(self) -> dict[str, Any]:
        """JSON values."""
        return {"parameters": list(self.parameters), "covariance": self.covariance.tolist()}

    @classmethod
    def from_entry(cls, entry: Mapping[str, Any]) -> Uncertainty:
        """From its entry in calibration.json. Raises LookupError, TypeError or ValueError where it is not of shape."""
        names = tuple(str(name) for name in entry["parameters"])
        return cls(names, np.array(entry["covariance"], dtype=float).reshape(len(names), len(names)))


def joined(models: Mapping[str, ErrorModel]) -> ErrorModel:
    """One model of all sensors, by their names: a parameter that several have under one full name is one parameter."""
    errors: dict[str, dict[str, float]] = {}
    for sensor, model in models.items():
        causes = [_full(sensor, cause) for cause in model.causes]
        for name, row in zip(model.parameters, model.sizes.tolist(), strict=True):
            errors[_full(sensor, name)] = {cause: size for cause, size in zip(causes, row, strict=True) if size}
    return ErrorModel.of(errors)


def _full(sensor: str, name: str) -> str:
    return name if "." in name else f"{sensor}.{name}"


def uncertainty_of(model: ErrorModel) -> Uncertainty:
    """The covariance that the errors of a model have."""
    sigmas = np.sqrt((model.sizes**2).sum(axis=1))
    shares = model.sizes / sigmas[:, None]
    # Correlations are rounded, so that those of nothing in common are zero on any processor, and of one sign.
    correlation = np.round(shares @ shares.T, DIGITS) + 0.0
    return Uncertainty(model.parameters, np.round(sigmas, DIGITS)[:, None] * correlation * np.round(sigmas, DIGITS))


def draw_errors(model: ErrorModel, streams: Streams) -> dict[str, float]:
    """One draw: parameter -> what is given of it less what is true. Each cause has a stream of its own name."""
    causes = np.array([streams.generator("cause", name).standard_normal() for name in model.causes])
    drawn = (model.sizes * causes).sum(axis=1) if len(causes) else np.zeros(len(model.parameters))
    return dict(zip(model.parameters, np.round(drawn, DIGITS).tolist(), strict=True))


@dataclass(frozen=True)
class RigCalibration:
    """A rig's calibration as calibration.json has it: as it is given to methods, and as it truly is; and the errors
    between the two, by parameter, given less true."""

    given: Mapping[str, Any]
    true: Mapping[str, Any]
    errors: Mapping[str, float]


def errors_of(errors: Mapping[str, float], *sensors: str) -> dict[str, float]:
    """Those of some sensors, without their names."""
    wanted = {full: full.split(".", 1)[1] for full in errors if full.split(".", 1)[0] in sensors}
    return {name: errors[full] for full, name in wanted.items()}


def independent(sizes: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Errors of parameters that share nothing."""
    return {name: {name: size} for name, size in sizes.items()}


def axes(prefix: str, unit: str, names: Iterable[str] = "xyz") -> list[str]:
    """Names of a vector's parameters, such as rotation_x_rad."""
    return [f"{prefix}_{axis}_{unit}" for axis in names]


def mount_errors(degrees: float, metres: float) -> dict[str, dict[str, float]]:
    """Errors of a sensor's pose, independent per axis: as `moved` takes them."""
    turns = dict.fromkeys(axes("rotation", "rad"), float(np.radians(degrees)))
    return independent(turns | dict.fromkeys(axes("position", "m"), metres))


def moved(T: Array, errors: Mapping[str, float]) -> Array:
    """Pose (4, 4) of a sensor in base_link as it is given: turned by the rotation vector `rotation_*_rad` in the
    sensor's own frame, and moved by `position_*_m` in base_link."""
    from scipy.spatial.transform import Rotation

    vector = [errors.get(name, 0.0) for name in axes("rotation", "rad")]
    shift = [errors.get(name, 0.0) for name in axes("position", "m")]
    given = np.array(T, dtype=float)
    given[:3, :3] = given[:3, :3] @ Rotation.from_rotvec(vector).as_matrix()
    given[:3, 3] += shift
    return np.round(given, DIGITS)
