"""Where the pictures of a dive lie to each other: a pose graph of their shifts and turns about the vertical.

Between two pictures in a row a path errs by millimetres, between two passes over the same ground by as much as oysters
are apart. Of two pictures that overlap, their oysters tell how one lies on the other (`mapping.registration`). The
moves of all pictures are the least squares of these steps, of the path's own from each picture to the next, and of its
poses; a linear problem, as headings err by few degrees. Steps of the wrong oysters contradict the others, and lose
their weight by that of Geman and McClure (1985), which comes in by and by (graduated non-convexity, Yang et al. 2020).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, coo_array, csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from oysterbench.core.geometry import Array, invert
from oysterbench.mapping.projection import Patch
from oysterbench.mapping.registration import FEWEST, FINEST_M, register
from oysterbench.mapping.settings import MapSettings

PARTNERS = 24
"""Earlier pictures that one is registered with, at most: spread evenly over all that overlap with it."""
ROUNDS = ("pictures registered", "pictures registered again")
"""Of registering, by what is counted in each: what was out of reach along the path may be within it once pictures are
laid."""
OWN_STEP = 0.02  # 1 sigma of the path's step from a picture to the next, of its length, at least
OWN_TURN_RAD = 0.002  # the same of the turn between them
HEADING_RAD = 0.05  # 1 sigma of the path's heading
LEAST_SPREAD_M = 0.5  # of the vehicle about the middle of its path, root mean square, from which on that has a turn
UNEVEN_M = 0.003  # 1 sigma of a step over the ground of two pictures: their tilts and depths err, too
UNEVEN_RAD = 0.003
OUTLIER = 3.0  # sigma, from where a step loses its weight
GRADUAL = np.concatenate([np.geomspace(64.0, 1.0, 13), np.ones(4)])
"""By how much more a step may be off before it loses its weight, from solution to solution."""

Picture = Sequence[Patch]

Progress = Callable[[str, int, int], None]
"""To be told what is counted, how many of them are done, and of how many."""


@dataclass(frozen=True)
class Step:
    """Of two pictures, along the path: the point `here` (3,) m of `to` is the point `there` of `start`, about which
    `to` is turned by turn_rad; each to 1 sigma."""

    start: int
    to: int
    here: Array
    there: Array
    turn_rad: float
    sigma_m: float
    sigma_rad: float


def laid(
    pictures: Sequence[Picture],
    places: Array,
    settings: MapSettings,
    progress: Progress = lambda what, done, total: None,
) -> tuple[list[list[Patch]], Array]:
    """The oysters of all pictures, in time order, where they lie to each other, and the moves (N, 4, 4) of the pictures
    there, each about the vertical.

    places: (N, 3) m, where the vehicle was. Where the path is sure to FINEST_M nothing is moved. A picture that is
    registered with none is as sure as the path's own steps from the nearest one that is, or as its pose. One that shows
    no oyster is moved as those before and after it.
    """
    kept = [k for k, picture in enumerate(pictures) if picture]
    some = [pictures[k] for k in kept]
    poses_m = np.array([picture[0].pose_sigma_m for picture in some])
    if poses_m.max(initial=0.0) <= FINEST_M:
        return [list(picture) for picture in pictures], np.tile(np.eye(4), (len(pictures), 1, 1))
    middles = np.array([np.mean([patch.centre for patch in picture], axis=0) for picture in some])
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])[kept]
    own = [
        Step(k, k + 1, at, at, 0.0, float(np.hypot(FINEST_M, OWN_STEP * length)), OWN_TURN_RAD)
        for k, (at, length) in enumerate(zip(middles[1:], np.diff(gone), strict=True))
    ]
    moves, told = np.tile(np.eye(4), (len(some), 1, 1)), list[Step]()
    for counted in ROUNDS:
        known = {(step.start, step.to) for step in told}
        told += _registered(some, moves, known, settings, partial(progress, counted))
        own = _as_sure_as_told(own, told)
        moves, sigmas = solve(own, told, middles, poses_m)
    of_all = _of_all(np.array(kept), moves, places)
    common = _onto_path(_placed(places, of_all), places)
    moves, of_all = common @ moves, common @ of_all
    ends = sorted({k for step in told for k in (step.start, step.to)})
    since = np.concatenate([[0.0], np.cumsum([step.sigma_m**2 for step in own])])
    away = np.abs(since[:, None] - since[ends]).min(axis=1, initial=np.inf)
    result = [list[Patch]() for _ in pictures]
    for k, picture, move, sigma in zip(kept, some, moves, np.hypot(sigmas, np.sqrt(away)).tolist(), strict=True):
        result[k] = [patch.laid(move, min(max(FINEST_M, sigma), patch.pose_sigma_m)) for patch in picture]
    return result, of_all


def _onto_path(there: Array, places: Array) -> Array:
    """(4, 4), about the vertical, by which moved places (N, 3) m lie on those of the path in the least squares.

    What oysters tell is how pictures lie to each other, and the path as a whole, where all of it lies: its headings,
    which hold each picture as it is, err otherwise than its places do. The turn is left where the vehicle hardly moved.
    """
    middle, own = places.mean(axis=0), there.mean(axis=0)
    x, y = (there - own)[:, :2].T
    east, north = (places - middle)[:, :2].T
    spread_m = np.sqrt((east**2 + north**2).mean())
    turn_rad = float(np.arctan2((x * north - y * east).sum(), (x * east + y * north).sum()))
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("z", turn_rad if spread_m >= LEAST_SPREAD_M else 0.0).as_matrix()
    found[:3, 3] = middle - found[:3, :3] @ own
    return found


def _of_all(kept: NDArray[np.int64], moves: Array, places: Array) -> Array:
    """Moves (N, 4, 4) of all pictures, at places (N, 3) m, from those (M, 4, 4) of some: in between, of the one before
    and the one after by how many pictures they are away; at the ends, of the nearest."""
    numbers = np.arange(len(places))
    before, after = (
        np.clip(at, 0, len(kept) - 1)
        for at in (np.searchsorted(kept, numbers, "right") - 1, np.searchsorted(kept, numbers))
    )
    share = ((numbers - kept[before]) / np.maximum(kept[after] - kept[before], 1))[:, None]
    headings = Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()[:, 2:]
    heading = (1.0 - share) * headings[before] + share * headings[after]
    there = (1.0 - share) * _placed(places, moves[before]) + share * _placed(places, moves[after])
    found = np.tile(np.eye(4), (len(places), 1, 1))
    found[:, :3, :3] = Rotation.from_euler("z", heading).as_matrix()
    found[:, :3, 3] = there - _placed(places, found)
    found[kept] = moves
    return found


def _placed(places: Array, moves: Array) -> Array:
    """(N, 3) m: places (N, 3) m, each after its move (N, 4, 4)."""
    return np.asarray((moves[:, :3, :3] @ places[..., None])[..., 0] + moves[:, :3, 3])


def _registered(
    pictures: Sequence[Picture],
    moves: Array,
    but: set[tuple[int, int]],
    settings: MapSettings,
    progress: Callable[[int, int], None],
) -> Iterator[Step]:
    """Steps between pictures that overlap where they were moved to, but those that are known."""
    moved = [[patch.placed(move) for patch in picture] for picture, move in zip(pictures, moves, strict=True)]
    headings = Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()[:, 2]
    for start, to in overlapping(moved):
        progress(to + 1, len(pictures))
        found = None if (start, to) in but else register(moved[to], moved[start], settings)
        if found is None:
            continue
        here, there = (
            invert(moves[k]) @ np.append(point, 1.0)
            for k, point in ((to, found.about), (start, found.about + found.shift))
        )
        turn = found.turn_rad + headings[to] - headings[start]
        sigmas = np.hypot([found.sigma_m, found.sigma_rad], [UNEVEN_M, UNEVEN_RAD])
        yield Step(start, to, here[:3], there[:3], float(turn), float(sigmas[0]), float(sigmas[1]))


def _as_sure_as_told(own: Sequence[Step], told: Sequence[Step]) -> list[Step]:
    """The path's steps, less sure where oysters of pictures in a row contradict them."""
    pairs = [(own[step.start], step) for step in told if step.to == step.start + 1]
    if len(pairs) < FEWEST:
        return list(own)
    off2 = np.array(
        [((step.there - step.here)[:2] ** 2).sum() / (way.sigma_m**2 + step.sigma_m**2) for way, step in pairs]
    )
    turn2 = np.array([step.turn_rad**2 / (way.sigma_rad**2 + step.sigma_rad**2) for way, step in pairs])
    times, turn_times = (
        float(np.sqrt(max(1.0, np.median(squares) / (2.0 * gammaincinv(freedom / 2.0, 0.5)))))
        for squares, freedom in ((off2, 2), (turn2, 1))
    )
    return [replace(way, sigma_m=times * way.sigma_m, sigma_rad=turn_times * way.sigma_rad) for way in own]


