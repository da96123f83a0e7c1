"""What an aiding sensor is to an estimator: its update of the filter, and its factors in the graph, side by side.

A factor written in Python costs a hundred times as much as a native one, so a sensor sums up what it measures between
two keyframes and adds one factor per keyframe. GTSAM is imported where a factor is made: a filter alone does not need
it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import Uncertainty
from oysterbench_baselines.common.filter import InvariantFilter
from oysterbench_baselines.common.inertial import Segment

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import Keyframe, State


ROTATION = tuple(f"rotation_{axis}_rad" for axis in "xyz")
"""Parameters of a mount, of which a calibration states sigmas."""


@dataclass(frozen=True)
class GateSettings:
    """When a measurement is refused."""

    chance: float = 1e-5  # with which a good measurement is refused
    patience: int = 5  # samples refused in a row, after which it is the filter that is taken to be wrong


@dataclass(frozen=True)
class Calibration:
    """Constants of a sensor, as a variable of the graph: GTSAM key, first value (N,) and 1 sigma (N,) about it."""

    key: int
    value: Array
    sigmas: Array


class AidingSensor:
    """A sensor besides camera and IMU. All methods but `update` may be left as they are.

    kind: as `Sequence.stream` names it. measures: types of its samples. suspect: part of the filter that is taken to be
    wrong when the sensor contradicts it for long. unit: the filter's states of the sensor, per unit of the variable in
    the graph. rows: of these states in the filter's error; None before the first sample. refused: number of samples.
    """

    kind: ClassVar[str]
    measures: ClassVar[tuple[type, ...]]
    suspect: ClassVar[slice] = slice(0, 0)
    unit: ClassVar[Array] = np.ones(1)

    def __init__(self, gate: GateSettings) -> None:
        self.gate = gate
        self.rows: slice | None = None
        self.refused = 0
        self._refused_in_a_row = 0

    def update(self, filter: InvariantFilter, sample: Any) -> bool:
        """Correct a filter that has been propagated to the sample's stamp; return whether any of it was believed.

        What the filter refuses takes no part in the graph either.
        """
        raise NotImplementedError

    def correct(self, filter: InvariantFilter, residual: Array, slope: Array, noise: Array) -> bool:
        """Correct by the rows as near to their prediction as their covariance allows; return whether there were any.

        residual (K,), slope (K, 15 + M) and noise (K, K). When all of a sensor is refused time and again, it is the
        filter that is wrong: its `suspect` states are then made as uncertain as they are off, and the sample counts.
        """
        spread = np.einsum("ki,ij,kj->k", slope, filter.covariance, slope) + noise.diagonal()
        near = residual**2 <= float(chdtri(1, self.gate.chance)) * spread
        self.refused += not near.all()
        self._refused_in_a_row = 0 if near.any() else self._refused_in_a_row + 1
        if self._refused_in_a_row > self.gate.patience:
            rows = self.suspect
            lever = max(float(np.sum(slope[:, rows] ** 2)), 1e-30) / len(residual)
            filter.covariance[rows, rows] += np.eye(3) * float(np.max(residual**2)) / lever
            near[:] = True
        if near.any():
            filter.update(residual[near], slope[near], noise[np.ix_(near, near)])
        return bool(near.any())

    def found(self, filter: InvariantFilter) -> dict[str, float]:
        """The filter's estimates of the sensor's constants, by names with units."""
        return {}

    def counts(self) -> dict[str, int]:
        """What a run has done with the sensor, as counts by name, for the record."""
        return {}

    def propagate(self, segment: Segment) -> None:
        """Take in the inertial measurements since the last sample of any sensor."""

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """Keep what was measured for a keyframe, `interval_s` after the last one."""

    def forget_intervals(self) -> None:
        """Forget what was kept of the time between keyframes: all of it is in factors now."""

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        """Start a graph, with `state` at a keyframe. filter: given where it has known the velocity."""

    def calibration(self) -> Calibration | None:
        """The sensor's constants; None where it takes no part in the graph."""
        return None

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        """Factors of a keyframe and the interval that leads to it; before: rough state one keyframe earlier."""
        return []

    def stretch_factors(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        """Factors that count only where a stretch is adjusted as a whole, at the start and in the final smoothing. ids
        (L,) and points (L, 3) in odom: of its landmarks."""
        return []


def stated_sigmas(uncertainty: Uncertainty | None, sensor: str, parameters: Sequence[str]) -> Array:
    """1 sigmas (N,) that a calibration states of a sensor's parameters; zeros where there is no uncertainty."""
    if uncertainty is None:
        return np.zeros(len(parameters))
    return np.array([uncertainty.sigma(f"{sensor}.{name}") for name in parameters])


def symbol(letter: str, index: int = 0) -> int:
    """Key of a variable, as `gtsam.symbol` makes it."""
    return (ord(letter) << 56) + index


READERS = {ord("x"): "atPose3", ord("b"): "atConstantBias", ord("l"): "atPoint3"}
"""How variables are read from `gtsam.Values`, by the letter of their key; others are vectors."""


def python_factor(
    keys: list[int],
    sigmas: float | Array,
    dimension: int,
    evaluate: Callable[..., tuple[Array, list[Array]]],
    **loss: float,
) -> gtsam.NonlinearFactor:
    """Factor in Python of an error (dimension,) with 1 sigmas: one for all, or (dimension,).

    evaluate(*variables) returns error (K,) and its derivatives (K, d) by each variable's tangent. loss: `huber` or
    `cauchy`, its threshold in sigmas; least squares without.
    """
    import gtsam

    readers = [READERS.get(key >> 56, "atVector") for key in keys]

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        residual, slopes = evaluate(*(getattr(values, read)(key) for read, key in zip(readers, keys, strict=True)))
        if jacobians is not None:
            for k, slope in enumerate(slopes):
                jacobians[k] = np.asfortranarray(slope)
        return residual

    models = gtsam.noiseModel
    noise: gtsam.noiseModel.Base = (
        models.Isotropic.Sigma(dimension, sigmas) if isinstance(sigmas, float) else models.Diagonal.Sigmas(sigmas)
    )
    for name, threshold in loss.items():
        noise = models.Robust.Create(getattr(models.mEstimator, name.title()).Create(threshold), noise)
    return gtsam.CustomFactor(noise, keys, error)
