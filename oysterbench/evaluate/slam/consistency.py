"""Whether an estimate errs as much as its covariances say.

Covariances grow from where an estimate starts, while an alignment that is fitted to the whole path spreads what the end
errs over all of it: it makes the first poses err, which the estimate rightly calls exact, and hides what the last ones
do. So NEES has an alignment of its own: by the first matched pose, in the freedom that the evaluator's alignment grants
the method (position and yaw for posyaw; position and attitude for origin, se3 and sim3, this one with its scale;
nothing for none and scale). What the first pose itself errs then turns and shifts all others; its covariance says how
much, and is added to theirs, as independent of them. Of an estimate that starts from an exact pose, as odometry does,
it is nothing; of one whose errors are as large everywhere, it is as large as theirs.
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
"""Probability of three standard deviations of a normal distribution, and of the ellipsoid that is meant by them."""
CONFIDENCE = 0.95
"""Of the band in which the mean NEES of a consistent estimate lies."""


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared e^T C^-1 e (Bar-Shalom, Li, Kirubarajan 2001, sec. 5.4.2).

    values: (N,), chi-square with `freedom` degrees where covariances and errors agree
    """

    values: Array
    freedom: int

    @property
    def mean(self) -> float:
        """Over its stamps; `freedom` is expected. Above it the estimate is overconfident."""
        return float(np.mean(self.values))

    @property
    def band(self) -> tuple[float, float]:
        """Where the mean lies with CONFIDENCE, if errors at different stamps are independent."""
        n = len(self.values) * self.freedom
        low, high = _chi2_quantile(np.array([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]), n) / len(self.values)
        return float(low), float(high)

    @property
    def within_3sigma(self) -> float:
        """Share of stamps inside the ellipsoid that holds THREE_SIGMA of a consistent estimate's errors."""
        return float(np.mean(self.values <= _chi2_quantile(THREE_SIGMA, self.freedom)))


def _chi2_quantile(probability: float | Array, freedom: int) -> Any:
    """As scipy.stats has it, which takes every command half a second to import."""
    return 2.0 * scipy.special.gammaincinv(freedom / 2.0, probability)


def nees(truth: Trajectory, estimate: Trajectory, align: Align, fit: Similarity) -> dict[str, Nees]:
    """NEES of position, rotation and pose, of matched poses (N,) of the truth and of the estimate as it was given.

    align, fit: the evaluator's alignment, whose freedom and scale are taken over. The estimate's covariances (N, 6, 6)
    are about the axes of its world, and turn and scale with it. Where the first pose aligns, it is no sample: (N - 1,).
    Raises ValueError where a covariance is not positive definite.
    """
    covariances = estimate.covariances
    if covariances is None:
        raise ValueError("the estimate has no covariances")
    _check(covariances)
    by_first = align not in ("none", "scale")
    change = _by_first(truth, estimate, align, fit.scale) if by_first else fit
    aligned = Trajectory(truth.stamps_ns, change.apply(estimate.positions), change.rotate(estimate.quaternions))
    turn = scipy.spatial.transform.Rotation.from_quat(absolute_errors(truth, aligned).turn).as_rotvec()
    # The error in the estimate's axes, with its covariance as it was given, is the same number and costs less.
    error = np.column_stack([(aligned.positions - truth.positions) / change.scale, turn])
    error = np.einsum("nkj,ji->nki", error.reshape(-1, 2, 3), change.rotation).reshape(-1, 6)
    if by_first:
        covariances = covariances + _of_first(estimate, covariances[0], align)
        covariances, error = covariances[1:], error[1:]
    return {
        "position": Nees(_squared(covariances[:, :3, :3], error[:, :3]), 3),
        "rotation": Nees(_squared(covariances[:, 3:, 3:], error[:, 3:]), 3),
        "pose": Nees(_squared(covariances, error), 6),
    }


def _by_first(truth: Trajectory, estimate: Trajectory, align: Align, scale: float) -> Similarity:
    """What takes the estimate's first pose onto the truth's: its position, and its yaw or all of its attitude."""
    first = align_origin(truth.matrices[0], estimate.matrices[0]).rotation
    if align == "posyaw":
        # The turn about z that is nearest to it.
        angle = np.arctan2(first[1, 0] - first[0, 1], first[0, 0] + first[1, 1])
        first = scipy.spatial.transform.Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return Similarity(first, truth.positions[0] - scale * first @ estimate.positions[0], scale)


def _of_first(estimate: Trajectory, covariance: Array, align: Align) -> Array:
    """(N, 6, 6) what the error of the first pose, of a covariance (6, 6), does to all poses when it is taken out.

    With d_k the way from the first position and t the part of the first pose's turn that is taken out, position k is
    moved by -dp + d_k x t, and its attitude turned by -t.
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


def _check(covariances: Array) -> None:
    """Raises ValueError, which names the first of covariances (N, 6, 6) that is not positive definite."""
    for begin in range(0, len(covariances), BLOCK):
        part = covariances[begin : begin + BLOCK]
        try:
            np.linalg.cholesky(part)
        except np.linalg.LinAlgError:
            wrong = begin + int(np.argmin(np.linalg.eigvalsh(part)[:, 0] > 0))
            raise ValueError(f"the covariance of matched pose {wrong + 1} is not positive definite") from None


def _squared(covariances: Array, errors: Array) -> Array:
    """e^T C^-1 e of (N, K, K) and (N, K), as the squared length of L^-1 e with C = L L^T."""
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
