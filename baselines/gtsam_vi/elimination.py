"""Elimination of a linear system, where need be by orthogonal transformations.

GTSAM eliminates by Cholesky decomposition, and gives up where the last two pivots of a clique differ by more than a
factor of 4096, as it takes that for an indeterminate system. That is what a lost stretch looks like: where it went is
uncertain by metres along one direction, oblique to the axes, and known to a millimetre across it. QR decomposition of
the factors themselves, one variable at a time, does not square the condition number and solves it; it takes some ten
times as long.
"""

from __future__ import annotations

import gtsam
import numpy as np


class Cholesky:
    """Elimination by GTSAM's Cholesky decomposition. Raises RuntimeError where a pivot is next to nothing."""

    @staticmethod
    def all(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesNet:
        """Eliminate all variables of a linear system, in this order."""
        return linear.eliminateSequential(ordering)

    @staticmethod
    def some(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianFactorGraph:
        """Eliminate some variables of a linear system; return what it says about the others."""
        return linear.eliminatePartialMultifrontal(ordering)[1]


class Orthogonal:
    """Elimination by QR decomposition. Raises RuntimeError where the system is singular."""

    @staticmethod
    def all(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesNet:
        """As of `Cholesky`."""
        return _one_by_one(linear, ordering)[0]

    @staticmethod
    def some(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianFactorGraph:
        """As of `Cholesky`."""
        return _one_by_one(linear, ordering)[1]


Elimination = type[Cholesky] | type[Orthogonal]


def _one_by_one(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering
) -> tuple[gtsam.GaussianBayesNet, gtsam.GaussianFactorGraph]:
    """Conditionals of the eliminated variables, and the factors left on the others."""
    factors = [linear.at(n) for n in range(linear.size())]
    of_key = dict[int, set[int]]()  # indices of the factors of a variable
    for n, factor in enumerate(factors):
        for key in factor.keys():  # noqa: SIM118 (no dictionary)
            of_key.setdefault(key, set()).add(n)
    used, net = set[int](), gtsam.GaussianBayesNet()
    for n in range(ordering.size()):
        key, own, alone = ordering.at(n), gtsam.GaussianFactorGraph(), gtsam.Ordering()
        alone.push_back(key)
        for index in sorted(of_key.get(key, set()) - used):
            own.push_back(factors[index])
            used.add(index)
        conditional, rest = gtsam.EliminateQR(own, alone)
        pivots = np.abs(np.diag(conditional.R()))
        if not (np.isfinite(pivots).all() and pivots.min() > 0):
            raise RuntimeError(f"nothing determines the variable {key}")
        net.push_back(conditional)
        for other in rest.keys():  # noqa: SIM118
            of_key[other].add(len(factors))
        factors.append(rest)
    left = gtsam.GaussianFactorGraph()
    for n, factor in enumerate(factors):
        if n not in used and len(factor.keys()):
            left.push_back(factor)
    return net, left
