"""Debris, which drifts with the current and the waves, wanders a little and tumbles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.scene.life.ground import Ground
from oysterbench.scene.life.school import give_way
from oysterbench.scene.life.states import State, Vehicle
from oysterbench.scene.waves import Waves


@dataclass(frozen=True)
class Debris:
    """Pieces of debris, each at its place (M, 3) m (z over the ground's bound) at its time (M,) s. current (2,) m/s.
    wander (3, M, 3): amplitude m, rate rad/s, phase. spin (M, 3) rad/s, tilt (M, 4): quaternions at time 0. form (M,):
    index of its mesh."""

    kind: str
    colours: Array
    places: Array
    times_s: Array
    current: Array
    wander: Array
    spin: Array
    tilt: Array
    form: NDArray[np.int64]
    sizes: Array
    waves: Waves
    ground: Ground
    vehicle: Vehicle
    class_name: str = "debris"

    @property
    def ids(self) -> NDArray[np.int64]:
        return np.arange(len(self.sizes))

    def at(self, time_s: float) -> State:
        points = self.places.copy()
        points[:, :2] += self.current * (time_s - self.times_s)[:, None]
        amplitude, rate, phase = self.wander
        points += amplitude * np.sin(rate * time_s + phase)
        still = points.copy()
        still[:, 2] += self.ground.bound(still[:, 0], still[:, 1])
        points += self.waves.displacement(still, np.full(len(points), time_s))
        points = give_way(points[None], self.vehicle(np.array([time_s]))[0], self.ground)[0]
        turns = Rotation.from_rotvec(self.spin * time_s) * Rotation.from_quat(self.tilt)
        return State(self.form, points, turns.as_matrix(), self.sizes[:, None] * np.ones(3))
