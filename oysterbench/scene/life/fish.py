"""Meshes of estuarine fish, of length 1 along x, nose forward, back up, bent according to a phase of the tail beat.

Marks: position along the body from nose (0) to tail (1), position from belly (-1) to back (1), and part: FIN, EYE, or a
coat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from oysterbench.core.geometry import Array
from oysterbench.scene.life.bodies import ball, blade, skin
from oysterbench.scene.mesh import Mesh, build_mesh, join_meshes

PHASES = 12  # of a tail beat, each with its own mesh
RINGS, SIDES = 15, 12
FIN, EYE, SILVER, BARRED, MOTTLED = 0.0, 1.0, 2.0, 3.0, 4.0
WAVELENGTH = 0.95  # of the wave that runs down the body, in lengths (Videler & Hess 1984: mackerel 1.0, saithe 0.9)
BEAT = (0.02, -0.08, 0.16)  # its half amplitude as a polynomial along the body (ibid., fitted: 0.1 at the tail)
STRIDE = 0.65  # lengths travelled per beat (Bainbridge 1958; Videler & Wardle 1991: 0.6 to 0.8)


@dataclass(frozen=True)
class Form:
    """A species: half height and half width of the body over the position along it, in lengths; its fins; its coat.

    tail: half height of the tail fin, and how deeply its middle is notched. dorsals, anals: (from, to, height) each.
    pectoral: length of the two side fins. stiff: share of the full beat that the body makes.
    """

    place: tuple[float, ...]
    height: tuple[float, ...]
    width: tuple[float, ...]
    coat: float
    tail: tuple[float, float]
    dorsals: tuple[tuple[float, float, float], ...]
    anals: tuple[tuple[float, float, float], ...]
    pectoral: float
    stiff: float = 1.0


FORMS = {
    "silverside": Form(
        (0.0, 0.08, 0.22, 0.45, 0.65, 0.84),
        (0.008, 0.042, 0.068, 0.075, 0.055, 0.024),
        (0.006, 0.028, 0.042, 0.043, 0.030, 0.009),
        SILVER,
        (0.085, 0.75),
        ((0.45, 0.50, 0.045), (0.58, 0.70, 0.055)),
        ((0.52, 0.72, 0.055),),
        0.11,
    ),
    "croaker": Form(
        (0.0, 0.06, 0.20, 0.38, 0.58, 0.82),
        (0.015, 0.072, 0.125, 0.142, 0.098, 0.038),
        (0.012, 0.045, 0.068, 0.070, 0.045, 0.014),
        BARRED,
        (0.105, 0.15),
        ((0.28, 0.46, 0.080), (0.47, 0.74, 0.055)),
        ((0.58, 0.68, 0.070),),
        0.17,
    ),
    "toadfish": Form(
        (0.0, 0.05, 0.18, 0.34, 0.60, 0.88),
        (0.040, 0.085, 0.108, 0.098, 0.062, 0.028),
        (0.055, 0.120, 0.145, 0.110, 0.055, 0.016),
        MOTTLED,
        (0.060, -0.3),
        ((0.34, 0.86, 0.045),),
        ((0.52, 0.86, 0.038),),
        0.20,
        0.5,
    ),
}


def build_fish(species: str, phase: float) -> Mesh:
    """Build a fish of a species at a phase (rad) of its tail beat; the triangles are the same for every phase."""
    form = FORMS[species]
    mesh = join_meshes([_body(form), *_fins(form), *_eyes(form)])
    points = mesh.vertices.astype(float)
    along = np.clip(0.5 - points[:, 0], 0.0, 1.0)
    reach = BEAT[0] + BEAT[1] * along + BEAT[2] * along**2
    points[:, 1] += form.stiff * reach * np.sin(2 * np.pi * along / WAVELENGTH - phase)
    return build_mesh(points, mesh.faces, mesh.marks)


def _half(form: Form, along: Array) -> tuple[Array, Array]:
    """Half height and half width (N,) of the body at positions (N,) along it."""
    height, width = (PchipInterpolator(form.place, values)(along) for values in (form.height, form.width))
    return height, width


def _body(form: Form) -> Mesh:
    along = form.place[-1] * (1 - np.cos(np.linspace(0.12, np.pi, RINGS))) / 2
    height, width = _half(form, along)
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    # Flanks are flat and the back is narrow: |y| = |cos|^0.8, not |cos|.
    y = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** 0.8
    z = np.sin(turn)
    rings = np.stack(
        [
            np.broadcast_to((0.5 - along)[:, None], (RINGS, SIDES)),
            width[:, None] * y,
            height[:, None] * z,
        ],
        axis=-1,
    )
    marks = np.stack(np.broadcast_arrays(along[:, None], z[None, :], np.array(form.coat)), axis=-1)
    ends = np.array([[0.5, 0.0, 0.0], [0.5 - form.place[-1] - 0.01, 0.0, 0.0]])
    return skin(rings, ends, marks, np.array([[0.0, 0.0, form.coat], [form.place[-1], 0.0, form.coat]]))


def _fins(form: Form) -> list[Mesh]:
    fins = [_tail(form)]
    for side, some in ((1.0, form.dorsals), (-1.0, form.anals)):
        fins += [_fin(form, side, *one) for one in some]
    for side in (1.0, -1.0):
        fins.append(_pectoral(form, side))
    return fins


def _tail(form: Form) -> Mesh:
    """Tail fin with a notched rear edge (rounded for a negative cut)."""
    half, cut = form.tail
    start = form.place[-1] - 0.03
    height = float(_half(form, np.array([start]))[0][0])
    share = np.linspace(-1, 1, 7)
    root = np.column_stack([np.full(7, 0.5 - start), np.zeros(7), 0.8 * height * share])
    reach = (1.0 - start) * (1 - cut * (1 - np.abs(share))) if cut > 0 else (1 - start) * (1 + cut * share**2)
    tip = np.column_stack([0.5 - start - reach, np.zeros(7), half * share])
    marks = [np.column_stack([np.full(7, place), share, np.full(7, FIN)]) for place in (start, 1.0)]
    return blade(root, tip, np.array([0.0, 0.005, 0.0]), *marks)


def _fin(form: Form, side: float, begin: float, end: float, height: float) -> Mesh:
    """Fin on the back (side 1) or under the belly (side -1), highest near its front and leaning back."""
    place = np.linspace(begin, end, 6)
    body = _half(form, place)[0]
    rise = height * np.array([0.55, 1.0, 0.95, 0.8, 0.65, 0.4])
    root = np.column_stack([0.5 - place, np.zeros(6), side * 0.92 * body])
    tip = np.column_stack([0.5 - place - 0.6 * rise, np.zeros(6), side * (0.92 * body + rise)])
    marks = np.column_stack([place, np.full(6, side), np.full(6, FIN)])
    return blade(root, tip, np.array([0.0, 0.004, 0.0]), marks, marks)


def _pectoral(form: Form, side: float) -> Mesh:
    """Side fin behind the gills, spread outwards and back."""
    place = form.place[2] + 0.04
    height, width = (float(value[0]) for value in _half(form, np.array([place])))
    share = np.linspace(-1, 1, 5)
    root = np.column_stack(
        [np.full(5, 0.5 - place), np.full(5, side * 0.9 * width), height * (-0.25 + 0.12 * share)],
    )
    reach = form.pectoral * (1 - 0.35 * share**2)
    tip = root + np.column_stack([-0.9 * reach, side * 0.30 * reach, 0.25 * form.pectoral * share - 0.10 * reach])
    marks = np.column_stack([np.full(5, place), -np.ones(5), np.full(5, FIN)])
    return blade(root, tip, np.array([0.003, 0.003, 0.0]), marks, marks)


def _eyes(form: Form) -> list[Mesh]:
    place = form.place[1] + 0.025
    height, width = (float(value[0]) for value in _half(form, np.array([place])))
    size = min(0.022, 0.38 * height)
    eyes = []
    for side in (1.0, -1.0):
        up = 0.85 if form.coat == MOTTLED else 0.25
        out = width * (0.75 if form.coat == MOTTLED else 0.9)
        centre = np.array([0.5 - place, side * out, up * height])
        eyes.append(ball(centre, np.array([size, 0.35 * size, size]), (place, up, EYE), 8))
    return eyes
