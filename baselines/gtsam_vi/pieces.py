"""Bundle adjustment of a long path, piece by piece, so that it takes no more memory than one piece.

A path is cut into pieces of some hundred keyframes each. The factors of a piece are those of its keyframes and of the
landmarks first seen in it. Most of its variables occur in no other piece: eliminated, they leave one message, all that
the piece says about the few variables that it shares (states at its ends, keyframes that a landmark or a tie reaches
across them, calibrations). The messages of all others about a piece's shared variables, together with its own factors,
are all that is known of it: its step and its marginal covariances are those of the whole path's system, up to rounding.
Only messages outlive a piece, and its factors where they are few (`KEPT_VIEWS`); its elimination is repeated when it is
needed. (Submaps whose separators are eliminated last: Ni, Steedly & Dellaert 2007, whose submaps keep their own
frames.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.memory import hand_back
from oysterbench_baselines.gtsam_vi.bundle import (
    Bundle,
    Views,
    add_views,
    motion_factors,
    points_of,
    values_of,
)
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.elimination import Cholesky, Elimination, Orthogonal
from oysterbench_baselines.gtsam_vi.graph import Model, nested_dissection
from oysterbench_baselines.gtsam_vi.marginals import marginals_of
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, read_state
from oysterbench_baselines.gtsam_vi.steps import Steps, apply_steps

T = TypeVar("T")

TOLERANCE = 1e-4
"""Share of the error by which it falls at least, or the adjustment ends."""
HALVINGS = 3
"""Number of times that a step which does not reduce the error is halved before it is given up."""
LOOSE, UNIT = np.eye(3) * 1e-5, gtsam.noiseModel.Unit.Create(3)
"""Root information, 1/m, by which a landmark may be held where it is: to a hundred kilometres, as thousands of them
must not hold the path."""
KEPT_VIEWS = 300_000
"""Number of views of a path up to which its factors are kept from one step to the next: 60 MB, twenty minutes with one
camera. Those of a longer path are rebuilt."""


def parts_of(count: int, size: int) -> list[range]:
    """Cut `count` keyframes into pieces of `size` each or up to half as many again; into one if they make no two."""
    ends = np.linspace(0, count, max(1, count // size) + 1).round().astype(int).tolist()
    return [range(start, stop) for start, stop in pairwise(ends)]


@dataclass
class Piecewise:
    """A path of keyframes in pieces, with the states that it was given.

    ids (L,), points (L, 3): landmarks, sorted; owner (L,): their pieces. others: by piece, the factors other than
    views, which are few.
    """

    model: Model
    rig: CameraRig
    keyframes: list[Keyframe]
    parts: list[range]
    views: Views
    states: list[State]
    ids: NDArray[np.int64]
    points: Array
    owner: NDArray[np.intp]
    others: list[list[gtsam.NonlinearFactor]]
    _orders: dict[int, gtsam.Ordering] = field(default_factory=dict)
    _graphs: dict[int, gtsam.NonlinearFactorGraph] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Model,
        rig: CameraRig,
        keyframes: list[Keyframe],
        parts: list[range],
        views: Views,
        states: list[State],
        gate_px: float,
    ) -> Piecewise:
        """Build with landmarks triangulated from the states."""
        poses = np.array([state.matrix for state in states])
        piece = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        tracks, first = np.unique(views.track, return_index=True)  # rows are in time order
        owners = piece[views.row[first]]
        found = [
            views.of_tracks(tracks[owners == p]).triangulate(rig, poses, gate_px, model.settings.landmarks)
            for p in range(len(parts))
        ]
        ids, points = (np.concatenate(part) for part in zip(*found, strict=True))
        owner = np.repeat(np.arange(len(parts)), [len(own) for own, _ in found])
        order = np.argsort(ids)
        ids, points, owner = ids[order], points[order], owner[order]
        others = [motion_factors(model, keyframes, states, part) for part in parts]
        of_pose = {X(keyframe.index): p for keyframe, p in zip(keyframes, piece.tolist(), strict=True)}
        for factor in model.aiding.stretch_factors(keyframes, states, ids, points):
            others[max(of_pose.get(key, 0) for key in factor.keys())].append(factor)  # noqa: SIM118 (no dictionary)
        return cls(model, rig, keyframes, parts, views, states, ids, points, owner, others)

    @cached_property
    def shared(self) -> list[list[int]]:
        """By piece, keys of its variables that another piece has too."""
        return _shared(set(self.graph(p).keyVector()) for p in range(len(self.parts)))

    def values(self) -> gtsam.Values:
        """Values of all variables as they were given."""
        return values_of(self.model, self.rig, self.keyframes, self.states, self.ids, self.points)

    def graph(self, piece: int, times: float = 1.0) -> gtsam.NonlinearFactorGraph:
        """Factors of a piece, with the sigma of views multiplied by `times`. The graph must not be added to."""
        if times != 1.0 or len(self.views.track) > KEPT_VIEWS:
            return self._new_graph(piece, times)
        if piece not in self._graphs:
            self._graphs[piece] = self._new_graph(piece, times)
        return self._graphs[piece]

    def _new_graph(self, piece: int, times: float) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in self.others[piece]:
            graph.push_back(factor)
        seen = self.views.of_tracks(self.ids[self.owner == piece])
        add_views(graph, self.model, self.rig, self.keyframes, seen, times)
        return graph

    def order(self, piece: int, linear: gtsam.GaussianFactorGraph) -> gtsam.Ordering:
        """Elimination order of the variables that only this piece has. linear: its graph, linearised anywhere, as which
        variables share a factor does not depend on where."""
        if piece not in self._orders:
            self._orders[piece] = nested_dissection(linear, self.shared[piece])
        return gtsam.Ordering(self._orders[piece])

    def errors_px(self, values: gtsam.Values) -> Array:
        """Reprojection errors (M,) px of all views."""
        poses = np.array([values.atPose3(X(keyframe.index)).matrix() for keyframe in self.keyframes])
        found = []
        for p in range(len(self.parts)):
            ids = self.ids[self.owner == p]
            found.append(self.views.of_tracks(ids).errors_px(self.rig, poses, ids, points_of(values, ids)))
        return np.concatenate(found)

    def system(self, values: gtsam.Values, times: float = 1.0) -> PiecewiseSystem:
        """Linearise all pieces at values."""
        return PiecewiseSystem(self, values, times)

    def moved(self, values: gtsam.Values, steps: Steps) -> gtsam.Values:
        """Apply steps of all variables to values."""
        return apply_steps(values, steps, [keyframe.index for keyframe in self.keyframes], self.ids, self._seen)

    @cached_property
    def _seen(self) -> NDArray[np.intp]:
        """Positions (L,) in the list of the keyframes that first saw the landmarks."""
        tracks, first = np.unique(self.views.track, return_index=True)
        return self.views.row[first][np.searchsorted(tracks, self.ids)]


class PiecewiseSystem:
    """The linearised system of a piecewise path, of which no more than one piece is held at a time.

    values: at which it is linearised. error: of all factors there.
    """

    def __init__(self, path: Piecewise, values: gtsam.Values, times: float = 1.0) -> None:
        self._path, self.values, self._times = path, values, times
        self._shared = path.shared
        self._elimination: Elimination = Cholesky
        self._messages: list[gtsam.GaussianFactorGraph] = []
        self.error = sum(path.graph(p, times).error(values) for p in range(len(path.parts)))
        self._solved(lambda: None)

    def steps(self) -> Steps:
        """The Gauss-Newton step of every variable."""
        return self._solved(self._steps)

    def pose_covariances(self) -> dict[int, Array]:
        """Covariance (6, 6) of the pose of every keyframe, in its tangent, by key."""
        return self._solved(self._pose_covariances)

    def _solved(self, work: Callable[[], T]) -> T:
        """Do work with all messages there; where Cholesky decomposition fails, again with those of QR decomposition."""
        try:
            if not self._messages:
                self._messages = [self._message(p) for p in range(len(self._path.parts))]
            return work()
        except RuntimeError:
            if self._elimination is Orthogonal:
                raise
        self._elimination, self._messages = Orthogonal, []
        return self._solved(work)

    def _message(self, piece: int) -> gtsam.GaussianFactorGraph:
        linear = self._linear(piece)
        return self._elimination.some(linear, self._path.order(piece, linear))

    def _steps(self) -> Steps:
        found = dict[int, Array]()
        for p in range(len(self._messages)):
            linear, ordering = self._piece(p)
            step = self._elimination.all(linear, ordering).optimize()
            found |= {key: step.at(key) for key in linear.keyVector()}
        return found

    def _pose_covariances(self) -> dict[int, Array]:
        found = dict[int, Array]()
        for p, part in enumerate(self._path.parts):
            linear, ordering = self._piece(p)
            keys = [X(self._path.keyframes[n].index) for n in part]
            found |= marginals_of(linear, ordering, keys, self._elimination)
            hand_back()
        return found

    def _piece(self, piece: int) -> tuple[gtsam.GaussianFactorGraph, gtsam.Ordering]:
        """A piece's own factors with what all others say about its shared variables; an elimination order."""
        linear, shared = self._linear(piece), self._shared[piece]
        ordering = self._path.order(piece, linear)
        outside = self._outside(piece)
        for n in range(outside.size()):
            linear.push_back(outside.at(n))
        for key in shared:
            ordering.push_back(key)
        return linear, ordering

    def _linear(self, piece: int) -> gtsam.GaussianFactorGraph:
        """A piece's own factors, linearised. Where there are no squares to fail, its landmarks are held loosely where
        they are: after a bold step all views of one may have it behind them, and say nothing about it."""
        path = self._path
        linear = path.graph(piece, self._times).linearize(self.values)
        for landmark in path.ids[path.owner == piece].tolist() if self._elimination is Orthogonal else ():
            linear.push_back(gtsam.JacobianFactor(L(landmark), LOOSE, np.zeros(3), UNIT))
        return linear

    def _outside(self, piece: int) -> gtsam.GaussianFactorGraph:
        """What all other pieces say about the variables that a piece shares, as factors."""
        others, shared = gtsam.GaussianFactorGraph(), self._shared[piece]
        for p, message in enumerate(self._messages):
            for n in range(message.size() if p != piece else 0):
                others.push_back(message.at(n))
        if not shared:
            return others
        constrained = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(others, shared)
        own = gtsam.Ordering()
        for n in range(constrained.size() - len(shared)):
            own.push_back(constrained.at(n))
        return self._elimination.some(others, own) if own.size() else others


