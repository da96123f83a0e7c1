"""Rotations, rigid transforms, interpolation and alignment. Quaternions are x y z w; `T_a_b` takes b into a."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Homogeneous (4, 4) transform from a (3, 3) rotation matrix and a (3,) translation in m."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def invert(transform: ArrayLike) -> Array:
    """Inverse of rigid transforms, shape (..., 4, 4)."""
    matrix = np.asarray(transform, dtype=float)
    rotation_t = np.swapaxes(matrix[..., :3, :3], -1, -2)
    inverse = np.zeros_like(matrix)
    inverse[..., :3, :3] = rotation_t
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation_t, matrix[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def poses_to_matrices(positions: ArrayLike, quaternions: ArrayLike) -> Array:
    """(N, 4, 4) transforms from (N, 3) positions in m and (N, 4) unit quaternions."""
    positions = np.asarray(positions, dtype=float).reshape(-1, 3)
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = Rotation.from_quat(np.asarray(quaternions).reshape(-1, 4)).as_matrix()
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1.0
    return matrices


def interpolate_poses(
    stamps_ns: NDArray[np.int64], positions: Array, quaternions: Array, at_ns: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Linear positions and slerped attitudes at `at_ns` (M,), all inside [stamps_ns[0], stamps_ns[-1]].

    stamps_ns (N,) int64 increasing, positions (N, 3), quaternions (N, 4); returns (M, 3) and (M, 4).
    """
    at_ns = np.asarray(at_ns, dtype=np.int64)
    if len(at_ns) == 0:
        return np.empty((0, 3)), np.empty((0, 4))
    if at_ns.min() < stamps_ns[0] or at_ns.max() > stamps_ns[-1]:
        raise ValueError("interpolation outside the trajectory's time span")
    if len(stamps_ns) == 1:
        return np.repeat(positions, len(at_ns), axis=0), np.repeat(quaternions, len(at_ns), axis=0)
    # Seconds from the first stamp: nanoseconds of an epoch do not fit a float64, differences do.
    known = (stamps_ns - stamps_ns[0]) * 1e-9
    wanted = (at_ns - stamps_ns[0]) * 1e-9
    at_positions = np.column_stack([np.interp(wanted, known, positions[:, k]) for k in range(3)])
    at_rotations = Slerp(known, Rotation.from_quat(quaternions))(np.minimum(wanted, known[-1]))
    return at_positions, at_rotations.as_quat()


def left_product(quaternion: ArrayLike) -> Array:
    """(4, 4) matrix L with L @ q = quaternion * q, both x y z w: the rotation q followed by `quaternion`."""
    x, y, z, w = np.asarray(quaternion, dtype=float)
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])


