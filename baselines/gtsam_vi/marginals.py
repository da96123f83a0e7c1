"""Marginal covariances of many variables of a graph at once.

GTSAM's `Marginals` takes each from the joint density of a clique and the root, found by elimination: minutes and
gigabytes where passes over the same ground make cliques of a thousand rows. All of them are entries of the inverse of
the information matrix where its factor is non-zero, and these follow one from another from the last variable eliminated
to the first (Takahashi, Fagan & Chin 1973): with R x + S y = d for a variable x given its parents y,

    A = R^-1 S,   P_xy = -A P_yy,   P_xx = R^-1 R^-T + A P_yy A^T,

and P_yy is part of the joint covariance, known by then, of the first parent to be eliminated and its parents.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import gtsam
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.gtsam_vi.elimination import Cholesky, Elimination
from oysterbench_baselines.gtsam_vi.graph import nested_dissection


@dataclass(frozen=True)
class _Joint:
    """Joint covariance (N, N) of a variable and its parents; the rows of each, by key."""

    covariance: Array
    rows: dict[int, slice]

    def of(self, keys: list[int]) -> Array:
        """Covariance of some of them, in the order of `keys`."""
        rows = np.concatenate([np.r_[self.rows[key]] for key in keys])
        return np.asarray(self.covariance[np.ix_(rows, rows)], dtype=float)


def marginal_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Collection[int]
) -> dict[int, Array]:
    """Covariances (d, d) of variables in their tangents, by key. Raises RuntimeError where the system is singular."""
    return marginals_of(graph.linearize(values), nested_dissection(graph), keys)


def marginals_of(
    linear: gtsam.GaussianFactorGraph,
    ordering: gtsam.Ordering,
    keys: Collection[int],
    elimination: Elimination = Cholesky,
) -> dict[int, Array]:
    """Covariances as in `marginal_covariances`, of a linear graph eliminated in this order."""
    wanted, net = set(keys), elimination.all(linear, ordering)
    # From the first eliminated to the last: a variable is the child of the first of its parents. Variables that are not
    # asked for and have no such children, as most landmarks, are left out.
    conditionals, widths, children = dict[int, gtsam.GaussianConditional](), dict[int, int](), dict[int, list[int]]()
    order, roots = dict[int, int](), list[int]()
    for n in range(net.size()):
        conditional = net.at(n)
        key = conditional.keys()[0]
        order[key], widths[key], conditionals[key] = n, len(conditional.R()), conditional
    for key, conditional in conditionals.items():
        if key not in wanted and key not in children:
            continue
        parents = conditional.keys()[1:]
        if parents:
            children.setdefault(min(parents, key=order.__getitem__), []).append(key)
        else:
            roots.append(key)
    found = dict[int, Array]()
    waiting: list[tuple[int, _Joint | None]] = [(root, None) for root in roots]
    while waiting:  # a joint lives until its last child has used it
        key, above = waiting.pop()
        joint = _joint(conditionals[key], above, widths)
        if key in wanted:
            found[key] = joint.of([key])
        waiting += [(child, joint) for child in children.get(key, [])]
    return found


def _joint(conditional: gtsam.GaussianConditional, above: _Joint | None, widths: dict[int, int]) -> _Joint:
    """Joint of a variable and its parents; `above`: the joint that contains the parents."""
    keys = list(conditional.keys())
    ends = np.cumsum([widths[key] for key in keys]).tolist()
    rows = {key: slice(end - widths[key], end) for key, end in zip(keys, ends, strict=True)}
    try:
        inverse = np.linalg.inv(conditional.R())
    except np.linalg.LinAlgError as error:
        raise RuntimeError(str(error)) from None
    own, covariance = ends[0], np.empty((ends[-1], ends[-1]))
    covariance[:own, :own] = inverse @ inverse.T
    if above is not None:
        of_parents = above.of(keys[1:])
        slope = inverse @ conditional.S()
        across = -slope @ of_parents
        of_own = covariance[:own, :own] - across @ slope.T
        covariance[:own, :own] = 0.5 * (of_own + of_own.T)
        covariance[:own, own:], covariance[own:, :own] = across, across.T
        covariance[own:, own:] = of_parents
    return _Joint(covariance, rows)