def overlapping(pictures: Sequence[Picture]) -> Iterator[tuple[int, int]]:
    """Pairs of pictures (earlier, later) of which the later shows enough oysters where the earlier does."""
    centres = [np.array([patch.centre[:2] for patch in picture]) for picture in pictures]
    low, high = (np.array([edge(one, axis=0) for one in centres]).reshape(-1, 2) for edge in (np.min, np.max))
    for k, own in enumerate(centres):
        near = np.flatnonzero(((low[:k] < high[k]) & (high[:k] > low[k])).all(axis=1))
        inside = ((own >= low[near, None]) & (own <= high[near, None])).all(axis=2).sum(axis=1)
        near = near[inside >= FEWEST]
        for j in near[np.unique(np.linspace(0, len(near) - 1, min(PARTNERS, len(near))).astype(int))].tolist():
            yield j, k


def solve(own: Sequence[Step], told: Sequence[Step], middles: Array, poses_m: Array) -> tuple[Array, Array]:
    """Moves (N, 4, 4) of pictures, with middles (N, 3) m, and 1 sigma (N,) m of each if the others were known.

    own: the path's steps, which all hold; told: those of oysters; poses_m: (N,) m, 1 sigma of the path at each.
    """
    n, steps = len(middles), [*own, *told]
    start, to = (np.array([getattr(step, name) for step in steps], dtype=int) for name in ("start", "to"))
    here, there = (np.array([getattr(step, name) for step in steps]).reshape(-1, 3) for name in ("here", "there"))
    sigmas = np.array([(step.sigma_m, step.sigma_m, step.sigma_rad, step.sigma_m) for step in steps]).reshape(-1, 4)
    of_poses = np.concatenate([poses_m, poses_m, np.full(n, HEADING_RAD), poses_m])

    # Unknown are x, y, heading and z of all pictures. A point at (x, y) from a picture's middle moves by its shift, and
    # by (-y, x) times its turn.
    ones = np.ones(len(steps))
    shifts = _differences(start, to, ones, ones, n)
    arms, there_arms = here - middles[to], there - middles[start]
    along_x = _differences(start, to, -there_arms[:, 1], -arms[:, 1], n)
    along_y = _differences(start, to, there_arms[:, 0], arms[:, 0], n)
    rows = block_array(
        [
            [shifts, None, along_x, None],
            [None, shifts, along_y, None],
            [None, None, shifts, None],
            [None, None, None, shifts],
        ]
    )
    system = csr_array(vstack([rows, eye_array(4 * n)]))
    apart = there - here
    wanted = np.concatenate([apart[:, 0], apart[:, 1], [step.turn_rad for step in steps], apart[:, 2], np.zeros(4 * n)])
    weights = ones
    for leniency in GRADUAL.tolist():
        information = np.concatenate([(weights[:, None] / sigmas**2).T.ravel(), of_poses**-2.0])
        weighed = system.T @ diags_array(information)
        normal = (weighed @ system).tocsc()
        solution = np.asarray(spsolve(normal, weighed @ wanted))
        off = ((system @ solution - wanted)[: 4 * len(steps)].reshape(4, -1).T / sigmas)[:, :3]
        weights = (1.0 + (off**2).sum(axis=1) / (leniency * OUTLIER) ** 2) ** -2.0
        weights[: len(own)] = 1.0
    x, y, heading, z = solution.reshape(4, n)
    moves = np.tile(np.eye(4), (n, 1, 1))
    moves[:, :3, :3] = Rotation.from_euler("z", heading[:, None]).as_matrix()
    moves[:, :3, 3] = middles + np.column_stack([x, y, z]) - (moves[:, :3, :3] @ middles[..., None])[..., 0]
    return moves, normal.diagonal()[:n] ** -0.5


def _differences(start: Array, to: Array, there: Array, here: Array, n: int) -> csr_array:
    """(M, N): in each row what `to` has, times `here` (M,), less what `start` has, times `there` (M,)."""
    rows = np.tile(np.arange(len(start)), 2)
    return coo_array((np.concatenate([-there, here]), (rows, np.concatenate([start, to]))), (len(start), n)).tocsr()
