"""Shells of the eastern oyster: stacked slices of two B-splines each, skinned into a watertight mesh.

The shell's own frame: origin at the umbo (hinge), x to the bill (shell height, 1 unit), y along the shell's length,
z through its width; the cupped left valve lies at -z, the flat right valve at +z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from oysterbench.scene.mesh import Mesh, build_mesh

Array = NDArray[np.float64]

SLICES = 36
POINTS_PER_VALVE = 14
CONTROL_POINTS = 9
EMPTY_SHARE = 0.25  # dead valves among the shells of a reef
DEGREE = 3


@dataclass(frozen=True)
class ShellForm:
    """Parameters of a shell, in units of its height (umbo to bill)."""

    length: float  # widest extent along y
    cup: float  # depth of the left valve
    lid: float  # rise of the right valve
    umbo: float  # exponent of the outline at the hinge: small is blunt, large is pointed
    bill: float  # exponent of the outline at the bill
    curve: float  # sideways bend of the midline
    bend: float  # bend of the plane between the valves
    twist: float  # turn about x from umbo to bill, rad
    ridges: float  # number of growth ridges
    ridge_height: float
    folds: float  # number of radial folds across a valve
    fold_height: float  # at the bill
    roughness: float  # of outline and valves
    empty: bool  # a dead left valve, open where the right one was


def draw_form(generator: np.random.Generator) -> ShellForm:
    """A form of Crassostrea virginica, about 3 : 2 : 1 in height, length, width."""
    uniform = generator.uniform
    return ShellForm(
        length=uniform(0.50, 0.82),
        cup=uniform(0.12, 0.22),
        lid=uniform(0.00, 0.05),
        umbo=uniform(0.45, 0.75),
        bill=uniform(0.26, 0.48),
        curve=uniform(-0.20, 0.20),
        bend=uniform(-0.10, 0.10),
        twist=uniform(-0.5, 0.5),
        ridges=uniform(4.0, 8.0),
        ridge_height=uniform(0.018, 0.036),
        folds=uniform(2.0, 5.0),
        fold_height=uniform(0.01, 0.06),
        roughness=uniform(0.7, 1.5),
        empty=bool(uniform() < EMPTY_SHARE),
    )


def build_shell(form: ShellForm, generator: np.random.Generator) -> Mesh:
    """Watertight mesh of a shell of height 1; `generator` gives its irregularities."""
    # Slices are denser towards both ends, where the outline turns.
    heights = (0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, SLICES + 2)))[1:-1]
    noise = generator.standard_normal((SLICES, 3, CONTROL_POINTS))
    for i in range(1, SLICES):
        noise[i] = 0.85 * noise[i - 1] + np.sqrt(1 - 0.85**2) * noise[i]  # neighbouring slices are alike
    rings = np.stack([_slice(form, s, n) for s, n in zip(heights, form.roughness * noise, strict=True)])
    rings[..., 0] += _growth_line(rings, form, generator)
    umbo = np.zeros((1, 3))
    bill = rings[-1].mean(axis=0, keepdims=True)
    vertices = np.concatenate([umbo, rings.reshape(-1, 3), bill])
    vertices[:, 0] /= vertices[:, 0].max()
    return build_mesh(vertices, _skin(len(rings), rings.shape[1]))


def _slice(form: ShellForm, s: float, noise: Array) -> Array:
    """Closed ring (2 * POINTS_PER_VALVE, 3) at height s: the left valve from -y to +y, then the right one back."""
    peak = form.umbo / (form.umbo + form.bill)
    outline = (s / peak) ** form.umbo * ((1 - s) / (1 - peak)) ** form.bill
    ends = min(1.0, 6.0 * min(s, 1 - s))
    phase = form.ridges * s + 0.10 * noise[0, 1]
    # Each season's growth overlaps the last like a roof tile: a slow rise, then a step.
    tile = (phase - np.floor(phase)) * ends
    half = 0.5 * form.length * outline * (1 + 1.6 * form.ridge_height * (tile - 0.5))
    left_edge, right_edge = half * (1 + 0.09 * noise[0, 0]), half * (1 + 0.09 * noise[0, 2])
    body = np.sin(np.pi * s**0.75) ** 0.8
    across = np.linspace(-1, 1, CONTROL_POINTS)
    y = np.where(across < 0, left_edge, right_edge) * across
    arch = (1 - across**2) ** 0.6
    fold = form.fold_height * s**2 * np.cos(np.pi * form.folds * across + form.ridges) * ends
    left = -form.cup * body * arch - form.ridge_height * tile * arch + fold + 0.016 * noise[1] * body
    right = form.lid * body * arch + form.ridge_height * tile * arch + fold + 0.012 * noise[2] * body
    if form.empty:
        right = left + 0.05 * arch * body
    right = np.maximum(right, left + 0.05 * ends * arch)
    rim = 0.5 * (left[[0, -1]] + right[[0, -1]])
    left[[0, -1]], right[[0, -1]] = rim, rim
    parameter = np.linspace(0, 1, POINTS_PER_VALVE + 1)
    lower = _spline(y, left)(parameter)[:-1]
    upper = _spline(y[::-1], right[::-1])(parameter)[:-1]
    ring = np.concatenate([lower, upper])
    turn = form.twist * (s - 0.5)
    ring_y = np.cos(turn) * ring[:, 0] - np.sin(turn) * ring[:, 1] + form.curve * np.sin(np.pi * s)
    ring_z = np.sin(turn) * ring[:, 0] + np.cos(turn) * ring[:, 1] + form.bend * np.sin(np.pi * s)
    return np.column_stack([np.full(len(ring), s), ring_y, ring_z])


def _growth_line(rings: Array, form: ShellForm, generator: np.random.Generator) -> Array:
    """Shift along x (S, P) that arches the slices and frays the bill, so that growth lines are not straight."""
    x, y = rings[..., 0], rings[..., 1] / form.length
    phases = generator.uniform(0, 2 * np.pi, 3)
    frays = sum(np.sin(f * np.pi * y + phase) / f for f, phase in zip((2.0, 5.0, 9.0), phases, strict=True))
    return x * (0.05 * form.roughness * frays * x**2 - 0.5 * (1 - x) * y**2)


def _spline(y: Array, z: Array) -> BSpline:
    """Clamped cubic B-spline over [0, 1] with control points (y, z)."""
    inner = np.linspace(0, 1, len(y) - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    return BSpline(knots, np.column_stack([y, z]), DEGREE)


def _skin(rings: int, points: int) -> NDArray[np.int64]:
    """Faces (F, 3) over `rings` closed rings of `points` vertices, with a pole before and a pole after them."""
    here = np.arange(points)
    there = (here + 1) % points
    start = 1 + points * np.arange(rings - 1)[:, None]
    quads = np.stack([start + here, start + there, start + points + there, start + points + here], axis=-1)
    sides = np.concatenate([quads[..., [0, 1, 2]].reshape(-1, 3), quads[..., [0, 2, 3]].reshape(-1, 3)])
    last = 1 + points * (rings - 1)
    first_cap = np.column_stack([np.zeros(points, int), 1 + there, 1 + here])
    last_cap = np.column_stack([np.full(points, 1 + points * rings), last + here, last + there])
    return np.concatenate([first_cap, sides, last_cap])
