"""Site of a rollout: the fenced part of a reef, its live oysters, and how low the hull may go."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import VehicleState
from oysterbench.recipe import CameraRecipe, SteeringRecipe
from oysterbench.render.light import build_light
from oysterbench.render.radiance import Daylight
from oysterbench.render.water import build_water
from oysterbench.scene.path.clearance import lowest
from oysterbench.scene.rig import camera_matrix, camera_pose
from oysterbench.scene.terrain import sample_grid
from oysterbench.scene.world import World
from oysterbench.simulation.simulated_sequence import SimulatedSequence

FLOOR_CELL_M = 0.05
GREEN = 1  # the channel that sees farthest in most waters here
DEEPEST_M = 10.0


@dataclass(frozen=True)
class Site:
    """Site of a rollout. simulated: the built reef; half_m: the area is within -half_m and half_m in x and y; range_m:
    greatest distance from the camera at which an oyster is seen; ids (N,), oysters (N, 3): numbers in instance images,
    and positions in `map`, m, of the live oysters in the area."""

    simulated: SimulatedSequence
    task: SteeringRecipe
    camera: CameraRecipe
    half_m: float
    range_m: float
    ids: NDArray[np.int64]
    oysters: Array

    @property
    def world(self) -> World:
        """The reef."""
        return self.simulated.world

    @cached_property
    def mount(self) -> Array:
        """T_base_cam (4, 4)."""
        return camera_pose(self.camera)

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Tangents of half the horizontal and half the vertical field of view."""
        focal = camera_matrix(self.camera)[0, 0]
        return self.camera.width / 2 / focal, self.camera.height / 2 / focal

    @cached_property
    def _lines(self) -> Array:
        half = self.half_m + self.task.speed_m_s * self.task.step_s
        return np.linspace(-half, half, 2 * int(np.ceil(half / FLOOR_CELL_M)) + 1)

    @cached_property
    def _lowest(self) -> Array:
        x, y = np.meshgrid(self._lines, self._lines)
        floor = lowest(x.ravel(), y.ravel(), self.world.obstacle_height, self.task.hull_m)
        return floor.reshape(x.shape)

    def floor(self, x: Array, y: Array) -> Array:
        """Lowest z at which the hull touches nothing at x, y, m in `map`, from a grid of FLOOR_CELL_M."""
        return sample_grid(self._lines, self._lowest, x, y)

    def altitude(self, states: Array) -> Array:
        """Altitude over the bottom of states (..., 5), m."""
        return np.asarray(states[..., 2] - self.world.ground_height(states[..., 0], states[..., 1]))


def build_site(simulated: SimulatedSequence, task: SteeringRecipe) -> Site:
    """Site of a rollout over the reef of a simulated sequence, seen by the rig's first camera.

    Raises RecipeError where the fence leaves no room.
    """
    half = simulated.recipe.reef.size_m / 2 - task.fence_m
    if half < task.altitude_m[1]:
        raise RecipeError(
            f"sequence {simulated.recipe.name}: key 'steering.fence_m': expected a fence that leaves at least "
            f"{task.altitude_m[1]:g} m on each side of the middle, got {half:g} m (reef.size_m / 2 - fence_m)"
        )
    light = build_light(simulated.recipe.light)
    water = build_water(simulated.recipe.water, Daylight(float(light.sun_direction[2]), light.sky), DEEPEST_M)
    attenuation = float(water.absorption[GREEN] + water.scattering[GREEN])
    table = simulated.world.oyster_table()
    inside = (table["state"] == "live") & (table[["x", "y"]].abs().max(axis=1) <= half)
    return Site(
        simulated,
        task,
        simulated.rig.camera[0],
        half,
        round(min(task.view_range_m, task.view_lengths / attenuation), 6),
        table.loc[inside, "id"].to_numpy(dtype=np.int64),
        table.loc[inside, ["x", "y", "z"]].to_numpy(dtype=float),
    )


def measure_state(site: Site, state: Array) -> VehicleState:
    """Readings of the vehicle's own sensors at a state (5,), to their resolution."""
    altitude = float(site.altitude(state[None])[0])
    return VehicleState(*(round(float(value), 3) for value in (state[3], state[4], -state[2], altitude)))
