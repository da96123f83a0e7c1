"""States of moving things at one time, and their orientation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

Vehicle = Callable[[Array], tuple[Array, Array]]
"""Function that returns position (N, 3) m and rotation (N, 3, 3) of the vehicle at times (N,) s."""


@dataclass(frozen=True)
class State:
    """State of M things at one time: forms (M,), index among a thing's own meshes; positions (M, 3) m, rotations
    (M, 3, 3) and scales (M, 3), as in Instances."""

    forms: NDArray[np.int64]
    positions: Array
    rotations: Array
    scales: Array


class Group(Protocol):
    """Things of one kind that belong together. kind: species or material; colours (M, 3): factors on albedos; ids (M,):
    number from 0 of the thing to which each row belongs."""

    @property
    def class_name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def colours(self) -> Array: ...
    @property
    def ids(self) -> NDArray[np.int64]: ...

    def at(self, time_s: float) -> State: ...


def turned(forward: Array, roll: Array) -> Array:
    """Rotations (N, 3, 3) of bodies that face along forward (N, 3), rolled (N,) rad to the right about it."""
    x = forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    left = np.column_stack([-x[:, 1], x[:, 0], np.zeros(len(x))])
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    up = np.cross(x, left)
    cos, sin = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([x, cos * left + sin * up, cos * up - sin * left], axis=-1)
