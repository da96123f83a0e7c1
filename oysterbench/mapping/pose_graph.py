"""Alignment of the images of a dive to each other: a pose graph of their shifts and rotations about the vertical.

Between consecutive images a path errs by millimetres, between two passes over the same ground by as much as the
distance between oysters. Where two images overlap, their oysters determine their relative position
(`mapping.registration`). The moves of all images are the least-squares solution of these steps, of the path's own steps
from each image to the next, and of its poses; the problem is linear, as headings err by only a few degrees. Steps from
wrongly matched oysters contradict the others and lose their weight by the function of Geman and McClure (1985), which
is introduced gradually (graduated non-convexity, Yang et al. 2020).
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
"""Maximum number of earlier images that an image is registered with, spread evenly over all that overlap with it."""
ROUNDS = ("images registered", "images registered again")
"""Rounds of registration, by what each reports as counted: a pair that is out of reach along the path may be within
reach once the images are aligned."""
OWN_STEP = 0.02  # minimum 1 sigma of the path's step from an image to the next, relative to its length
OWN_TURN_RAD = 0.002  # minimum 1 sigma of the rotation between them
HEADING_RAD = 0.05  # 1 sigma of the path's heading
LEAST_SPREAD_M = 0.5  # RMS distance of the vehicle from the middle of its path, below which the path is not rotated
UNEVEN_M = 0.003  # added 1 sigma of a step between two images, from errors of their tilts and depths
UNEVEN_RAD = 0.003
OUTLIER = 3.0  # sigma, where a step starts to lose its weight
GRADUAL = np.concatenate([np.geomspace(64.0, 1.0, 13), np.ones(4)])
"""Factors on OUTLIER, one for each successive solution."""

Picture = Sequence[Patch]

Progress = Callable[[str, int, int], None]
"""Called with what is counted, the number done, and the total."""


@dataclass(frozen=True)
class Step:
    """A constraint between two images, in coordinates along the path: the point `here` (3,) m of image `to` coincides
    with the point `there` (3,) m of image `start`, about which `to` is rotated by turn_rad; each with its 1 sigma."""

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
    """Align all images, in time order. Returns their oysters, moved, and the moves (N, 4, 4) of the images, each about
    the vertical.

    places: (N, 3) m, positions of the vehicle. If the path is certain to within FINEST_M, nothing is moved. An image
    without any registration is as uncertain as the path's own steps from the nearest image that has one, or as its
    pose if that is less. An image without oysters moves like those before and after it.
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
    """Least-squares transform (4, 4), about the vertical, that aligns the moved places (N, 3) m with those of the path.

    Oysters determine how images lie relative to each other; where the whole lies, only the path as a whole can say: its
    headings, which constrain each image, err differently from its positions. If the vehicle hardly moved, there is no
    rotation.
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
    """Moves (N, 4, 4) of all images, at places (N, 3) m, from the moves (M, 4, 4) of some: interpolated between the one
    before and the one after by the number of images between them; at the ends, those of the nearest."""
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
    """Places (N, 3) m, each after its move (N, 4, 4)."""
    return np.asarray((moves[:, :3, :3] @ places[..., None])[..., 0] + moves[:, :3, 3])


def _registered(
    pictures: Sequence[Picture],
    moves: Array,
    but: set[tuple[int, int]],
    settings: MapSettings,
    progress: Callable[[int, int], None],
) -> Iterator[Step]:
    """Yield the steps between images that overlap after their moves, except pairs that are already known."""
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
    """The path's steps, with larger sigmas if the registrations of consecutive images contradict them."""
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
    """Yield pairs of images (earlier, later) where enough oysters of the later lie within the extent of the earlier."""
    centres = [np.array([patch.centre[:2] for patch in picture]) for picture in pictures]
    low, high = (np.array([edge(one, axis=0) for one in centres]).reshape(-1, 2) for edge in (np.min, np.max))
    for k, own in enumerate(centres):
        near = np.flatnonzero(((low[:k] < high[k]) & (high[:k] > low[k])).all(axis=1))
        inside = ((own >= low[near, None]) & (own <= high[near, None])).all(axis=2).sum(axis=1)
        near = near[inside >= FEWEST]
        for j in near[np.unique(np.linspace(0, len(near) - 1, min(PARTNERS, len(near))).astype(int))].tolist():
            yield j, k


def solve(own: Sequence[Step], told: Sequence[Step], middles: Array, poses_m: Array) -> tuple[Array, Array]:
    """Solve for the moves (N, 4, 4) of images with middles (N, 3) m, and 1 sigma (N,) m of each, given the others.

    own: the path's steps, none of which is an outlier; told: those from oysters; poses_m: (N,) m, 1 sigma of the path's
    pose at each image
    """
    n, steps = len(middles), [*own, *told]
    start, to = (np.array([getattr(step, name) for step in steps], dtype=int) for name in ("start", "to"))
    here, there = (np.array([getattr(step, name) for step in steps]).reshape(-1, 3) for name in ("here", "there"))
    sigmas = np.array([(step.sigma_m, step.sigma_m, step.sigma_rad, step.sigma_m) for step in steps]).reshape(-1, 4)
    of_poses = np.concatenate([poses_m, poses_m, np.full(n, HEADING_RAD), poses_m])

    # The unknowns are x, y, heading and z of all images. A point at (x, y) from an image's middle moves by the image's
    # shift plus (-y, x) times its rotation.
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
    """Sparse matrix (M, N) whose row k gives here[k] times the value of to[k] minus there[k] times that of start[k]."""
    rows = np.tile(np.arange(len(start)), 2)
    return coo_array((np.concatenate([-there, here]), (rows, np.concatenate([start, to]))), (len(start), n)).tocsr()
