"""Masks as polygons along the borders of their pixels, and polygons as masks; each conversion inverts the other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Corner = tuple[int, int]

BORDERS = (
    ((-1, 0), (0, 0), (1, 0)),
    ((0, 1), (1, 0), (1, 1)),
    ((1, 0), (1, 1), (0, 1)),
    ((0, -1), (0, 1), (0, 0)),
)
"""Neighbours of a pixel: offset (rows, columns), and the corners (x, y) between which the common border runs."""


def mask_polygons(mask: NDArray[np.bool_]) -> list[list[float]]:
    """Polygons [x0, y0, x1, y1, ...] around a mask (H, W); pixel (row, column) covers [column, column + 1) and so on.

    One polygon per piece (pixels that touch only at corners belong to different pieces). A hole is cut out of its piece
    by a slit of zero width along a row of corners.
    """
    loops = _loops(mask)
    outer = [loop for loop in loops if _area(loop) > 0]
    holes = [loop for loop in loops if _area(loop) < 0]
    # From left to right: a hole's slit may then end on a hole that is part of the outline already.
    for hole in sorted(holes, key=lambda loop: min(loop)):
        _cut(outer, hole)
    return [[float(value) for corner in _straight(loop) for value in corner] for loop in outer]


def _loops(mask: NDArray[np.bool_]) -> list[list[Corner]]:
    """Closed paths (x, y) along the borders, with the mask on their right as seen with y down: outlines clockwise."""
    padded = np.pad(mask.astype(bool), 1)
    height, width = mask.shape
    edges: list[tuple[Corner, Corner]] = []
    for (down, right), (x0, y0), (x1, y1) in BORDERS:
        bare = mask & ~padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]
        edges += [((x + x0, y + y0), (x + x1, y + y1)) for y, x in np.argwhere(bare).tolist()]
    onward: dict[Corner, list[Corner]] = {}
    for start, end in edges:
        onward.setdefault(start, []).append(end)
    loops = []
    while onward:
        start = next(iter(onward))
        loop, before, here_now = [start], start, _take(onward, start, None)
        while here_now != start:
            loop.append(here_now)
            before, here_now = here_now, _take(onward, here_now, before)
        loops.append(loop)
    return loops


def _take(onward: dict[Corner, list[Corner]], here: Corner, before: Corner | None) -> Corner:
    """Remove and return the next corner of the border; where two pixels share a corner, the one that stays with the
    same pixel (a right turn)."""
    ends = onward[here]
    if len(ends) > 1 and before is not None:
        dx, dy = here[0] - before[0], here[1] - before[1]
        right = (here[0] - dy, here[1] + dx)
        end = right if right in ends else ends[0]
        ends.remove(end)
    else:
        end = ends.pop()
    if not ends:
        del onward[here]
    return end


def _area(loop: list[Corner]) -> float:
    """Signed area of a loop: positive for outlines, negative for holes."""
    x, y = np.array(loop, dtype=float).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _cut(outer: list[list[Corner]], hole: list[Corner]) -> None:
    """Join a hole to the outline on its left, along the row of its leftmost corner."""
    start = min(range(len(hole)), key=lambda k: hole[k])
    x, y = hole[start]
    reach, which, at = -1, -1, -1
    for k, loop in enumerate(outer):
        for j, (cx, cy) in enumerate(loop):
            if cy == y and reach < cx < x:
                reach, which, at = cx, k, j
    around = hole[start:] + hole[: start + 1]
    loop = outer[which]
    outer[which] = loop[: at + 1] + around + loop[at:]


def _straight(loop: list[Corner]) -> list[Corner]:
    """The corners at which a path turns."""
    kept = []
    for k, (x, y) in enumerate(loop):
        (ax, ay), (bx, by) = loop[k - 1], loop[(k + 1) % len(loop)]
        if (x - ax) * (by - y) != (bx - x) * (y - ay) or (x - ax) * (bx - x) + (y - ay) * (by - y) < 0:
            kept.append((x, y))
    return kept


def rasterise(polygon: ArrayLike, height: int, width: int) -> NDArray[np.bool_]:
    """Mask (H, W) of a polygon (N, 2), x and y in px; pixel (row, column) covers [column, column + 1) and so on.

    A pixel is inside where its centre is (even-odd rule), so that polygons along the borders of pixels
    (`mask_polygons`) give back their mask, and polygons that touch share no pixel.
    """
    corners = np.asarray(polygon, dtype=float).reshape(-1, 2)
    mask = np.zeros((height, width), dtype=bool)
    # Only the polygon's bounding box is processed: most are small.
    (left, top), (right, bottom) = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    left, top = int(np.clip(left, 0, width)), int(np.clip(top, 0, height))
    right, bottom = int(np.clip(right, 0, width)), int(np.clip(bottom, 0, height))
    if left >= right or top >= bottom:
        return mask
    flips = np.zeros((bottom - top, right - left + 1), dtype=np.uint8)
    for (x0, y0), (x1, y1) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True):
        low, high = min(y0, y1), max(y0, y1)
        rows = np.arange(max(top, math.ceil(low - 0.5)), min(bottom, math.ceil(high - 0.5)))
        if len(rows):  # rows whose centre line the edge crosses
            x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
            flips[rows - top, np.clip(np.ceil(x - 0.5), left, right).astype(int) - left] ^= 1
    mask[top:bottom, left:right] = np.bitwise_xor.accumulate(flips[:, :-1], axis=1)
    return mask
