"""Absolute and relative errors of matched poses, and the metrics of the absolute ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from oysterbench.core.geometry import BLOCK, CONJUGATE, Array, quaternion_product
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.pairs import Index, between, pick, run_of
from oysterbench.evaluate.values import Measures

MIN_PATH_M = 1e-3
"""Errors are not given as a percentage of a path shorter than this, m."""
STILL = "the truth does not move: there is no path to take a percentage of"


@dataclass(frozen=True)
class PoseErrors:
    """Errors E in SE(3) of N poses or relative motions, split into the parts that metrics use.

    translation_m: (N,) length of the translation of E, m
    turn:          (N, 4) unit quaternion x y z w of a rotation conjugate to that of E, in the axes of the aligned
                   estimate's world frame: for poses, R_estimate R_truth^T
    """

    translation_m: Array
    turn: Array

    @cached_property
    def rotation_rad(self) -> Array:
        """Rotation angle (N,) of E, 0 to pi, accurate near both ends."""
        x, y, z, w = self.turn.T
        return np.asarray(2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w)))

    @cached_property
    def rotation_part(self) -> Array:
        """Frobenius norm (N,) of R - I: 2 sqrt(2) |sin(angle / 2)|. evo's rotation part."""
        x, y, z, _ = self.turn.T
        return np.asarray(np.sqrt(8.0 * (x * x + y * y + z * z)))

    @cached_property
    def full(self) -> Array:
        """Frobenius norm (N,) of E - I, mixing metres and radians. evo's full transformation."""
        return np.asarray(np.sqrt(self.translation_m**2 + self.rotation_part**2))

    @cached_property
    def yaw_rad(self) -> Array:
        """Angle (N,), 0 to pi, of the rotation about the vertical that follows a tilt to make `turn` (swing-twist)."""
        _, _, z, w = self.turn.T
        return np.asarray(2.0 * np.arctan2(np.abs(z), np.abs(w)))

    @cached_property
    def tilt_rad(self) -> Array:
        """Angle (N,), 0 to pi, between the true vertical and the estimated one."""
        x, y, z, w = self.turn.T
        return np.asarray(2.0 * np.arctan2(np.sqrt(x * x + y * y), np.sqrt(z * z + w * w)))


def absolute_errors(truth: Trajectory, estimate: Trajectory) -> PoseErrors:
    """E = Q^-1 P of matched poses (N,), truth Q and aligned estimate P (Sturm et al. 2012, eq. 4)."""
    difference = estimate.positions - truth.positions
    return PoseErrors(
        np.sqrt(np.einsum("ij,ij->i", difference, difference)),
        quaternion_product(estimate.quaternions, truth.quaternions * CONJUGATE),
    )


def measure_absolute(errors: PoseErrors, path_m: float, measures: Measures) -> None:
    """Measure the absolute errors of all matched poses (Sturm et al. 2012, eq. 5). path_m: length of the true path"""
    error_m, rotation_deg = errors.translation_m, np.rad2deg(errors.rotation_rad)
    measures["ate_rmse_m"] = rms(error_m)
    if path_m < MIN_PATH_M:
        measures.missing(STILL, "ate_percent")
    else:
        measures["ate_percent"] = 100.0 * rms(error_m) / path_m
    measures["ate_mean_m"] = float(np.mean(error_m))
    measures["ate_median_m"] = float(np.median(error_m))
    measures["ate_max_m"] = float(np.max(error_m))
    measures["ate_rotation_rmse_deg"] = rms(rotation_deg)
    measures["ate_rotation_median_deg"] = float(np.median(rotation_deg))
    measures["ate_rotation_max_deg"] = float(np.max(rotation_deg))
    measures["ate_yaw_rmse_deg"] = rms(np.rad2deg(errors.yaw_rad))
    measures["ate_tilt_rmse_deg"] = rms(np.rad2deg(errors.tilt_rad))
    measures["ate_rotation_part_rmse"] = rms(errors.rotation_part)
    measures["ate_full_rmse"] = rms(errors.full)


def relative_errors(truth: Trajectory, estimate: Trajectory, pairs: Index, absolute: PoseErrors) -> PoseErrors:
    """E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) of index pairs (M, 2) i, j into matched poses (Sturm et al. 2012, eq. 1).

    With H = P Q^-1 the rotations of the absolute errors (`PoseErrors.turn`), |trans E| = |H_i^-1 (p_j - p_i) -
    (q_j - q_i)|, and H_j H_i^-1 is the rotation of E seen from the world frame of the aligned
    estimate: no pair needs a matrix.
    """
    translation_m = np.empty(len(pairs))
    turn = np.empty((4, len(pairs))).T
    for begin in range(0, len(pairs), BLOCK):
        part = slice(begin, begin + BLOCK)
        i, j = run_of(pairs[part, 0]), run_of(pairs[part, 1])
        turn_i = pick(absolute.turn.T, i, axis=1).T * CONJUGATE
        moved = _rotate(turn_i, between(estimate.positions, i, j))
        moved -= between(truth.positions, i, j)
        translation_m[part] = np.sqrt(np.einsum("ij,ij->i", moved, moved))
        turn[part] = quaternion_product(pick(absolute.turn.T, j, axis=1).T, turn_i)
    return PoseErrors(translation_m, turn)


def _rotate(quaternions: Array, vectors: Array) -> Array:
    """Rotate vectors (N, 3) by unit quaternions (N, 4): v + 2 (w a + u x a), a = u x v."""
    ux, uy, uz, w = quaternions.T
    vx, vy, vz = vectors.T
    ax, ay, az = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    rotated = np.empty_like(vectors)
    rotated[:, 0] = vx + 2.0 * (w * ax + uy * az - uz * ay)
    rotated[:, 1] = vy + 2.0 * (w * ay + uz * ax - ux * az)
    rotated[:, 2] = vz + 2.0 * (w * az + ux * ay - uy * ax)
    return rotated


def rms(values: Array) -> float:
    """Root mean square; NaN for an empty sample."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
