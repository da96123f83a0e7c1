"""The body of a vehicle, for cameras that see it: a BlueROV2-class frame from boxes and tubes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.recipe import RigRecipe
from oysterbench.scene.mesh import Mesh, build_mesh, join_meshes

Array = NDArray[np.float64]

BLUE, BLACK, GREY, CLEAR = (0.02, 0.10, 0.42), (0.025, 0.025, 0.03), (0.30, 0.31, 0.32), (0.16, 0.19, 0.21)
FLOAT_BLUE = (0.05, 0.22, 0.55)
TUBE_SIDES = 24


def build_vehicle(rig: RigRecipe) -> Mesh | None:
    """The rig's body in base_link, m, with albedos as marks; None for a rig without one.

    Sizes after the maker's drawing of the BlueROV2: 457 x 338 x 254 mm, a 4-inch and a 3-inch tube along x.
    """
    if rig.vehicle == "none":
        return None
    parts = [
        *(_box((0.0, side * 0.163, -0.02), (0.44, 0.012, 0.20), BLACK) for side in (-1, 1)),
        _box((0.0, 0.0, -0.122), (0.42, 0.30, 0.010), BLACK),
        *(_box((x, side * 0.105, 0.088), (0.185, 0.10, 0.066), FLOAT_BLUE) for side in (-1, 1) for x in (-0.10, 0.10)),
        _tube((-0.16, 0.0, 0.035), (0.15, 0.0, 0.035), 0.057, GREY),
        _tube((0.15, 0.0, 0.035), (0.185, 0.0, 0.035), 0.052, CLEAR),
        _tube((-0.12, 0.0, -0.072), (0.12, 0.0, -0.072), 0.044, GREY),
        *(_box((x, 0.0, -0.02), (0.012, 0.32, 0.03), BLUE) for x in (-0.20, 0.20)),
    ]
    for x, y, heading in ((0.14, 0.11, 45), (0.14, -0.11, -45), (-0.14, 0.11, -45), (-0.14, -0.11, 45)):
        along = np.array([np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading)), 0.0]) * 0.03
        centre = np.array([x, y, -0.075])
        parts.append(_tube(centre - along, centre + along, 0.036, BLACK))
    parts += [_tube((0.0, y, 0.02), (0.0, y, 0.09), 0.036, BLACK) for y in (-0.13, 0.13)]
    parts += [_tube((0.19, y, -0.10), (0.225, y, -0.105), 0.02, GREY) for y in (-0.12, 0.12)]  # lamps
    return join_meshes(parts)


def _box(centre: tuple[float, ...], size: tuple[float, ...], colour: tuple[float, ...]) -> Mesh:
    """A box with faces of their own corners, so that its edges stay hard."""
    corners: list[Array] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            middle = np.eye(3)[axis] * sign
            square = np.array([middle + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
            start = len(corners) * 4
            corners.append(square if sign > 0 else square[::-1])
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    vertices = np.concatenate(corners) * np.array(size) / 2 + np.array(centre)
    return build_mesh(vertices, np.array(faces), np.tile(colour, (len(vertices), 1)))


def _tube(start: Array | tuple[float, ...], end: Array | tuple[float, ...], radius: float, colour: tuple) -> Mesh:
    """A closed tube between two points."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    turn = 2 * np.pi * np.arange(TUBE_SIDES) / TUBE_SIDES
    ring = radius * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * other)
    n = TUBE_SIDES
    # Rings twice at each end: one for the wall's normals, one for the lid's.
    vertices = np.concatenate([start + ring, end + ring, start + ring, end + ring, [start], [end]])
    k, after = np.arange(n), (np.arange(n) + 1) % n
    wall = np.concatenate([np.stack([k, after, after + n], 1), np.stack([k, after + n, k + n], 1)])
    lids = np.concatenate(
        [
            np.stack([np.full(n, 4 * n), after + 2 * n, k + 2 * n], 1),
            np.stack([np.full(n, 4 * n + 1), k + 3 * n, after + 3 * n], 1),
        ]
    )
    return build_mesh(vertices, np.concatenate([wall, lids]), np.tile(colour, (len(vertices), 1)))