def rotation_angle(quaternions_a: Array, quaternions_b: Array) -> Array:
    """Angle (N,) in rad, 0 to pi, of the rotations R_a^T R_b; unit quaternions (N, 4).

    From sine and cosine of the half angle, exact near 0 and near pi, where an arc cosine is not.
    """
    va, wa, vb, wb = quaternions_a[:, :3], quaternions_a[:, 3:], quaternions_b[:, :3], quaternions_b[:, 3:]
    sine = np.linalg.norm(wa * vb - wb * va - np.cross(va, vb), axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", quaternions_a, quaternions_b))
    return np.asarray(2.0 * np.arctan2(sine, cosine))


def quaternion_product(a: Array, b: Array) -> Array:
    """a * b of quaternions (N, 4) x y z w: the rotation b followed by a."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    product = np.empty_like(b)
    product[:, 0] = aw * bx + ax * bw + ay * bz - az * by
    product[:, 1] = aw * by - ax * bz + ay * bw + az * bx
    product[:, 2] = aw * bz + ax * by - ay * bx + az * bw
    product[:, 3] = aw * bw - ax * bx - ay * by - az * bz
    return product


@dataclass(frozen=True)
class Similarity:
    """x_ref = scale * rotation @ x_est + translation; rotation (3, 3), translation (3,) in m."""

    rotation: Array
    translation: Array
    scale: float = 1.0

    def apply(self, points: Array) -> Array:
        """Transform (N, 3) points."""
        return self.scale * points @ self.rotation.T + self.translation

    def rotate(self, quaternions: Array) -> Array:
        """Attitudes (N, 4) turned from the left: body to the estimate's world becomes body to the reference's."""
        return quaternions @ left_product(Rotation.from_matrix(self.rotation).as_quat()).T


IDENTITY = Similarity(np.eye(3), np.zeros(3))

MIN_SPREAD_M = 1e-3
"""A reference whose points lie closer together than this (rms distance from their mean) does not move."""

MIN_SPREAD_RATIO = 1e-6
"""Spread across the main direction over spread along it, below which points are on one line but for rounding.

A line has no rotation about itself. Points that are nearly on one have, as exactly as their errors are small against
their distance from it: `evaluate.alignment` weighs that.
"""

MIN_MOTION_RATIO = 1e-3
"""Spread of the estimate over that of the reference, below which the estimate is stuck.

Umeyama's scale of a stuck estimate is its noise blown up to the reference (1e8 and more).
"""


def spread(points: Array) -> float:
    """Root mean square distance in m of points (N, K) from their mean."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def align_origin(reference: Array, estimate: Array) -> Similarity:
    """The rigid transform that takes one estimated pose onto its reference, both (4, 4)."""
    change = np.asarray(reference) @ invert(estimate)
    return Similarity(change[:3, :3], change[:3, 3])


def align_umeyama(reference: Array, estimate: Array, with_scale: bool = False) -> Similarity:
    """Least-squares rigid or similarity alignment of matched points (N, 3) (Umeyama 1991, eqs. 40 to 43).

    Raises ValueError when the points do not determine a rotation: fewer than three, all in one place, or on one
    line (`MIN_SPREAD_RATIO`).
    """
    _check_matched(reference, estimate)
    _check_motion(spread(reference), spread(estimate))
    mean_reference, mean_estimate = reference.mean(axis=0), estimate.mean(axis=0)
    centred_reference, centred_estimate = reference - mean_reference, estimate - mean_estimate
    covariance = centred_reference.T @ centred_estimate / len(reference)
    u, d, vt = np.linalg.svd(covariance)
    if d[1] <= MIN_SPREAD_RATIO**2 * d[0]:
        raise ValueError("the points lie on one line: nothing determines the rotation about it")
    signs = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        signs[2] = -1.0
    rotation = u @ np.diag(signs) @ vt
    scale = 1.0
    if with_scale:
        scale = float(np.sum(d * signs) / np.mean(np.sum(centred_estimate**2, axis=1)))
    return Similarity(rotation, mean_reference - scale * rotation @ mean_estimate, scale)


def align_yaw(reference: Array, estimate: Array) -> Similarity:
    """Least-squares rotation about z and translation of matched points (N, 3): the gravity-aligned alignment.

    Maximises sum(ref . Rz(theta) est) over theta (Zhang & Scaramuzza 2018, sec. IV-B). Raises ValueError when
    the points do not differ horizontally, so that yaw is not determined.
    """
    _check_matched(reference, estimate)
    mean_reference, mean_estimate = reference.mean(axis=0), estimate.mean(axis=0)
    p, q = (reference - mean_reference)[:, :2], (estimate - mean_estimate)[:, :2]
    _check_motion(spread(p), spread(q), "horizontally ")
    if spread(p) < MIN_SPREAD_RATIO * spread(reference):
        raise ValueError(
            f"the reference moves straight up or down: it spreads {spread(p):.3g} m horizontally against "
            f"{spread(reference):.3g} m in all, so that yaw is not determined"
        )
    cosine = float(np.vdot(p, q))
    sine = float(np.sum(p[:, 1] * q[:, 0] - p[:, 0] * q[:, 1]))
    if np.hypot(cosine, sine) <= np.finfo(float).eps * len(p) * spread(p) * spread(q):
        raise ValueError("the points have no horizontal direction in common: yaw is not determined")
    rotation = Rotation.from_euler("z", np.arctan2(sine, cosine)).as_matrix()
    return Similarity(rotation, mean_reference - rotation @ mean_estimate)


def align_scale(reference: Array, estimate: Array) -> Similarity:
    """The scale of the similarity alignment of matched points (N, 3), alone: nothing is turned or moved.

    The least-squares scale between the centred points after their best rotation (Umeyama 1991, eq. 42); points on
    one line have it too.
    """
    _check_matched(reference, estimate)
    _check_motion(spread(reference), spread(estimate))
    centred_estimate = estimate - estimate.mean(axis=0)
    covariance = (reference - reference.mean(axis=0)).T @ centred_estimate / len(reference)
    u, d, vt = np.linalg.svd(covariance)
    d[2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return Similarity(np.eye(3), np.zeros(3), float(np.sum(d) / np.mean(np.sum(centred_estimate**2, axis=1))))


def _check_matched(reference: Array, estimate: Array) -> None:
    if reference.shape != estimate.shape or reference.ndim != 2 or reference.shape[1] != 3:
        raise ValueError(f"expected matched points (N, 3), got {reference.shape} and {estimate.shape}")
    if len(reference) < 3:
        raise ValueError(f"expected at least 3 matched points, got {len(reference)}")


def _check_motion(reference_m: float, estimate_m: float, how: str = "") -> None:
    """Refuse points without motion, given the two spreads in m."""
    if reference_m < MIN_SPREAD_M:
        raise ValueError(f"the reference does not move {how}(it spreads {reference_m:.3g} m): nothing to align to")
    if estimate_m < MIN_MOTION_RATIO * reference_m:
        raise ValueError(
            f"the estimate does not move {how}: it spreads {estimate_m:.3g} m where the reference spreads "
            f"{reference_m:.3g} m"
        )
