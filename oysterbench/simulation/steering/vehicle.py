"""The vehicle of a closed-loop rollout: it flies where its bow points, at constant speed over the ground.

A state (5,) float64 is x, y, z m in `map`, heading rad (from east, counter-clockwise) and pitch rad (bow down
positive).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.recipe import SteeringRecipe

SUBSTEPS = 5  # per command: chords of an arc of 30 degrees, to 0.05 % of its length


def advance(states: Array, yaw: Array, pitch: Array, task: SteeringRecipe) -> Array:
    """States (N, SUBSTEPS, 5) passed in one step from states (N, 5); the last is the end of the step.

    yaw, pitch (N,) rad: changes of heading and pitch, spread evenly over the step; pitch stops at its limit.
    """
    share = np.arange(1, SUBSTEPS + 1) / SUBSTEPS
    limit = np.radians(task.max_pitch_deg)
    path = np.empty((len(states), SUBSTEPS, 5))
    path[..., 3] = states[:, None, 3] + yaw[:, None] * share
    path[..., 4] = np.clip(states[:, None, 4] + pitch[:, None] * share, -limit, limit)
    # Each chord has the mean of the directions at its two ends.
    heading = path[..., 3] - yaw[:, None] * (0.5 / SUBSTEPS)
    before = np.concatenate([states[:, None, 4], path[:, :-1, 4]], axis=1)
    slope = 0.5 * (before + path[..., 4])
    length = task.speed_m_s * task.step_s / SUBSTEPS
    chord = np.stack([np.cos(heading) * np.cos(slope), np.sin(heading) * np.cos(slope), -np.sin(slope)], axis=-1)
    path[..., :3] = states[:, None, :3] + np.cumsum(length * chord, axis=1)
    return path


def turns(task: SteeringRecipe) -> tuple[Array, Array]:
    """Turns in rad of the classes of yaw (Y,) and of pitch (P,)."""
    return np.radians(np.array(task.yaw_deg)), np.radians(np.array(task.pitch_deg))


def nearest_class(turn: float, classes: Array) -> int:
    """Number of the class whose turn is nearest to the requested one, rad."""
    return int(np.argmin(np.abs(classes - turn)))


def rotations(states: Array) -> Array:
    """R_map_base (N, 3, 3) of states (N, 5): Rz(heading) Ry(pitch)."""
    cos_h, sin_h = np.cos(states[:, 3]), np.sin(states[:, 3])
    cos_p, sin_p = np.cos(states[:, 4]), np.sin(states[:, 4])
    zero = np.zeros(len(states))
    rows = [
        [cos_h * cos_p, -sin_h, cos_h * sin_p],
        [sin_h * cos_p, cos_h, sin_h * sin_p],
        [-sin_p, zero, cos_p],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def state_of(position: Array, rotation: Array) -> Array:
    """State (5,) of a body at position (3,) with R_map_base (3, 3); its roll is ignored."""
    bow = rotation[:, 0]
    heading = np.arctan2(bow[1], bow[0])
    pitch = -np.arcsin(np.clip(bow[2], -1.0, 1.0))
    return np.array([*position, heading, pitch])


def folded(states: Array, half_m: float) -> tuple[Array, NDArray[np.bool_]]:
    """Reflect states (..., 5) at a fence at +-half_m, like a ball off a wall; also return which ones were outside."""
    states = states.copy()
    outside = np.zeros(states.shape[:-1], dtype=bool)
    for axis, mirror in ((0, np.pi), (1, 0.0)):
        over = np.abs(states[..., axis]) > half_m
        side = np.sign(states[..., axis])
        states[..., axis] = np.where(over, side * 2 * half_m - states[..., axis], states[..., axis])
        states[..., 3] = np.where(over, mirror - states[..., 3], states[..., 3])
        outside |= over
    return states, outside
