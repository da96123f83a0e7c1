"""Mesh of a blue crab (Callinectes sapidus) at a phase of its gait, 1 across from spine to spine along y, on z = 0.

Marks: linear albedo.
"""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.scene.life.bodies import ball, limb, skin
from oysterbench.scene.mesh import Mesh, join_meshes

PHASES = 8  # of the gait
STRIDE = 0.5  # widths travelled per cycle of the legs
SHELL, BELLY, LEG, BLUE, RED, PALE = (
    (0.085, 0.090, 0.045),
    (0.42, 0.40, 0.36),
    (0.075, 0.115, 0.120),
    (0.050, 0.120, 0.220),
    (0.30, 0.070, 0.035),
    (0.34, 0.36, 0.36),
)
LIFT = 0.17  # height of the shell's middle above the bottom


def build_crab(phase: float) -> Mesh:
    """Build the crab at a phase (rad): it walks to its left, moving its legs in two alternating sets."""
    parts = [_shell()]
    for side in (1.0, -1.0):
        parts += _claw(side)
        for k in range(3):
            parts.append(_leg(side, k, phase + np.pi * (k % 2) + (np.pi if side < 0 else 0.0)))
        parts += _paddle(side)
        parts.append(ball(np.array([0.205, side * 0.07, LIFT + 0.045]), np.full(3, 0.014), (0.01, 0.01, 0.01), 6))
    return join_meshes(parts)


def _shell() -> Mesh:
    """Carapace: broad, with a row of teeth in front and a long spine on each side."""
    turn = 2 * np.pi * np.arange(40) / 40
    x, y = np.cos(turn), np.sin(turn)
    spine = np.exp(-(((np.abs(turn - np.pi * np.where(turn > np.pi, 1.5, 0.5))) / 0.14) ** 2))
    teeth = 0.018 * (x > 0.05) * np.cos(20 * turn)
    rings, marks = [], []
    for level in np.linspace(-0.42, 0.46, 9) * np.pi:
        flat, rise = np.cos(level), np.sin(level)
        edge = flat**6
        half_width = 0.38 * flat + (0.12 * spine + teeth) * edge
        half_length = (0.20 + 0.02 * (x < 0)) * flat + teeth * edge
        up = 0.085 if level > 0 else 0.06
        rings.append(np.column_stack([half_length * x, half_width * y, np.full(40, LIFT + up * rise)]))
        colour = np.array(SHELL if level > -0.3 else BELLY)
        marks.append(colour * (1 + 0.5 * spine[:, None] * edge))
    ends = np.array([[0.0, 0.0, LIFT - 0.062], [0.0, 0.0, LIFT + 0.088]])
    return skin(np.array(rings), ends, np.array(marks), np.array([BELLY, SHELL]))


def _claw(side: float) -> list[Mesh]:
    """Claw: an arm, a hand and its two fingers, held in front of the body."""
    arm = np.array([[0.14, 0.25, LIFT - 0.02], [0.24, 0.42, LIFT], [0.33, 0.40, LIFT + 0.01]])
    hand = np.array([[0.33, 0.40, LIFT + 0.01], [0.40, 0.32, LIFT + 0.01], [0.45, 0.26, LIFT]])
    upper = np.array([[0.45, 0.26, LIFT + 0.015], [0.505, 0.185, LIFT + 0.02], [0.53, 0.12, LIFT + 0.005]])
    lower = np.array([[0.44, 0.25, LIFT - 0.015], [0.475, 0.175, LIFT - 0.02], [0.49, 0.11, LIFT - 0.005]])
    mirror = np.array([1.0, side, 1.0])
    return [
        limb(arm * mirror, np.array([0.032, 0.036, 0.030]), LEG),
        limb(hand * mirror, np.array([0.032, 0.050, 0.036]), BLUE, 8),
        limb(upper * mirror, np.array([0.018, 0.014, 0.004]), RED),
        limb(lower * mirror, np.array([0.020, 0.014, 0.004]), PALE),
    ]


def _leg(side: float, k: int, phase: float) -> Mesh:
    """Walking leg: hip, knee and a foot that swings along y and is lifted on its forward swing."""
    x = 0.10 - 0.11 * k
    swing = 0.09 * np.cos(phase)
    lift = 0.05 * max(np.sin(phase), 0.0)
    splay = (0.10 - 0.13 * k) * 0.8
    hip = np.array([x, side * 0.27, LIFT - 0.035])
    knee = np.array([x + 0.6 * splay, side * 0.47 + 0.5 * swing, LIFT + 0.05 + 0.5 * lift])
    foot = np.array([x + 1.1 * splay, side * 0.62 + swing, lift + 0.004])
    path = np.stack([hip, 0.5 * (hip + knee), knee, 0.45 * knee + 0.55 * foot, foot])
    return limb(path, np.array([0.022, 0.022, 0.019, 0.014, 0.005]), LEG)


def _paddle(side: float) -> list[Mesh]:
    """Last leg, ending in a flat paddle."""
    path: Array = np.array([[-0.18, 0.24, LIFT - 0.02], [-0.27, 0.36, LIFT + 0.01], [-0.33, 0.42, LIFT]])
    mirror = np.array([1.0, side, 1.0])
    oar = ball(np.array([-0.37, side * 0.45, LIFT]), np.array([0.055, 0.035, 0.008]), BLUE, 8)
    return [limb(path * mirror, np.array([0.022, 0.020, 0.015]), LEG), oar]