def _shared(keys: Iterable[set[int]]) -> list[list[int]]:
    """By piece, those of its variables that another piece has too, sorted."""
    seen, twice, all_keys = set[int](), set[int](), []
    for own in keys:
        twice |= seen & own
        seen |= own
        all_keys.append(own)
    return [sorted(own & twice) for own in all_keys]


def adjust_piecewise(
    model: Model,
    keyframes: list[Keyframe],
    states: list[State],
    gates_px: tuple[float, ...],
    min_views: int,
    parts: list[range],
) -> tuple[Bundle, Piecewise]:
    """Adjust as `bundle.adjust` does, by Gauss-Newton steps, which are halved where the error does not fall or the
    equations there cannot be solved.

    The bundle's graph is empty: the piecewise path stands for it. Raises RuntimeError where the equations cannot be
    solved at the start.
    """
    rig = copy(model.rig)
    views = Views.of(keyframes, min_views)
    for gate in gates_px:
        path = Piecewise.of(model, rig, keyframes, parts, views, states, gate)
        values = _optimise(path, model.settings.smoothing.iterations)
        states = [read_state(values, k.index) for k in keyframes]
        rig.read(values)
    return Bundle(gtsam.NonlinearFactorGraph(), values, path.ids, path.errors_px(values)), path


def _system(path: Piecewise, values: gtsam.Values) -> PiecewiseSystem | None:
    """The system at values; None where its equations cannot be solved."""
    try:
        return path.system(values)
    except RuntimeError:
        return None


def _optimise(path: Piecewise, iterations: int) -> gtsam.Values:
    best = path.system(path.values())
    for _ in range(iterations):
        steps = best.steps()
        for _ in range(HALVINGS):
            system = _system(path, path.moved(best.values, steps))
            if system is not None and system.error < best.error:
                break
            steps = {key: 0.5 * step for key, step in steps.items()}
        else:
            break
        assert system is not None  # the loop was left for it
        done = best.error - system.error < TOLERANCE * best.error
        best = system
        hand_back()
        if done:
            break
    return best.values
