"""Online calibration: mounts, lenses and clock of cameras as variables, with priors from the stated uncertainty.

Mounts are poses T_imu_cam, lenses are GTSAM's camera models, and the clock is the delay of the stamps, s. The errors
that a calibration states are given values less true ones: negated, they are tangents of the true values at the given
ones, so their covariance is that of a prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gtsam
import gtsam_unstable
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration, Uncertainty
from oysterbench_baselines.common.aiding.sensor import symbol

CLOCK = symbol("t")
LAST = frozenset(map(ord, "ckt"))
"""Key letters of these variables: they appear in nearly all factors and are eliminated last."""

MODELS = {
    "equidistant": (gtsam.Cal3Fisheye, gtsam_unstable.ProjectionFactorPPPCCal3Fisheye, "atCal3Fisheye", ("k3", "k4")),
    "plumb_bob": (gtsam.Cal3DS2, gtsam_unstable.ProjectionFactorPPPCCal3DS2, "atCal3DS2", ("p1", "p2")),
}
"""By distortion model: the lens class, the projection factor of a landmark, the `Values` method that reads a lens, and
the last two lens parameters as an `Uncertainty` names them."""

MOUNT = tuple(f"{kind}_{axis}_{unit}" for kind, unit in (("rotation", "rad"), ("position", "m")) for axis in "xyz")
LENS = ("focal_x_px", "focal_y_px", "", "principal_x_px", "principal_y_px", "k1", "k2")  # skew has no name
LEAST = np.array([1e-5] * 3 + [1e-5] * 3 + [1e-2, 1e-2, 1e-3, 1e-2, 1e-2] + [1e-5] * 4)
"""Smallest 1 sigma of mount and lens, in rad, m and px, for parameters that are stated as certain."""
SIZE = len(LEAST)


def mount_key(camera: int) -> int:
    """Key of a camera's T_imu_cam."""
    return symbol("c", camera)


def lens_key(camera: int) -> int:
    """Key of a camera's lens."""
    return symbol("k", camera)


@dataclass(frozen=True)
class Optics:
    """A camera as represented in a graph: T_imu_cam, and the parameters (9,) of its lens."""

    model: str
    mount: gtsam.Pose3
    lens: Array

    @classmethod
    def of(cls, camera: CameraCalibration, T_imu_base: Array) -> Optics:
        """Build from a calibration."""
        matrix, distortion = camera.matrix, np.zeros(4)
        # GTSAM's models have no fifth coefficient, k3: such a lens is used as it is, and not calibrated online.
        distortion[: len(camera.distortion)] = camera.distortion[:4]
        lens = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 1], matrix[0, 2], matrix[1, 2], *distortion])
        return cls(camera.distortion_model, gtsam.Pose3(T_imu_base @ camera.T_base_cam), lens)

    def insert(self, values: gtsam.Values, camera: int) -> None:
        """Insert mount and lens into values as the variables of a camera."""
        values.insert(mount_key(camera), self.mount)
        values.insert(lens_key(camera), MODELS[self.model][0](self.lens))

    def read(self, values: gtsam.Values, camera: int) -> Optics:
        """Return the optics with mount and lens as the variables of a camera have them."""
        kind, _, read, _ = MODELS[self.model]
        # GTSAM's own `vector` leaves the distortion out.
        found: Any = kind(np.zeros(9)).localCoordinates(getattr(values, read)(lens_key(camera)))
        return replace(self, mount=values.atPose3(mount_key(camera)), lens=np.asarray(found, dtype=float))

    def seen_by(self, camera: CameraCalibration) -> CameraCalibration:
        """Return a calibration with its lens replaced by this one."""
        fx, fy, skew, cx, cy = self.lens[:5]
        matrix = np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        return replace(camera, matrix=matrix, distortion=self.lens[5:].copy())

    def factor(
        self, pixel: Array, noise: gtsam.noiseModel.Base, pose: int, landmark: int, camera: int
    ) -> gtsam.NonlinearFactor:
        """Factor of a landmark seen at a pixel (2,). Behind the camera it has no gradient, and raises no error."""
        make: Any = MODELS[self.model][1]
        factor: gtsam.NonlinearFactor = make(
            pixel, noise, pose, mount_key(camera), landmark, lens_key(camera), False, False
        )
        return factor


@dataclass(frozen=True)
class CameraUncertainty:
    """Uncertainty of C cameras: covariance (15 C, 15 C) of the tangents of mount and lens of each; clock_sigma: s."""

    covariance: Array
    clock_sigma: float

    @classmethod
    def of(
        cls, stated: Uncertainty | None, names: list[str], cameras: list[CameraCalibration]
    ) -> CameraUncertainty | None:
        """Build from what a sequence states of the cameras of these names; None if it states nothing of them, or if
        GTSAM has no model for one of the lenses."""
        if stated is None or any(c.distortion_model not in MODELS or len(c.distortion) > 4 for c in cameras):
            return None
        rows = np.zeros((SIZE * len(cameras), len(stated.parameters)))
        for c, (name, camera) in enumerate(zip(names, cameras, strict=True)):
            for n, parameter in enumerate((*MOUNT, *LENS, *MODELS[camera.distortion_model][3])):
                if (full := f"{name}.{parameter}") in stated.parameters:
                    rows[SIZE * c + n, stated.parameters.index(full)] = 1.0
            # Position errors are stated in base_link; the tangent of a pose is in the axes of the camera.
            position = slice(SIZE * c + 3, SIZE * c + 6)
            rows[position] = camera.T_base_cam[:3, :3].T @ rows[position]
        clock = "cameras.time_offset_s"
        sigma = stated.sigma(clock) if clock in stated.parameters else 0.0
        if not rows.any() and sigma == 0.0:
            return None
        return cls(rows @ stated.covariance @ rows.T + np.diag(np.tile(LEAST, len(cameras)) ** 2), sigma)

    def prior(self, given: list[Optics], alike: float = 1.0) -> list[gtsam.NonlinearFactor]:
        """Prior factors of all mounts, lenses and the clock, about the given values.

        alike: number of views that together say no more about the calibration than one. Errors that views have in
        common (drifting patches, swaying plants, moving light) average out over poses and landmarks, each of which has
        its own, but not over a lens that all views share. The prior therefore weighs this many times what it would
        beside views with independent errors.
        """
        root = np.linalg.inv(np.linalg.cholesky(self.covariance / alike))
        keys = [key for c in range(len(given)) for key in (mount_key(c), lens_key(c))]
        slopes = [root[:, SIZE * c + a : SIZE * c + b] for c in range(len(given)) for a, b in ((0, 6), (6, SIZE))]

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            off = list[Array]()
            for c, optics in enumerate(given):
                now = optics.read(values, c)
                off += [optics.mount.localCoordinates(now.mount), now.lens - optics.lens]
            if jacobians is not None:  # for rotations this small all tangents coincide
                for n, slope in enumerate(slopes):
                    jacobians[n] = np.asfortranarray(slope)
            return np.asarray(root @ np.concatenate(off), dtype=float)

        unit = gtsam.noiseModel.Unit.Create(len(root))
        factors: list[gtsam.NonlinearFactor] = [gtsam.CustomFactor(unit, keys, error)]
        if self.clock_sigma:
            clock = gtsam.noiseModel.Isotropic.Sigma(1, self.clock_sigma / np.sqrt(alike))
            factors.append(gtsam.PriorFactorVector(CLOCK, np.zeros(1), clock))
        return factors
