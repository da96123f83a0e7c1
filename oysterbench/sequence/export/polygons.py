"""Masks as polygons along the borders of their pixels, so that rasterising gives the mask back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Corner = tuple[int, int]


def mask_polygons(mask: NDArray[np.bool_]) -> list[list[float]]:
    """Polygons [x0, y0, x1, y1, ...] around a mask (H, W); pixel (row, column) covers [column, column + 1) and so on.

    One polygon per piece (pixels that touch at corners only are of different pieces). A hole is cut out of its piece
    by a slit of no width along a row of corners.
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
    here = padded[1:-1, 1:-1]
    rows, columns = (index.tolist() for index in np.nonzero(here & ~padded[:-2, 1:-1]))  # top borders, to the right
    edges = [((x, y), (x + 1, y)) for y, x in zip(rows, columns, strict=True)]
    rows, columns = (index.tolist() for index in np.nonzero(here & ~padded[1:-1, 2:]))  # right borders, down
    edges += [((x + 1, y), (x + 1, y + 1)) for y, x in zip(rows, columns, strict=True)]
    rows, columns = (index.tolist() for index in np.nonzero(here & ~padded[2:, 1:-1]))  # bottom borders, to the left
    edges += [((x + 1, y + 1), (x, y + 1)) for y, x in zip(rows, columns, strict=True)]
    rows, columns = (index.tolist() for index in np.nonzero(here & ~padded[1:-1, :-2]))  # left borders, up
    edges += [((x, y + 1), (x, y)) for y, x in zip(rows, columns, strict=True)]
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
    """Where the border goes on; at a corner that two pixels share, around the same pixel (a turn to the right)."""
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
    """Positive for outlines."""
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
