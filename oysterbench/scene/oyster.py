"""Shells of the eastern oyster: stacked slices of two B-splines each, skinned into a watertight mesh.

The shell's own frame: origin at the umbo (hinge), x to the bill (shell height, 1 unit), y along the shell's length,
z through its width; the cupped left valve lies at -z, the flat right valve at +z. The two splines of a slice are the
outsides of both valves for a closed shell, the outside and the inside for a single valve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh, build_mesh, join_meshes

SLICES = 44
POINTS = 18  # per spline of a slice
CONTROL_POINTS = 15
DEGREE = 3
STATES = ("live", "box", "left valve", "right valve")
LIVE_GAPE_RAD = (0.05, 0.11)
BOX_GAPE_RAD = (0.35, 1.15)
GAPING_SHARE = 0.25  # share of live oysters that gape
SCAR = (0.62, 0.22, 0.13, 0.17)  # muscle scar: centre along s and across, then its half axes


@dataclass(frozen=True)
class ShellShape:
    """Parameters of a shell, lengths in units of its height (umbo to bill)."""

    length: float  # widest extent along y
    cup: float  # depth of the left valve
    lid: float  # rise of the right valve
    wall: float  # thickness of the left valve at its middle; the right one has two thirds of it
    umbo: float  # exponent of the outline at the hinge: small is blunt, large is pointed
    bill: float  # exponent of the outline at the bill
    curve: float  # sideways bend of the midline
    bend: float  # bend of the plane between the valves
    twist: float  # turn about x from umbo to bill, rad
    ridges: float  # number of growth ridges
    ridge_height: float
    folds: float  # number of radial folds across a valve
    fold_height: float  # at the margin
    roughness: float  # of outline and valves
    gape: float  # angle between the valves, rad


@dataclass(frozen=True)
class Shell:
    """A shell of the library, of height 1: its mesh, its state and its measurements.

    extent: height, length and width of the closed shell or the single valve. volume: displaced volume, of the closed
    shell for a live oyster, of the shell material alone for a dead one.
    """

    mesh: Mesh
    state: str
    extent: tuple[float, float, float]
    volume: float


def draw_shape(generator: np.random.Generator, slenderness: float = 0.5, state: str = "live") -> ShellShape:
    """Draw a shape of Crassostrea virginica, about 3 : 2 : 1 in height, length, width (Galtsoff 1964, ch. 2).

    slenderness: 0 for the rounded, folded shells of hard ground, 1 for the long ones of clumps and soft bottom.
    """
    uniform = generator.uniform
    slender = float(np.clip(slenderness + 0.15 * generator.standard_normal(), 0.0, 1.0))
    gape = uniform(*LIVE_GAPE_RAD) * (uniform() < GAPING_SHARE)
    return ShellShape(
        length=(0.80 - 0.30 * slender) * float(np.exp(0.08 * generator.standard_normal())),
        cup=uniform(0.14, 0.22) + 0.04 * slender,
        lid=uniform(0.02, 0.08),
        wall=uniform(0.035, 0.07),
        umbo=uniform(0.48, 0.70) + 0.08 * slender,
        bill=uniform(0.26, 0.46),
        curve=uniform(-0.16, 0.16) * (0.5 + slender),
        bend=uniform(-0.10, 0.10),
        twist=uniform(-0.35, 0.35),
        ridges=uniform(6.0, 13.0),
        ridge_height=uniform(0.016, 0.036),
        folds=uniform(3.0, 6.5),
        fold_height=uniform(0.2, 1.0) * (0.035 - 0.025 * slender),
        roughness=uniform(0.7, 1.5),
        gape=uniform(*BOX_GAPE_RAD) if state == "box" else gape if state == "live" else 0.0,
    )


def build_shell(shape: ShellShape, generator: np.random.Generator, state: str = "live") -> Shell:
    """Build a watertight shell of height 1 in one of STATES; `generator` supplies its irregularities."""
    surface = _Surface(shape, generator)
    outside = {"left": surface.left(), "right": surface.right()}
    closed = surface.skin(outside["left"], outside["right"], (0.0, 0.0))
    if state == "left valve":
        mesh = surface.skin(outside["left"], surface.left_inside(), (0.0, 1.0))
    elif state == "right valve":
        mesh = surface.skin(surface.right_inside(), outside["right"], (1.0, 0.0))
    elif shape.gape == 0.0:
        mesh = closed
    else:
        left = surface.skin(outside["left"], surface.left_inside(), (0.0, 1.0))
        right = surface.skin(surface.right_inside(), outside["right"], (1.0, 0.0))
        # The valves are joined at the hinge: the right one rotates about y through the umbo, away from the left one.
        mesh = join_meshes([left, _turned(right, shape.gape)])
    whole = closed if state in ("live", "box") else mesh
    height, length, width = (float(extent) for extent in np.ptp(whole.vertices.astype(float), axis=0))
    return Shell(mesh, state, (height, length, width), _volume(closed if state == "live" else mesh))


def build_oyster(seed_generator: np.random.Generator, state: str, slenderness: float) -> tuple[ShellShape, Shell]:
    """Draw a shape from a random generator and build its shell."""
    shape = draw_shape(seed_generator, slenderness, state)
    return shape, build_shell(shape, seed_generator, state)


class _Surface:
    """Valves of a shape on a grid of slices s (S, 1) and positions a (1, C) across, from margin to margin."""

    def __init__(self, shape: ShellShape, generator: np.random.Generator) -> None:
        self.shape = shape
        # Slices are denser towards both ends, where the outline turns.
        self.s = (0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, SLICES + 2)))[1:-1, None]
        # Control points are denser towards the margins, where the ridges run along the shell.
        self.a = np.sin(0.5 * np.pi * np.linspace(-1, 1, CONTROL_POINTS))[None, :]
        self._phases = generator.uniform(0, 2 * np.pi, (4, 8))
        self._weights = generator.standard_normal((4, 8))
        self._grow(generator)
        body = np.sin(np.pi * self.s**0.8) ** 0.75
        self.arch = body * (1 - np.abs(self.a) ** 2.6) ** 0.75
        self.lumps = self._waves(2, self.s, self.y / shape.length)

    def _grow(self, generator: np.random.Generator) -> None:
        """Set the outline, growth (share of the shell's life at which a point was on the margin) and the fan of radii.

        Shells grow from the umbo in similar figures (Raup 1966): the margin at age t is the outline scaled by t, so a
        point (x, y) has age t = x / u, where the outline has the same slope as the point, w(u) / u = y / x.
        """
        shape = self.shape
        u = np.linspace(1e-3, 1, 400)
        peak = shape.umbo / (shape.umbo + shape.bill)
        widths = 0.5 * shape.length * (u / peak) ** shape.umbo * ((1 - u) / (1 - peak)) ** shape.bill
        half, growth, fan = [], [], []
        for side in (0, 1):
            ragged = widths * (1 + 0.05 * shape.roughness * self._waves(side, u, 0.0 * u))
            slope = np.minimum.accumulate(ragged / u)
            at = np.interp(self.s, u, ragged)
            half.append(at)
            scaled = np.interp(np.abs(self.a) * at / self.s, slope[::-1], u[::-1])
            growth.append(np.clip(self.s / np.maximum(scaled, 1e-3), 0.0, 1.0))
            fan.append(1 - scaled)
        left = self.a < 0
        self.y = self.a * np.where(left, half[0], half[1])
        self.growth = np.where(left, growth[0], growth[1])
        self.fan = np.where(left, -fan[0], fan[1])
        # Seasons differ: the ages of the ridges form a random walk, and their heights vary.
        steps = generator.gamma(4.0, 1.0, int(np.ceil(shape.ridges)) + 1)
        self._ages = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
        self._rises = generator.uniform(0.4, 1.4, len(steps))

    def _waves(self, kind: int, x: Array, y: Array) -> Array:
        """Smooth irregularity of about unit amplitude; kind: which of the four independent ones."""
        total = np.zeros(np.broadcast(x, y).shape)
        for k in range(8):
            frequency = 2.0 + 1.7 * k
            turn = self._phases[kind, k]
            along = np.cos(turn) * x + np.sin(3.1 * turn) * y
            total += self._weights[kind, k] / (1 + 0.45 * k) * np.sin(frequency * np.pi * along + turn)
        return total / 1.4

    def _lamellae(self, kind: int) -> Array:
        """Growth ridges (S, C), 0 to about 1: each season overlaps the last like a roof tile, a rise and a step."""
        age = self.growth * (1 + 0.02 * self.shape.roughness * self._waves(kind, 2.5 * self.fan, self.growth))
        season = np.clip(np.searchsorted(self._ages, age, side="right") - 1, 0, len(self._rises) - 1)
        start, end = self._ages[season], self._ages[season + 1]
        tile = np.clip((age - start) / np.maximum(end - start, 1e-6), 0.0, 1.0) ** 1.6
        return np.asarray(
            tile * self._rises[season] * np.minimum(1.0, 5 * self.growth) * np.minimum(1.0, 12 * (1 - self.growth))
        )

    @property
    def margin(self) -> Array:
        """z (S, C) of the surface where the margins of the two valves meet, undulating with the radial folds."""
        shape = self.shape
        fold = np.cos(np.pi * shape.folds * self.fan * (1 + 0.12 * self.lumps) + 7 * shape.ridges)
        return shape.fold_height * self.growth**2 * fold + 0.010 * shape.roughness * self.growth**4 * self.lumps

    def left(self) -> Array:
        """z (S, C) of the outside of the left valve."""
        shape = self.shape
        uneven = 0.022 * shape.roughness * self.lumps * self.arch
        return self.margin - shape.cup * self.arch - shape.ridge_height * self._lamellae(2) + uneven

    def left_inside(self) -> Array:
        """z (S, C) of the inside of the left valve: smooth, deepest towards the umbo."""
        shape = self.shape
        return self.margin - (shape.cup - shape.wall) * self.arch * (1 - 0.25 * self.s) + 0.004 * self.arch

    def right(self) -> Array:
        """z (S, C) of the outside of the right valve."""
        shape = self.shape
        uneven = 0.016 * shape.roughness * self._waves(3, self.s, self.y / shape.length) * self.arch
        return self.margin + (shape.lid + 0.03) * self.arch + shape.ridge_height * self._lamellae(3) + uneven

    def right_inside(self) -> Array:
        """z (S, C) of the inside of the right valve."""
        shape = self.shape
        wall = 0.67 * shape.wall * self.arch
        return self.margin + (shape.lid + 0.03) * self.arch - wall - 0.01 * self.arch

    def skin(self, lower: Array, upper: Array, inside: tuple[float, float]) -> Mesh:
        """Build the mesh between two sets of splines that share their ends; inside: 1 for a valve's inside, else 0.

        Marks (V, 3): growth, inside (0 or 1), muscle scar (0 to 1).
        """
        upper = np.maximum(upper, lower + 0.012 * np.minimum(1.0, 6 * self.arch))
        rim = 0.5 * (lower[:, [0, -1]] + upper[:, [0, -1]])
        lower, upper = lower.copy(), upper.copy()
        lower[:, [0, -1]], upper[:, [0, -1]] = rim, rim
        scar = np.exp(-((((self.s - SCAR[0]) / SCAR[2]) ** 2 + ((self.a - SCAR[1]) / SCAR[3] / 2) ** 2) ** 3))
        rings, marks = [], []
        parameter = np.linspace(0, 1, POINTS + 1)[:-1]
        for z, is_inside, order in ((lower, inside[0], 1), (upper, inside[1], -1)):
            values = [self.y, z, self.growth, np.full_like(z, is_inside), is_inside * scar]
            points = np.stack([_splines(v[:, ::order], parameter) for v in values], axis=-1)
            rings.append(points[..., :2])
            marks.append(points[..., 2:])
        ring, mark = np.concatenate(rings, axis=1), np.concatenate(marks, axis=1)
        vertices = self._bent(ring)
        ends = np.array([[[0.0, inside[0], 0.0]], [[1.0, inside[0], 0.0]]])
        vertices = np.concatenate([np.zeros((1, 3)), vertices.reshape(-1, 3), vertices[-1].mean(axis=0)[None]])
        all_marks = np.concatenate([ends[0], mark.reshape(-1, 3), ends[1]])
        vertices[:, 0] /= vertices[:, 0].max()
        return build_mesh(vertices, _faces(len(ring), ring.shape[1]), all_marks)

    def _bent(self, ring: Array) -> Array:
        """Points (S, P, 3) of rings (S, P, 2) in y, z, twisted and shifted along the shell, with the bill rounded."""
        shape, s = self.shape, self.s
        turn = shape.twist * (s - 0.3)
        y = np.cos(turn) * ring[..., 0] - np.sin(turn) * ring[..., 1] + shape.curve * np.sin(0.8 * np.pi * s)
        z = np.sin(turn) * ring[..., 0] + np.cos(turn) * ring[..., 1] + shape.bend * np.sin(np.pi * s)
        # Growth lines are arcs around the umbo, and the bill is frayed.
        across = ring[..., 0] / shape.length
        frayed = 0.02 * shape.roughness * self._waves(1, 0.0 * across, 2.5 * across) * s**3
        return np.stack([s * (1 + frayed - 0.35 * (1 - s) * across**2), y, z], axis=-1)


def _splines(values: Array, parameter: Array) -> Array:
    """Evaluate clamped cubic B-splines over [0, 1] with control values (S, C) at parameters (P,): (S, P)."""
    count = values.shape[1]
    inner = np.linspace(0, 1, count - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])
    return BSpline(knots, values.T, DEGREE)(parameter).T


def _turned(mesh: Mesh, angle: float) -> Mesh:
    """Return a valve opened by an angle, rad, about the hinge."""
    x, y, z = mesh.vertices.astype(float).T
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = np.column_stack([cosine * x - sine * z, y, sine * x + cosine * z])
    return build_mesh(turned, mesh.faces, mesh.marks)


def _volume(mesh: Mesh) -> float:
    """Enclosed volume of a mesh, by the divergence theorem."""
    a, b, c = np.moveaxis(mesh.vertices.astype(float)[mesh.faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def _faces(rings: int, points: int) -> NDArray[np.int64]:
    """Faces (F, 3) over `rings` closed rings of `points` vertices each, with a pole vertex before and after them."""
    here = np.arange(points)
    there = (here + 1) % points
    start = 1 + points * np.arange(rings - 1)[:, None]
    quads = np.stack([start + here, start + there, start + points + there, start + points + here], axis=-1)
    sides = np.concatenate([quads[..., [0, 1, 2]].reshape(-1, 3), quads[..., [0, 2, 3]].reshape(-1, 3)])
    last = 1 + points * (rings - 1)
    first_cap = np.column_stack([np.zeros(points, int), 1 + there, 1 + here])
    last_cap = np.column_stack([np.full(points, 1 + points * rings), last + here, last + there])
    return np.concatenate([first_cap, sides, last_cap])
