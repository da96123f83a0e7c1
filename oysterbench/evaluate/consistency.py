"""Whether an estimate errs as much as its covariances say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from oysterbench.geometry import BLOCK, Array, Similarity

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
        low, high = chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], n) / len(self.values)
        return float(low), float(high)

    @property
    def within_3sigma(self) -> float:
        """Share of stamps inside the ellipsoid that holds THREE_SIGMA of a consistent estimate's errors."""
        return float(np.mean(self.values <= chi2.ppf(THREE_SIGMA, self.freedom)))


def nees(difference_m: Array, turn: Array, covariances: Array, alignment: Similarity) -> dict[str, Nees]:
    """NEES of position, rotation and pose, from errors (N, 3) m and (N, 4) about the truth's world axes.

    covariances (N, 6, 6) are about the axes of the estimate's world and turn and scale with the alignment. Raises
    ValueError where one is not positive definite.
    """
    error = np.column_stack([difference_m, Rotation.from_quat(turn).as_rotvec()])
    change = np.zeros((6, 6))
    change[:3, :3] = alignment.scale * alignment.rotation
    change[3:, 3:] = alignment.rotation
    # The error in the estimate's axes, with its covariance as it was given, is the same number and costs less.
    error = error @ np.linalg.inv(change).T
    return {
        "position": Nees(_squared(covariances[:, :3, :3], error[:, :3]), 3),
        "rotation": Nees(_squared(covariances[:, 3:, 3:], error[:, 3:]), 3),
        "pose": Nees(_squared(covariances, error), 6),
    }


def _squared(covariances: Array, errors: Array) -> Array:
    """e^T C^-1 e of (N, K, K) and (N, K), as the squared length of L^-1 e with C = L L^T."""
    squared = np.empty(len(errors))
    for begin in range(0, len(errors), BLOCK):
        part = slice(begin, begin + BLOCK)
        try:
            lower = np.linalg.cholesky(covariances[part])
        except np.linalg.LinAlgError:
            wrong = begin + int(np.argmin(np.linalg.eigvalsh(covariances[part])[:, 0] > 0))
            raise ValueError(f"the covariance of matched pose {wrong + 1} is not positive definite") from None
        white = np.empty_like(errors[part])
        for row in range(errors.shape[1]):
            rest = np.einsum("nk,nk->n", lower[:, row, :row], white[:, :row])
            white[:, row] = (errors[part, row] - rest) / lower[:, row, row]
        squared[part] = np.einsum("nk,nk->n", white, white)
    return squared
