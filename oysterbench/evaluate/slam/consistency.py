"""Consistency: whether an estimate's errors are as large as its covariances say.

Covariances grow from the start of an estimate, while an alignment fitted to the whole path distributes the errors at
the end over all of it: it adds errors to the first poses, which the estimate rightly calls exact, and hides those of
the last. NEES therefore has an alignment of its own: to the first matched pose, within the freedom that the evaluator's
alignment grants the method (position and yaw for posyaw; position and attitude for origin, se3 and sim3, the last with
its scale; none for none and scale). The error of the first pose itself then rotates and shifts all others; its
covariance says by how much, and is added to theirs, as if independent of them. For an estimate that starts from an
exact pose, as odometry does, it is zero; for one whose errors are equally large everywhere, it is as large as theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from oysterbench.core.geometry import BLOCK, Array, Similarity, align_origin
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.pose_errors import absolute_errors
from oysterbench.evaluate.slam.settings import Align

THREE_SIGMA = 0.9973002039367398
"""Probability within three standard deviations of a normal distribution, and within a 3-sigma ellipsoid."""
ROUNDING = 1e-9
"""Negative eigenvalue, relative to the largest, that a covariance without any may have by rounding."""
CONFIDENCE = 0.95
"""Probability that the mean NEES of a consistent estimate lies within `Nees.band`."""


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared e^T C^-1 e (Bar-Shalom, Li, Kirubarajan 2001, sec. 5.4.2).

    values: (N,), chi-square distributed with `freedom` degrees of freedom if the covariances match the errors
    """

    values: Array
    freedom: int

    @property
    def mean(self) -> float:
        """Mean over the stamps; `freedom` is expected. If it is greater, the estimate is overconfident."""
        return float(np.mean(self.values))

    @property
    def band(self) -> tuple[float, float]:
        """Interval that contains the mean with probability CONFIDENCE, if errors are independent between stamps."""
        n = len(self.values) * self.freedom
        low, high = _chi2_quantile(np.array([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]), n) / len(self.values)
        return float(low), float(high)

    @property
    def within_3sigma(self) -> float:
        """Share of stamps inside the ellipsoid that contains THREE_SIGMA of a consistent estimate's errors."""
        return float(np.mean(self.values <= _chi2_quantile(THREE_SIGMA, self.freedom)))


def _chi2_quantile(probability: float | Array, freedom: int) -> Any:
    """Chi-square quantile, as in scipy.stats, whose import would cost every command half a second."""
    return 2.0 * scipy.special.gammaincinv(freedom / 2.0, probability)


def nees(truth: Trajectory, estimate: Trajectory, align: Align, fit: Similarity, by_first: int = 1) -> dict[str, Nees]:
    """NEES of position, rotation and pose, from matched poses (N,) of the truth and of the unaligned estimate.

    align, fit: the evaluator's alignment, whose freedom and scale are adopted. The estimate's covariances (N, 6, 6) are
    in the axes of its world frame, and rotate and scale with it. If the first pose is used for alignment, it is not a
    sample, and may be exact: (N - 1,), or (N - by_first,) if it is exact. by_first: how many matched poses, from the
    first on, have the covariance of the same pose of the estimate, to which a faster truth is matched several times.
    Raises ValueError where another covariance is not positive definite, or one is not finite, or there is no sample.
    """
    covariances = estimate.covariances
    if covariances is None:
        raise ValueError("the estimate has no covariances")
    at_first = align not in ("none", "scale")
    begin = (by_first if _is_singular(covariances[0]) else 1) if at_first else 0
    _check(covariances, begin)
    if begin >= len(covariances):
        raise ValueError("no pose was matched but the first one, by which the estimate is aligned")
    change = _by_first(truth, estimate, align, fit.scale) if at_first else fit
    aligned = Trajectory(truth.stamps_ns, change.apply(estimate.positions), change.rotate(estimate.quaternions))
    turn = scipy.spatial.transform.Rotation.from_quat(absolute_errors(truth, aligned).turn).as_rotvec()
    # In the estimate's axes, with its covariances unchanged, NEES is the same number and costs less.
    error = np.column_stack([(aligned.positions - truth.positions) / change.scale, turn])
    error = np.einsum("nkj,ji->nki", error.reshape(-1, 2, 3), change.rotation).reshape(-1, 6)
    if at_first:
        covariances = covariances + _of_first(estimate, covariances[0], align)
        covariances, error = covariances[begin:], error[begin:]
    return {
        "position": Nees(_squared(covariances[:, :3, :3], error[:, :3]), 3),
        "rotation": Nees(_squared(covariances[:, 3:, 3:], error[:, 3:]), 3),
        "pose": Nees(_squared(covariances, error), 6),
    }


