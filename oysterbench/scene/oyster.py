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

SLICES = 30
POINTS_PER_VALVE = 12
CONTROL_POINTS = 7
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
    ridges: float  # number of growth ridges
    ridge_height: float
    folds: float  # number of radial folds across a valve
    fold_height: float  # at the bill


def draw_form(generator: np.random.Generator) -> ShellForm:
    """A form of Crassostrea virginica, about 3 : 2 : 1 in height, length, width."""
    uniform = generator.uniform
    return ShellForm(
        length=uniform(0.52, 0.80),
        cup=uniform(0.16, 0.26),
        lid=uniform(0.03, 0.09),
        umbo=uniform(0.50, 0.75),
        bill=uniform(0.32, 0.50),
        curve=uniform(-0.16, 0.16),
        bend=uniform(-0.07, 0.07),
        ridges=uniform(5.0, 9.0),
        ridge_height=uniform(0.010, 0.022),
        folds=uniform(2.0, 5.0),
        fold_height=uniform(0.0, 0.035),
    )


def build_shell(form: ShellForm, generator: np.random.Generator) -> Mesh:
    """Watertight mesh of a shell of height 1; `generator` gives its irregularities."""
    # Slices are denser towards both ends, where the outline turns.
    height = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, SLICES + 2))
    rings = np.stack([_slice(form, s, noise) for s, noise in _irregular(height[1:-1], generator)])
    umbo = np.array([0.0, 0.0, 0.0])
    bill = np.append([1.0], rings[-1].mean(axis=0)[1:])
    vertices = np.concatenate([umbo[None], rings.reshape(-1, 3), bill[None]])
    vertices[:, 0] += _bill_outline(vertices, form)
    return build_mesh(vertices, _skin(len(rings), rings.shape[1]))


def _irregular(heights: Array, generator: np.random.Generator) -> list[tuple[float, Array]]:
    """Each slice's height with its (3, CONTROL_POINTS) perturbations, correlated from slice to slice."""
    noise = generator.standard_normal((len(heights), 3, CONTROL_POINTS))
    for i in range(1, len(noise)):
        noise[i] = 0.8 * noise[i - 1] + 0.6 * noise[i]
    return list(zip(heights, noise, strict=True))


def _slice(form: ShellForm, s: float, noise: Array) -> Array:
    """Closed ring (2 * POINTS_PER_VALVE, 3) at height s: the left valve from -y to +y, then the right one back."""
    peak = form.umbo / (form.umbo + form.bill)
    outline = (s / peak) ** form.umbo * ((1 - s) / (1 - peak)) ** form.bill
    half = 0.5 * form.length * outline * (1 + 0.04 * noise[0, 0])
    phase = form.ridges * s + 0.12 * noise[0, 1]
    # Each year's growth overlaps the last like a roof tile: a slow rise, then a step.
    ridge = form.ridge_height * (phase - np.floor(phase)) * min(1.0, 6.0 * min(s, 1 - s))
    body = np.sin(np.pi * s**0.75) ** 0.8
    across = np.linspace(-1, 1, CONTROL_POINTS)
    arch = (1 - across**2) ** 0.6
    fold = form.fold_height * s**2 * np.cos(np.pi * form.folds * across) * (1 - across**4)
    left = -(form.cup * body * arch) - ridge + fold + 0.012 * noise[1] * body
    right = form.lid * body * arch + ridge + fold + 0.010 * noise[2] * body
    thickness = 0.035 * min(1.0, 5.0 * min(s, 1 - s))
    right = np.maximum(right, left + 2 * thickness)
    rim = 0.5 * (left[[0, -1]] + right[[0, -1]])
    left[[0, -1]], right[[0, -1]] = rim, rim
    middle_y, middle_z = form.curve * np.sin(np.pi * s), form.bend * np.sin(np.pi * s)
    parameter = np.linspace(0, 1, POINTS_PER_VALVE + 1)
    lower = _spline(across * half, left)(parameter)[:-1]
    upper = _spline(across[::-1] * half, right[::-1])(parameter)[:-1]
    ring = np.concatenate([lower, upper])
    return np.column_stack([np.full(len(ring), s), ring[:, 0] + middle_y, ring[:, 1] + middle_z])


def _spline(y: Array, z: Array) -> BSpline:
    """Clamped cubic B-spline over [0, 1] with control points (y, z)."""
    inner = np.linspace(0, 1, len(y) - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    return BSpline(knots, np.column_stack([y, z]), DEGREE)


def _bill_outline(vertices: Array, form: ShellForm) -> Array:
    """Shift along x (V,) that waves the slices, so that growth lines are not straight across the shell."""
    x, y = vertices[:, 0], vertices[:, 1]
    return -0.25 * x * (1 - x) * (2 * y / form.length) ** 2


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
