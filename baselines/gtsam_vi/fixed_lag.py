"""Fixed-lag smoothing that keeps what has been marginalised consistent with what remains.

Variables that leave the window remain as a linear factor on their neighbours. If the other factors of a neighbour were
relinearised elsewhere, the two would disagree about the unobservable directions, and heading would seem to be observed
by measurements that cannot tell it. So a variable that such a factor touches keeps its linearisation point for all
factors (first-estimates Jacobians: Huang, Mourikis & Roumeliotis 2008), and only its error about that point is still
estimated. GTSAM's `BatchFixedLagSmoother` intends to do so, but up to 4.3.0 never records these points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

import gtsam
import numpy as np

from oysterbench.core.geometry import Array

T = TypeVar("T")

LANDMARK = ord("l")
"""Key letter of landmarks, which are eliminated first: each is seen by a few keyframes only."""
HALVINGS = 4
"""Number of times that a step which does not reduce the error is halved before it is given up."""
DAMPING = 3e-3
"""1 / sigma, in the units of each variable, of the prior that damps poorly determined variables."""


class FixedLagSmoother:
    """Gauss-Newton over the latest variables; older ones are marginalised.

    lag: variables whose stamp is older than the newest by more than this leave. iterations, tolerance: of an update,
    which ends when the error falls by less than this share. weak_gauge: next to nothing holds the window as a whole. A
    heading known to a radian would then be lost in the rounding of squares beside what is known to a micrometre, so
    square roots are eliminated (QR) instead of squares (Cholesky). Otherwise they are where squares fail, as they may
    after half a minute by inertia alone.

    estimate: of all variables in the window. linearised_at: the points at which their factors are linearised; for a
    variable that no marginalised factor touches, its estimate. factors: all of them, with empty slots.
    """

    def __init__(self, lag: float, iterations: int, tolerance: float = 1e-3, weak_gauge: bool = False) -> None:
        self._roots_only = weak_gauge
        self._eliminated: gtsam.GaussianBayesTree | None = None  # by the last step, unless it was damped
        self._lag, self._iterations, self._tolerance = lag, iterations, tolerance
        self.factors = gtsam.NonlinearFactorGraph()
        self.estimate, self.linearised_at = gtsam.Values(), gtsam.Values()
        self._held = gtsam.Values()  # linearisation points of the variables that marginalised factors touch
        self._stamps: dict[int, float] = {}
        self._slots: dict[int, set[int]] = {}  # slots of the factors on a variable
        self._free: list[int] = []  # empty slots

    def update(
        self,
        factors: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        stamps: dict[int, float],
        last: Sequence[int] = (),
    ) -> None:
        """Add factors, and variables with initial values; stamps: of these, and new ones of any others.

        last: variables that are eliminated last, so that `joint` has their covariance without another elimination.
        Raises RuntimeError (GTSAM) where the equations cannot be solved.
        """
        self.estimate.insert(values)
        self.linearised_at.insert(values)
        self._stamps |= stamps
        self._insert(factors)
        self._optimise(self._ordering(last))
        oldest = max(self._stamps.values()) - self._lag
        old = [key for key, stamp in self._stamps.items() if stamp < oldest]
        if old:
            self._marginalise(old)

    def joint(self, keys: Sequence[int]) -> Array | None:
        """Joint covariance (N, N), in the order of `keys`, of the variables that the last update eliminated last.

        It is that of its last linearisation. None if others were last, or if the equations could not be solved without
        damping.
        """
        size = self.linearised_at.extract(list(keys)).dim()
        for root in self._eliminated.roots() if self._eliminated is not None else ():
            conditional = root.conditional()
            if list(conditional.keys())[-len(keys) :] == list(keys):
                # What is eliminated last depends on nothing else, so its part of R is the root of its information.
                try:
                    inverse = np.linalg.inv(conditional.R()[-size:, -size:])
                except np.linalg.LinAlgError:
                    return None
                return np.asarray(inverse @ inverse.T, dtype=float)
        return None

    def _ordering(self, last: Sequence[int]) -> gtsam.Ordering:
        """Elimination order: landmarks, states from the oldest to the newest, and those that are to be last."""
        ordering = gtsam.Ordering()
        keys = sorted(
            set(self._stamps).difference(last), key=lambda key: (key >> 56 != LANDMARK, self._stamps[key], key)
        )
        for key in (*keys, *last):
            ordering.push_back(key)
        return ordering

    def _insert(self, factors: gtsam.NonlinearFactorGraph) -> None:
        for n in range(factors.size()):
            factor = factors.at(n)
            if self._free:
                slot = self._free.pop()
                self.factors.replace(slot, factor)
            else:
                slot = self.factors.size()
                self.factors.push_back(factor)
            for key in factor.keys():  # noqa: SIM118 (no dictionary)
                self._slots.setdefault(key, set()).add(slot)

    def _optimise(self, ordering: gtsam.Ordering) -> None:
        error = self.factors.error(self.estimate)
        for _ in range(self._iterations):
            step = self._step(ordering)
            for _ in range(HALVINGS):
                estimate = self.linearised_at.retract(step)
                found = self.factors.error(estimate)
                if found < error:
                    break
                step = self.linearised_at.localCoordinates(self.estimate).add(step).scale(0.5)
            else:
                return
            self.estimate, self.linearised_at = estimate, gtsam.Values(estimate)
            self.linearised_at.update(self._held)
            if error - found < self._tolerance * error:
                return
            error = found

    def _step(self, ordering: gtsam.Ordering) -> gtsam.VectorValues:
        """Solve the linearised problem, slightly damped where something is poorly determined."""
        linear, self._eliminated = self.factors.linearize(self.linearised_at), None

        def solve(*way: Any) -> tuple[gtsam.VectorValues, gtsam.GaussianBayesTree]:
            tree = linear.eliminateMultifrontal(ordering, *way)
            return tree.optimize(), tree

        try:
            step, self._eliminated = self._eliminate(solve)
            return step
        except RuntimeError:
            zero = self.linearised_at.zeroVectors()
            for key in self.linearised_at.keys():  # noqa: SIM118 (no dictionary)
                size = len(zero.at(key))
                unit = gtsam.noiseModel.Unit.Create(size)
                linear.push_back(gtsam.JacobianFactor(key, np.eye(size) * DAMPING, np.zeros(size), unit))
            return linear.optimize(ordering, gtsam.EliminateQR)

    def _eliminate(self, call: Callable[..., T]) -> T:
        """Eliminate squares and, where that fails, square roots. call: takes the function that eliminates, by default
        GTSAM's for squares. Raises RuntimeError (GTSAM) where the equations cannot be solved."""
        if not self._roots_only:
            with suppress(RuntimeError):
                return call()
        return call(gtsam.EliminateQR)

    def _marginalise(self, keys: list[int]) -> None:
        """Marginalise variables: what their factors say about the neighbours replaces these factors."""
        slots = sorted(set[int]().union(*(self._slots[key] for key in keys)))
        leaving = gtsam.NonlinearFactorGraph()
        for slot in slots:
            factor = self.factors.at(slot)
            leaving.push_back(factor)
            for key in factor.keys():  # noqa: SIM118 (no dictionary)
                self._slots[key].discard(slot)
            self.factors.remove(slot)
        self._free += slots
        linear = leaving.linearize(self.linearised_at)
        left = self._eliminate(partial(linear.eliminatePartialMultifrontal, keys))[1]
        touched = [key for key in left.keyVector() if not self._held.exists(key)]
        self._held.insert(self.linearised_at.extract(touched))
        self._insert(gtsam.LinearContainerFactor.ConvertLinearGraph(left, self.linearised_at))
        for key in keys:
            del self._stamps[key], self._slots[key]
            for values in (self.estimate, self.linearised_at):
                values.erase(key)
            if self._held.exists(key):
                self._held.erase(key)
