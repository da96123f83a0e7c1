"""What loops do to the key frames: tracks of different passes become one landmark."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.geometry import Array
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.places import Place
from oysterbench_baselines.gtsam_vi.states import Keyframe


@dataclass(frozen=True)
class Loop:
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
    """Says which tracks are views of one landmark, pass after pass: a union-find over track ids.

    Two tracks in one picture are two landmarks: what would make them one is refused.
    """

    def __init__(self, keyframes: list[Keyframe]) -> None:
        self._parent: dict[int, int] = {}
        self._seen: dict[int, set[int]] = {}
        for keyframe in keyframes:
            for track in keyframe.view.ids.tolist():
                self._seen.setdefault(track, set()).add(keyframe.index)

    def root(self, track: int) -> int:
        """The id that stands for all of them."""
        while (parent := self._parent.get(track, track)) != track:
            self._parent[track] = self._parent.get(parent, parent)
            track = parent
        return track

    def merge(self, one: int, other: int) -> None:
        """Two tracks of one landmark."""
        one, other = sorted((self.root(one), self.root(other)))
        if one != other and not self._seen[one] & self._seen[other]:
            self._parent[other] = one
            self._seen[one] |= self._seen.pop(other)

    def see(self, track: int, keyframe: int) -> bool:
        """One more view of a landmark, in a key frame that had none; False where it had one."""
        seen = self._seen.setdefault(self.root(track), set())
        if keyframe in seen:
            return False
        seen.add(keyframe)
        return True


def join(
    keyframes: list[Keyframe], places: list[Place], loops: list[Loop], model: Model, tolerance_px: float
) -> list[Keyframe]:
    """The key frames with the tracks of different passes merged and with the views that loops have added.

    A landmark found again within `tolerance_px` of a track is that track. Where the merged views of a landmark do not
    meet in a point, at the states of the key frames, its tracks stay apart.
    """
    merger = Merger(keyframes)
    added: dict[int, list[tuple[int, Array]]] = {}
    involved: set[int] = set()
    for loop in loops:
        k = places[loop.second].keyframe
        view = keyframes[k].view
        distance, nearest = cKDTree(view.rays).query(loop.rays)
        for track, ray, apart, n in zip(loop.ids.tolist(), loop.rays, distance, nearest, strict=True):
            involved.add(track)
            if apart * model.focal < tolerance_px:
                merger.merge(track, int(view.ids[n]))
                involved.add(int(view.ids[n]))
            elif merger.see(track, k):
                added.setdefault(k, []).append((track, ray))
    meets = _meeting(keyframes, involved, merger, added, model)
    names = {track: root for track in involved if (root := merger.root(track)) in meets}
    joined = []
    for keyframe in keyframes:
        view = keyframe.view
        ids = np.array([names.get(i, i) for i in view.ids.tolist()], dtype=np.int64)
        more = [(names[i], ray) for i, ray in added.get(keyframe.index, []) if i in names]
        ids = np.concatenate([ids, np.array([i for i, _ in more], dtype=np.int64)])
        rays = np.concatenate([view.rays, np.array([ray for _, ray in more]).reshape(-1, 2)])
        right = view.right
        if right is not None:
            right = np.concatenate([right, np.full((len(more), 2), np.nan)])
        joined.append(replace(keyframe, view=replace(view, ids=ids, rays=rays, right=right)))
    return joined


def _meeting(
    keyframes: list[Keyframe],
    involved: set[int],
    merger: Merger,
    added: dict[int, list[tuple[int, Array]]],
    model: Model,
) -> set[int]:
    """The roots whose views, all together, make a landmark."""
    known = np.array(sorted(involved), dtype=np.int64)
    roots = np.array([merger.root(i) for i in known.tolist()], dtype=np.int64)
    track, rays, rows = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))], [np.empty(0, dtype=np.int64)]
    for n, keyframe in enumerate(keyframes):
        view = keyframe.view
        own = np.flatnonzero(np.isin(view.ids, known))
        more = added.get(keyframe.index, [])
        track += [roots[np.searchsorted(known, view.ids[own])], np.array([merger.root(i) for i, _ in more], np.int64)]
        rays += [view.rays[own], np.array([ray for _, ray in more]).reshape(-1, 2)]
        rows.append(np.full(len(own) + len(more), n))
    poses = np.array([keyframe.state.matrix for keyframe in keyframes])
    gate = 3 * model.settings.max_landmark_error_px
    ids, _ = model.triangulate(np.concatenate(track), np.concatenate(rays), poses[np.concatenate(rows)], gate)
    return set(ids.tolist())
