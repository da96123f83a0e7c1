"""Meshes of drifting things: fallen leaves, torn blades of grass, strips of film, each 1 long along x; and a piece of
tether."""

from __future__ import annotations

import numpy as np

from oysterbench.scene.life.bodies import blade, skin
from oysterbench.scene.mesh import Mesh

KINDS = ("leaf", "grass", "film")
VARIANTS = 3  # of each kind
POINTS = 12
CABLE, CABLE_SIDES = (0.55, 0.42, 0.03), 10  # albedo


def build_flotsam(kind: str, generator: np.random.Generator) -> Mesh:
    """Build a bent and twisted sheet of one of KINDS. Marks: linear albedo."""
    s = np.linspace(0, 1, POINTS)
    if kind == "leaf":
        half = 0.22 * np.sin(np.pi * s**0.8) ** 0.8 + 0.01
        tone = np.array([0.16, 0.085, 0.035]) * generator.uniform(0.6, 1.4)
    elif kind == "grass":
        half = np.full(POINTS, 0.018) * np.sqrt(1.02 - s**4)
        tone = np.array([0.075, 0.085, 0.028]) * generator.uniform(0.7, 1.3)
    else:
        half = 0.10 + 0.03 * np.sin(2 * np.pi * (generator.uniform(0.5, 1.5) * s + generator.uniform()))
        tone = np.array([0.50, 0.52, 0.52]) * generator.uniform(0.7, 1.2)
    bow, wave = generator.uniform(0.2, 0.7), generator.uniform(0.02, 0.08)
    rise = bow * (s - s**2) + wave * np.sin(2 * np.pi * (1.5 * s + generator.uniform()))
    aside = generator.uniform(-0.3, 0.3) * (s - 0.5) ** 2
    middle = np.column_stack([s - 0.5, aside, rise - rise.mean()])
    twist = generator.uniform(-1.5, 1.5) * s
    wide = np.column_stack([np.zeros(POINTS), np.cos(twist), np.sin(twist)])
    thick = 0.004 * np.column_stack([np.zeros(POINTS), -np.sin(twist), np.cos(twist)])
    shade = tone * (1 + 0.3 * np.sin(9 * s + generator.uniform(0, 6)))[:, None]
    return blade(middle - half[:, None] * wide, middle + half[:, None] * wide, thick, shade, 0.85 * shade)


def build_cable() -> Mesh:
    """Build a piece of cable of length and radius 1 along x, to be scaled; slightly longer, so that pieces overlap."""
    turn = 2 * np.pi * np.arange(CABLE_SIDES) / CABLE_SIDES
    rings = np.stack([np.column_stack([np.full(CABLE_SIDES, x), np.cos(turn), np.sin(turn)]) for x in (-0.02, 1.02)])
    ends = np.array([[-0.03, 0.0, 0.0], [1.03, 0.0, 0.0]])
    return skin(rings, ends, np.broadcast_to(CABLE, rings.shape), np.broadcast_to(CABLE, (2, 3)))
