"""Effect of loops on the keyframes: tracks of different passes become one landmark, or two poses are tied.

Keyframes that share a landmark are coupled, each with each. Ground passed over again and again would couple the whole
dive, and the time of an adjustment would grow with the cube of the number of passes. So once enough keyframes see a
landmark, a later pass is only tied by the relative pose of a loop now and then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array, invert
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.pieces import parts_of
from oysterbench_baselines.gtsam_vi.places import Place, level_pose
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe


@dataclass(frozen=True)
class LoopClosure:
    """A verified loop between places `first` and `second`: T_first_second (4, 4) of their level frames, covariance
    (4, 4) of heading and position; ids (M,) of landmarks of the first and their pixels and rays (M, 2) in the
    second."""

    first: int
    second: int
    T_first_second: Array
    covariance: Array
    ids: NDArray[np.int64]
    pixels: Array
    rays: Array


class Merger:
    """Union-find over track ids: which tracks, pass after pass, are views of one landmark.

    Two tracks in one image are two landmarks: a merge that would make them one is refused.
    """

    def __init__(self, keyframes: list[Keyframe]) -> None:
        self._parent: dict[int, int] = {}
        self._seen: dict[int, set[int]] = {}
        for keyframe in keyframes:
            for track in keyframe.observations.ids.tolist():
                self._seen.setdefault(track, set()).add(keyframe.index)

    def root(self, track: int) -> int:
        """Id that stands for all tracks of the landmark."""
        while (parent := self._parent.get(track, track)) != track:
            self._parent[track] = self._parent.get(parent, parent)
            track = parent
        return track

    def merge(self, one: int, other: int) -> None:
        """Merge two tracks into one landmark, unless one keyframe has seen both."""
        one, other = sorted((self.root(one), self.root(other)))
        if one != other and not self._seen[one] & self._seen[other]:
            self._parent[other] = one
            self._seen[one] |= self._seen.pop(other)

    def views(self, track: int) -> int:
        """Number of keyframes that have seen the landmark of a track."""
        return len(self._seen.get(self.root(track), ()))

    def see(self, track: int, keyframe: int) -> bool:
        """Add a view of a landmark in a keyframe that has none; return False if it has one."""
        seen = self._seen.setdefault(self.root(track), set())
        if keyframe in seen:
            return False
        seen.add(keyframe)
        return True


class Ties:
    """Choice of loops to tie passes that share no landmarks: one every `step` places, and all of them, pass after pass,
    to the same few places, so that only these couple the passes."""

    def __init__(self, step: int) -> None:
        self._step = step
        self._anchors: set[int] = set()
        self.loops: list[LoopClosure] = []

    def offer(self, loop: LoopClosure) -> None:
        """Consider a loop, which must not be earlier than those before."""
        if self.loops and loop.second < self.loops[-1].second + self._step:
            return
        near = range(loop.first - self._step + 1, loop.first + self._step)
        if loop.first in self._anchors or self._anchors.isdisjoint(near):
            self._anchors.add(loop.first)
            self.loops.append(loop)


def tie(loop: LoopClosure, first: Keyframe, second: Keyframe, settings: GtsamViSettings) -> gtsam.NonlinearFactor:
    """Factor of a loop as relative pose of its keyframes: heading and position as the loop has them, roll and pitch as
    they are, held loosely (gravity determines them)."""
    tilts = [invert(level_pose(k.estimate.matrix)) @ k.estimate.matrix for k in (first, second)]
    to_second = loop.T_first_second @ tilts[1]
    of_loop = np.zeros((6, 6))  # rotation, then position, in the first's level axes
    of_loop[:2, :2] = np.eye(2) * settings.loops.tie_tilt**2
    of_loop[2:, 2:] = loop.covariance + np.diag(
        [settings.loops.heading_floor**2] + [settings.loops.position_floor_m**2] * 3
    )
    turn = np.kron(np.eye(2), to_second[:3, :3].T)
    noise = gtsam.noiseModel.Gaussian.Covariance(turn @ of_loop @ turn.T)
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(settings.loops.cauchy)
    step = gtsam.Pose3(invert(tilts[0]) @ to_second)
    return gtsam.BetweenFactorPose3(
        X(first.index), X(second.index), step, gtsam.noiseModel.Robust.Create(cauchy, noise)
    )


def join(keyframes: list[Keyframe], places: list[Place], loops: list[LoopClosure], model: Model) -> list[Keyframe]:
    """Return the keyframes with the tracks of different passes merged, the views added by loops, and ties.

    A landmark found again within `merge_px` of a track is that track. If the merged views of a landmark do not meet in
    a point, given the states of the keyframes, its tracks stay apart. A loop on ground that `merge_keyframes` already
    see, or between pieces of a long path, becomes no more than a tie.
    """
    settings = model.settings
    merger, ties = Merger(keyframes), Ties(settings.loops.tie_places)
    parts = parts_of(len(keyframes), settings.smoothing.piece_keyframes)
    piece = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    added: dict[int, list[tuple[int, Array]]] = {}
    involved: set[int] = set()
    for loop in loops:
        across = piece[places[loop.first].keyframe] != piece[places[loop.second].keyframe]
        if across or max(merger.views(track) for track in loop.ids.tolist()) >= settings.loops.merge_keyframes:
            ties.offer(loop)
            continue
        k = places[loop.second].keyframe
        view = keyframes[k].observations
        distances, nearest = cKDTree(view.rays).query(loop.rays)
        found = zip(loop.ids.tolist(), loop.rays, np.atleast_1d(distances), np.atleast_1d(nearest), strict=True)
        for track, ray, apart, n in found:
            involved.add(track)
            if apart * model.rig.focal < settings.loops.merge_px:
                merger.merge(track, int(view.ids[n]))
                involved.add(int(view.ids[n]))
            elif merger.see(track, k):
                added.setdefault(k, []).append((track, ray))
    meets = _meeting(keyframes, involved, merger, added, model)
    names = {track: root for track in involved if (root := merger.root(track)) in meets}
    joined = []
    for keyframe in keyframes:
        view = keyframe.observations
        ids = np.array([names.get(i, i) for i in view.ids.tolist()], dtype=np.int64)
        more = [(names[i], ray) for i, ray in added.get(keyframe.index, []) if i in names]
        ids = np.concatenate([ids, np.array([i for i, _ in more], dtype=np.int64)])
        rays = np.concatenate([view.rays, np.array([ray for _, ray in more]).reshape(-1, 2)])
        right = view.right
        if right is not None:
            right = np.concatenate([right, np.full((len(more), 2), np.nan)])
        joined.append(replace(keyframe, observations=replace(view, ids=ids, rays=rays, right=right)))
    for loop in ties.loops:
        first, second = (places[n].keyframe for n in (loop.first, loop.second))
        factor = tie(loop, keyframes[first], keyframes[second], settings)
        joined[second].aiding = [*joined[second].aiding, factor]
    return joined


def _meeting(
    keyframes: list[Keyframe],
    involved: set[int],
    merger: Merger,
    added: dict[int, list[tuple[int, Array]]],
    model: Model,
) -> set[int]:
    """Roots whose views, all together, triangulate to a good landmark."""
    known = np.array(sorted(involved), dtype=np.int64)
    roots = np.array([merger.root(i) for i in known.tolist()], dtype=np.int64)
    track, rays, rows = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))], [np.empty(0, dtype=np.int64)]
    for n, keyframe in enumerate(keyframes):
        view = keyframe.observations
        own = np.flatnonzero(np.isin(view.ids, known))
        more = added.get(keyframe.index, [])
        track += [roots[np.searchsorted(known, view.ids[own])], np.array([merger.root(i) for i, _ in more], np.int64)]
        rays += [view.rays[own], np.array([ray for _, ray in more]).reshape(-1, 2)]
        rows.append(np.full(len(own) + len(more), n))
    poses = np.array([keyframe.estimate.matrix for keyframe in keyframes])
    gate = 3 * model.settings.landmarks.max_error_px
    ids, _ = model.rig.triangulate(
        np.concatenate(track), np.concatenate(rays), poses[np.concatenate(rows)], gate, model.settings.landmarks
    )
    return set(ids.tolist())
