"""Plant meshes: seagrass ribbons, broad algae with lobed, ruffled laminae about a midrib, filaments; all watertight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh, build_mesh, join_meshes

BLADE_RINGS, FROND_RINGS = 12, 15
ACROSS = np.array([-1.0, -0.68, -0.36, -0.12, 0.0, 0.12, 0.36, 0.68, 1.0])  # columns of a lamina, dense at its midrib
FROND_WIDTH = (0.20, 0.42)  # relative to its length
BLADE_WIDTH = (0.012, 0.022)
FILAMENTS, FILAMENT_RINGS = (70, 100), 6
FILAMENT_WIDTH = (0.016, 0.046)  # relative to length: a lock of many threads, too fine to be drawn one by one
STRAND_RINGS = 14
STRAND_WIDTH, THREAD_WIDTH = (0.016, 0.034), (0.005, 0.010)  # relative to length


@dataclass(frozen=True)
class _Course:
    """Centre line of a blade from its root: s (R,) from 0 to 1, middle (R, 3), and directions of about unit length
    across the blade, in its plane, wide (R, 3), and out of it, thick (R, 3).
    """

    length: float
    s: Array
    middle: Array
    wide: Array
    thick: Array


def build_tuft(generator: np.random.Generator, broad: bool) -> Mesh:
    """Build a tuft of plants, rooted at z = 0, its longest blade about 1 long: seagrass ribbons, or broad algae.

    Marks: share of the blade's length, the blade's tone, position across the blade.
    """
    blades = int(generator.integers(5, 10)) if broad else int(generator.integers(12, 25))
    lean = generator.uniform(0, 2 * np.pi)  # the current bends all blades one way
    return join_meshes([(_frond if broad else _blade)(generator, lean) for _ in range(blades)])


def build_bunch(generator: np.random.Generator) -> Mesh:
    """Build a bunch of filamentous algae about 1 long, rooted at z = 0: wavering locks of threads. Marks: see tufts."""
    lean, tone = generator.uniform(0, 2 * np.pi), generator.uniform(0.3, 0.8)
    return join_meshes([_filament(generator, lean, tone) for _ in range(int(generator.integers(*FILAMENTS)))])


def build_strand(generator: np.random.Generator, thread: bool) -> Mesh:
    """Build a dead eelgrass blade, or a stalk or thread, 1 long, lying on z = 0 along x. Marks as for tufts."""
    s = np.linspace(0, 1, STRAND_RINGS)
    bend = generator.uniform(-0.9, 0.9) + generator.uniform(-1.6, 1.6) * s
    step = 1.0 / (STRAND_RINGS - 1)
    along = np.cumsum(step * np.column_stack([np.cos(bend), np.sin(bend)]), axis=0)
    along -= along.mean(axis=0)
    rise = 0.02 * np.sin(2 * np.pi * (generator.uniform(0.6, 1.8) * s + generator.uniform()))
    middle = np.column_stack([along, rise - rise.min()])
    turn = 0.5 * generator.standard_normal() + generator.uniform(-1.2, 1.2) * s
    tangent = np.gradient(middle, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.column_stack([-tangent[:, 1], tangent[:, 0], np.zeros(STRAND_RINGS)])
    up = np.cross(tangent, side)
    wide = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
    course = _Course(1.0, s, middle, wide, np.cross(tangent, wide))
    half = 0.5 * generator.uniform(*(THREAD_WIDTH if thread else STRAND_WIDTH)) * np.sqrt(1.02 - s**6)[:, None]
    thin = (0.8 if thread else 0.15) * half
    offsets = np.stack([-half * course.wide, thin * course.thick, half * course.wide, -thin * course.thick], axis=1)
    return _skinned(course, offsets, np.array([0.0, 0.5, 1.0, 0.5]), generator.uniform())


def _filament(generator: np.random.Generator, lean: float, tone: float) -> Mesh:
    """Lock of threads: a flat four-sided tube, widest beyond its middle, with nearly the tone of its bunch."""
    heading = lean + 1.1 * generator.standard_normal()
    course = _course(generator, FILAMENT_RINGS, heading, generator.uniform(0.2, 0.7))
    swell = np.sin(np.pi * (0.12 + 0.80 * course.s**0.8))[:, None]
    half = 0.5 * course.length * generator.uniform(*FILAMENT_WIDTH) * swell
    wide, thick = half * course.wide, 0.5 * half * course.thick
    offsets = np.stack([-wide, thick, wide, -thick], axis=1)
    return _skinned(course, offsets, np.array([0.0, 0.5, 1.0, 0.5]), tone + generator.uniform(-0.15, 0.15))


def _blade(generator: np.random.Generator, lean: float) -> Mesh:
    """Ribbon of seagrass: a flat four-sided tube."""
    course = _course(generator, BLADE_RINGS, lean + 0.7 * generator.standard_normal(), generator.uniform(0.05, 0.3))
    half = 0.5 * course.length * generator.uniform(*BLADE_WIDTH) * np.sqrt(1.02 - course.s**4)[:, None]
    wide, thick = half * course.wide, 0.12 * half * course.thick
    offsets = np.stack([-wide, thick, wide, -thick], axis=1)
    return _skinned(course, offsets, np.array([0.0, 0.5, 1.0, 0.5]), generator.uniform())


def _frond(generator: np.random.Generator, lean: float) -> Mesh:
    """Lamina of a broad alga: narrow at its stalk, lobed along its margins, which are longer than its middle and
    therefore ruffled."""
    course = _course(generator, FROND_RINGS, lean + 1.6 * generator.standard_normal(), generator.uniform(0.02, 0.12))
    s, a = course.s[:, None], ACROSS[None, :]
    width = course.length * generator.uniform(*FROND_WIDTH)
    outline = (0.10 + 1.15 * s**0.7) * np.sqrt(np.maximum(1.005 - s**3.5, 0.0))
    lobes, depth = generator.uniform(2.0, 4.5), generator.uniform(0.10, 0.32)
    phase = np.where(a < 0, *generator.uniform(0, 2 * np.pi, 2))
    scallop = 1 - depth * (0.5 + 0.5 * np.sin(2 * np.pi * lobes * s + phase)) * np.minimum(1.0, 3 * s)
    y = 0.5 * width * outline * scallop * a
    ruffles = generator.uniform(1.8, 3.6)
    ruffle = np.sin(2 * np.pi * ruffles * s + np.where(a < 0, *generator.uniform(0, 2 * np.pi, 2)))
    cup = generator.uniform(-0.25, 0.35)
    z = width * outline * (0.17 * ruffle * np.abs(a) ** 1.6 + 0.5 * cup * a**2)
    # The midrib thins towards the tip; the margins are closed by the columns shared by both sides.
    skin = width * (0.012 * (1 - np.abs(a)) + 0.035 * np.exp(-((a / 0.12) ** 2)) * (1 - 0.8 * s)) * np.sqrt(outline)
    upper, lower = z + skin, z - skin
    across = np.concatenate([y, y[:, -2:0:-1]], axis=1)[..., None]
    out = np.concatenate([upper, lower[:, -2:0:-1]], axis=1)[..., None]
    offsets = across * course.wide[:, None] + out * course.thick[:, None]
    place = 0.5 + 0.5 * np.concatenate([ACROSS, ACROSS[-2:0:-1]])
    return _skinned(course, offsets, place, generator.uniform())


def _course(generator: np.random.Generator, rings: int, heading: float, waver: float) -> _Course:
    """Draw the centre line of a blade: rising from its root, bending over to a heading, wavering sideways and slowly
    twisting."""
    length = generator.uniform(0.45, 1.0)
    s = np.linspace(0, 1, rings)
    rise = np.pi / 2 - generator.uniform(0.05, 0.5) - generator.uniform(0.2, 1.3) * s**1.5
    wave = waver * np.sin(2 * np.pi * (generator.uniform(0.6, 1.6) * s + generator.uniform()))
    step = length / (rings - 1)
    along = np.concatenate([[0.0], np.cumsum(step * np.cos(rise)[1:])])
    up = np.concatenate([[0.0], np.cumsum(step * np.sin(rise)[1:])])
    forward = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    root = 0.08 * generator.standard_normal(2)
    side = 0.5 * wave * s * length
    middle = np.column_stack([root + along[:, None] * forward + side[:, None] * left, up])
    turn = generator.uniform(0, np.pi) + generator.uniform(-1.5, 1.5) * s
    tangent = np.gradient(middle, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    flat = np.column_stack([np.cos(turn)[:, None] * left + np.sin(turn)[:, None] * forward, 0.3 * np.sin(3 * turn)])
    thick = np.cross(flat, tangent)
    thick /= np.linalg.norm(thick, axis=1, keepdims=True)
    return _Course(length, s, middle, np.cross(tangent, thick), thick)


def _skinned(course: _Course, offsets: Array, place: Array, tone: float) -> Mesh:
    """Closed mesh over rings at offsets (R, P, 3) from a course; place (P,): position across the blade, 0 to 1."""
    rings, points = offsets.shape[:2]
    vertices = (course.middle[:, None] + offsets).reshape(-1, 3)
    ends = course.middle[[0, -1]]
    if points > 4:  # a blunt tip would show as a slit
        ends = np.stack([ends[0], ends[1] + 0.02 * course.length * np.cross(course.thick[-1], course.wide[-1])])
    marks = np.column_stack(
        [np.repeat(course.s, points), np.full(rings * points, tone), np.tile(place, rings)],
    )
    marks = np.concatenate([marks, [[0.0, tone, 0.5], [1.0, tone, 0.5]]])
    here = np.arange(points)
    there = (here + 1) % points
    start = points * np.arange(rings - 1)[:, None]
    corners = [start + here, start + there, start + points + there, start + points + here]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    last = points * (rings - 1)
    caps = [np.column_stack([np.full(points, len(vertices)), there, here])]
    caps.append(np.column_stack([np.full(points, len(vertices) + 1), last + here, last + there]))
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], *caps])
    vertices = np.concatenate([vertices, ends])
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    turned = np.einsum("fi,fi->", a, np.cross(b, c)) < 0
    return build_mesh(vertices, faces[:, ::-1] if turned else faces, marks)