def _by_first(truth: Trajectory, estimate: Trajectory, align: Align, scale: float) -> Similarity:
    """Similarity that moves the estimate's first pose onto the truth's: position, and yaw or the whole attitude."""
    first = align_origin(truth.matrices[0], estimate.matrices[0]).rotation
    if align == "posyaw":
        # The rotation about z that is closest to it.
        angle = np.arctan2(first[1, 0] - first[0, 1], first[0, 0] + first[1, 1])
        first = scipy.spatial.transform.Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return Similarity(first, truth.positions[0] - scale * first @ estimate.positions[0], scale)


def _of_first(estimate: Trajectory, covariance: Array, align: Align) -> Array:
    """Covariances (N, 6, 6) that aligning by the first pose, whose covariance is (6, 6), adds to those of all poses.

    With dp the error of the first position, d_k the displacement from it and t the part of the first pose's rotation
    error that the alignment removes, position k is moved by -dp + d_k x t, and its attitude rotated by -t.
    """
    taken = np.diag([0.0, 0.0, 1.0]) if align == "posyaw" else np.eye(3)
    x, y, z = (estimate.positions - estimate.positions[0]).T
    change = np.zeros((len(x), 6, 6))
    change[:, :3, :3] = -np.eye(3)
    lever = np.zeros((len(x), 3, 3))
    lever[:, 0, 1], lever[:, 0, 2], lever[:, 1, 2] = -z, y, -x
    lever -= np.swapaxes(lever, 1, 2)
    change[:, :3, 3:] = lever @ taken
    change[:, 3:, 3:] = -taken
    return np.asarray(change @ covariance @ np.swapaxes(change, 1, 2))


def _is_singular(covariance: Array) -> bool:
    """Whether a finite covariance (6, 6) is not positive definite, as that of an exact pose is not."""
    return bool(np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] <= 0)


def _check(covariances: Array, begin: int) -> None:
    """Refuse covariances (N, 6, 6) that are not finite, or not positive definite. Raises ValueError naming the first of
    these.

    begin: the first sample; before it, covariances need only have no negative eigenvalue
    """
    finite = np.isfinite(covariances).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(f"the covariance of matched pose {int(np.argmin(finite)) + 1} is not finite")
    if begin:
        values = np.linalg.eigvalsh(covariances[0])
        if values[0] < -ROUNDING * np.abs(values).max():
            raise ValueError("the covariance of matched pose 1 has a negative eigenvalue")
    for start in range(begin, len(covariances), BLOCK):
        part = covariances[start : start + BLOCK]
        try:
            np.linalg.cholesky(part)
        except np.linalg.LinAlgError:
            wrong = start + int(np.argmin(np.linalg.eigvalsh(part)[:, 0] > 0))
            raise ValueError(f"the covariance of matched pose {wrong + 1} is not positive definite") from None


def _squared(covariances: Array, errors: Array) -> Array:
    """e^T C^-1 e (N,) of covariances (N, K, K) and errors (N, K), as the squared length of L^-1 e with C = L L^T."""
    squared = np.empty(len(errors))
    for begin in range(0, len(errors), BLOCK):
        part = slice(begin, begin + BLOCK)
        lower = np.linalg.cholesky(covariances[part])
        white = np.empty_like(errors[part])
        for row in range(errors.shape[1]):
            rest = np.einsum("nk,nk->n", lower[:, row, :row], white[:, :row])
            white[:, row] = (errors[part, row] - rest) / lower[:, row, row]
        squared[part] = np.einsum("nk,nk->n", white, white)
    return squared
