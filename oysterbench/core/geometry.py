"""Rotations, rigid transforms, interpolation and alignment. Quaternions are x y z w; `T_a_b` takes b into a."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SMALL_ARC_RAD = 1e-7
"""On a shorter arc, the chord equals the arc to the last bit of a float64."""


BLOCK = 1 << 14
"""Poses processed at a time, so that their data stays in the processor's cache."""

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
"""Factor, element by element, that turns a unit quaternion into its inverse."""

GRAVITY = 9.80665
"""Standard gravity, m/s^2, along -z of `map`."""

RIGID_TOLERANCE = 1e-3
"""Tolerance on R^T R - I, for matrices written with few digits."""


def transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Homogeneous (4, 4) transform from a (3, 3) rotation matrix and a (3,) translation in m."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def is_rigid(matrix: ArrayLike) -> bool:
    """Whether a matrix is a rigid transform (4, 4): finite, with a proper rotation up to `RIGID_TOLERANCE`."""
    matrix = np.asarray(matrix, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return False
    rotation = matrix[:3, :3]
    return bool(
        np.allclose(rotation.T @ rotation, np.eye(3), rtol=0, atol=RIGID_TOLERANCE)
        and np.linalg.det(rotation) > 0
        and np.allclose(matrix[3], [0, 0, 0, 1])
    )


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
    matrices[:, :3, :3] = scipy.spatial.transform.Rotation.from_quat(np.asarray(quaternions).reshape(-1, 4)).as_matrix()
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1.0
    return matrices


def interpolate_poses(
    stamps_ns: NDArray[np.int64], positions: Array, quaternions: Array, at_ns: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Interpolate positions (linearly) and attitudes (slerp) at `at_ns` (M,), all inside [stamps_ns[0], stamps_ns[-1]].

    stamps_ns (N,) int64 increasing, positions (N, 3), quaternions (N, 4); returns (M, 3) and (M, 4). Raises ValueError
    for stamps outside.
    """
    at_ns = np.asarray(at_ns, dtype=np.int64)
    if len(at_ns) == 0:
        return np.empty((0, 3)), np.empty((0, 4))
    if at_ns.min() < stamps_ns[0] or at_ns.max() > stamps_ns[-1]:
        raise ValueError("interpolation outside the trajectory's time span")
    if len(stamps_ns) == 1:
        return np.repeat(positions, len(at_ns), axis=0), np.repeat(quaternions, len(at_ns), axis=0)
    low = np.clip(np.searchsorted(stamps_ns, at_ns, side="right") - 1, 0, len(stamps_ns) - 2)
    at_positions, at_quaternions = np.empty((len(at_ns), 3)), np.empty((len(at_ns), 4))
    for begin in range(0, len(at_ns), BLOCK):
        part = slice(begin, begin + BLOCK)
        i, j = low[part], low[part] + 1
        # Differences between stamps are exact and fit a float64; nanoseconds since an epoch do not.
        share = ((at_ns[part] - stamps_ns[i]) / (stamps_ns[j] - stamps_ns[i]))[:, None]
        at_positions[part] = (1.0 - share) * np.take(positions, i, axis=0) + share * np.take(positions, j, axis=0)
        at_quaternions[part] = _slerp(np.take(quaternions, i, axis=0), np.take(quaternions, j, axis=0), share)
    return at_positions, at_quaternions


def _slerp(begin: Array, end: Array, share: Array) -> Array:
    """Unit quaternions (N, 4) on the shorter arc from `begin` to `end`, at fractions (N, 1) of it (Shoemake 1985)."""
    end = np.where(np.einsum("ij,ij->i", begin, end)[:, None] < 0, -end, end)
    apart, together = begin - end, begin + end
    # The angle between the quaternions is half that between the attitudes; this is exact where an arc cosine is not.
    angle = 2.0 * np.arctan2(
        np.sqrt(np.einsum("ij,ij->i", apart, apart)), np.sqrt(np.einsum("ij,ij->i", together, together))
    )
    angle = angle[:, None]
    with np.errstate(invalid="ignore"):
        weight = np.where(angle > SMALL_ARC_RAD, np.sin(share * angle) / np.sin(angle), share)
        rest = np.where(angle > SMALL_ARC_RAD, np.sin((1.0 - share) * angle) / np.sin(angle), 1.0 - share)
    return rest * begin + weight * end


def left_product(quaternion: ArrayLike) -> Array:
    """(4, 4) matrix L with L @ q = quaternion * q, both x y z w: the rotation q followed by `quaternion`."""
    x, y, z, w = np.asarray(quaternion, dtype=float)
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])


def rotation_angle(quaternions_a: Array, quaternions_b: Array) -> Array:
    """Angle (N,) in rad, 0 to pi, of the rotations R_a^T R_b; unit quaternions (N, 4).

    Computed from the sine and cosine of the half angle: exact near 0 and near pi, where an arc cosine is not.
    """
    x, y, z, w = quaternion_product(quaternions_a * CONJUGATE, quaternions_b).T
    return np.asarray(2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w)))


def quaternion_product(a: Array, b: Array) -> Array:
    """Product a * b of quaternions (N, 4), x y z w: the rotation b followed by a."""
    product = np.empty((4, len(b))).T
    for begin in range(0, len(b), BLOCK):
        part = slice(begin, begin + BLOCK)
        ax, ay, az, aw = np.ascontiguousarray(a[part].T)
        bx, by, bz, bw = np.ascontiguousarray(b[part].T)
        product[part, 0] = aw * bx + ax * bw + ay * bz - az * by
        product[part, 1] = aw * by - ax * bz + ay * bw + az * bx
        product[part, 2] = aw * bz + ax * by - ay * bx + az * bw
        product[part, 3] = aw * bw - ax * bx - ay * by - az * bz
    return product


@dataclass(frozen=True)
class Similarity:
    """x_ref = scale * rotation @ x_est + translation; rotation (3, 3), translation (3,) in m."""

    rotation: Array
    translation: Array
    scale: float = 1.0

    def apply(self, points: Array) -> Array:
        """Transform (N, 3) points."""
        # einsum, because the matrix product of BLAS takes ten times as long for so narrow a matrix.
        return np.asarray(np.einsum("ij,kj->ik", points, self.scale * self.rotation) + self.translation)

    def rotate(self, quaternions: Array) -> Array:
        """Rotate attitudes (N, 4) from the left: body to estimate's world becomes body to reference's world."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.rotation)
        return np.asarray(np.einsum("ij,kj->ik", quaternions, left_product(turn.as_quat())))


IDENTITY = Similarity(np.eye(3), np.zeros(3))

MIN_SPREAD_M = 1e-3
"""A reference whose spread (rms distance of the points from their mean) is below this does not move."""

MIN_SPREAD_RATIO = 1e-6
"""Ratio of the spread across the main direction to that along it, below which points are collinear up to rounding.

Points on a line do not determine the rotation about it. Points that are nearly collinear do, as precisely as their
errors are small compared with their distance from the line: `evaluate.alignment` takes that into account.
"""

MIN_MOTION_RATIO = 1e-3
"""Ratio of the estimate's spread to the reference's, below which the estimate is stuck.

Umeyama's scale for a stuck estimate merely blows its noise up to the size of the reference (1e8 and more).
"""


def spread(points: Array) -> float:
    """Root mean square distance in m of points (N, K) from their mean."""
    centred = points - centroid(points)
    return float(np.sqrt(np.einsum("ij,ij->", centred, centred) / len(points)))


def centroid(points: Array) -> Array:
    """Mean (K,) of points (N, K), taken column by column, which numpy sums quickly and precisely to the last digits."""
    return np.array([points[:, k].mean() for k in range(points.shape[1])])


def covariance(points_a: Array, points_b: Array) -> Array:
    """Cross-covariance (K, K) of points (N, K): mean of a b^T, each set minus its own mean.

    Sums by einsum, unlike those by BLAS, are the same on any number of threads.
    """
    a, b = points_a - centroid(points_a), points_b - centroid(points_b)
    return np.asarray(np.einsum("ni,nj->ij", a, b) / len(a))


def align_origin(reference: Array, estimate: Array) -> Similarity:
    """Rigid transform that takes one estimated pose onto its reference, both (4, 4)."""
    change = np.asarray(reference) @ invert(estimate)
    return Similarity(change[:3, :3], change[:3, 3])


def align_umeyama(reference: Array, estimate: Array, with_scale: bool = False) -> Similarity:
    """Least-squares rigid or similarity alignment of matched points (N, 3) (Umeyama 1991, eqs. 40 to 43).

    Raises ValueError when the points do not determine a rotation: fewer than three, all in one place, or on one
    line (`MIN_SPREAD_RATIO`).
    """
    _check_matched(reference, estimate)
    _check_motion(spread(reference), spread(estimate))
    mean_reference, mean_estimate = centroid(reference), centroid(estimate)
    u, d, vt = np.linalg.svd(covariance(reference, estimate))
    if d[1] <= MIN_SPREAD_RATIO**2 * d[0]:
        raise ValueError("the points lie on one line: nothing determines the rotation about it")
    signs = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        signs[2] = -1.0
    rotation = u @ np.diag(signs) @ vt
    scale = 1.0
    if with_scale:
        scale = float(np.sum(d * signs)) / spread(estimate) ** 2
    return Similarity(rotation, mean_reference - scale * rotation @ mean_estimate, scale)


def align_yaw(reference: Array, estimate: Array) -> Similarity:
    """Least-squares rotation about z and translation of matched points (N, 3): the gravity-aligned alignment.

    Maximises sum(ref . Rz(theta) est) over theta (Zhang & Scaramuzza 2018, sec. IV-B). Raises ValueError when
    the points do not differ horizontally, so that yaw is not determined.
    """
    _check_matched(reference, estimate)
    mean_reference, mean_estimate = centroid(reference), centroid(estimate)
    level, flat = spread(reference[:, :2]), spread(estimate[:, :2])
    _check_motion(level, flat, " horizontally")
    if level < MIN_SPREAD_RATIO * spread(reference):
        raise ValueError(
            f"the reference moves straight up or down: it spreads {level:.3g} m horizontally against "
            f"{spread(reference):.3g} m in all, so that yaw is not determined"
        )
    products = covariance(reference[:, :2], estimate[:, :2])
    cosine = float(products[0, 0] + products[1, 1])
    sine = float(products[1, 0] - products[0, 1])
    if np.hypot(cosine, sine) <= np.finfo(float).eps * level * flat:
        raise ValueError("the points have no horizontal direction in common: yaw is not determined")
    rotation = scipy.spatial.transform.Rotation.from_euler("z", np.arctan2(sine, cosine)).as_matrix()
    return Similarity(rotation, mean_reference - rotation @ mean_estimate)


def align_scale(reference: Array, estimate: Array) -> Similarity:
    """Only the scale of the similarity alignment of matched points (N, 3): nothing is rotated or translated.

    The least-squares scale between the centred points after their best rotation (Umeyama 1991, eq. 42); collinear
    points have one too.
    """
    _check_matched(reference, estimate)
    _check_motion(spread(reference), spread(estimate))
    u, d, vt = np.linalg.svd(covariance(reference, estimate))
    d[2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return Similarity(np.eye(3), np.zeros(3), float(np.sum(d)) / spread(estimate) ** 2)


def _check_matched(reference: Array, estimate: Array) -> None:
    if reference.shape != estimate.shape or reference.ndim != 2 or reference.shape[1] != 3:
        raise ValueError(f"expected matched points (N, 3), got {reference.shape} and {estimate.shape}")
    if len(reference) < 3:
        raise ValueError(f"expected at least 3 matched points, got {len(reference)}")


def _check_motion(reference_m: float, estimate_m: float, how: str = "") -> None:
    """Refuse points without motion, given the two spreads in m."""
    if reference_m < MIN_SPREAD_M:
        raise ValueError(f"the reference does not move{how} (it spreads {reference_m:.3g} m): nothing to align to")
    if estimate_m < MIN_MOTION_RATIO * reference_m:
        raise ValueError(
            f"the estimate does not move{how}: it spreads {estimate_m:.3g} m where the reference spreads "
            f"{reference_m:.3g} m"
        )
