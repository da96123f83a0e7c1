"""Single rays cast into a world, for acoustic sensors: range, surface normal, class and instance of what they hit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.render.casting import NOTHING, Geometry, cast, surface_normal
from oysterbench.render.target import KERNEL_OPTIONS, start_warp
from oysterbench.render.upload import upload_geometry
from oysterbench.scene.life import Life
from oysterbench.scene.world import World

wp.set_module_options(KERNEL_OPTIONS)

DIRECTION_STEP = 2.0**-20
"""Step to which directions, and origins in metres, are rounded, so that the last bits of a CPU's sin() do not show."""


@dataclass(frozen=True)
class Echoes:
    """First hits of N rays.

    ranges (N,) float32 m along the ray, inf if there is nothing within range; normals (N, 3) float32, outward unit
    normals in `map`, 0 for nothing; classes (N,) uint8 as in recipe.CLASSES, 0 for nothing; instances (N,) uint16 as
    in instance images, 0 for the bottom and for nothing.
    """

    ranges: NDArray[np.float32]
    normals: NDArray[np.float32]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]


class RayCaster:
    """Casts rays into a world, uploaded to the device once, without the vehicle, which carries the sensors."""

    def __init__(self, world: World, device: str = "cpu", life: Life | None = None) -> None:
        start_warp()
        self.world = world
        self.device = device
        self._geometry, self._movers, self._kept = upload_geometry(world, device, life)

    @contextmanager
    def at(self, time_s: float) -> Iterator[None]:
        """Place moving things for a time within the context; outside it, nothing roams and no plant sways."""
        if self._movers is not None:
            self._movers.move(time_s)
        try:
            yield
        finally:
            if self._movers is not None:
                self._movers.move(None)

    def cast(self, origins: Array, directions: Array, max_range: float) -> Echoes:
        """Cast rays from origins (N, 3) or (3,) m along unit directions (N, 3), in `map`, up to max_range m."""
        rays = np.rint(np.asarray(directions, dtype=float) / DIRECTION_STEP) * DIRECTION_STEP
        starts = np.rint(np.broadcast_to(origins, rays.shape) / DIRECTION_STEP) * DIRECTION_STEP
        n = len(rays)
        ranges = wp.empty(n, dtype=wp.float32, device=self.device)
        normals = wp.empty(n, dtype=wp.vec3, device=self.device)
        classes = wp.empty(n, dtype=wp.uint8, device=self.device)
        instances = wp.empty(n, dtype=wp.uint16, device=self.device)
        wp.launch(
            listen,
            n,
            inputs=[
                self._geometry,
                wp.array(starts.astype(np.float32), dtype=wp.vec3, device=self.device),
                wp.array(rays.astype(np.float32), dtype=wp.vec3, device=self.device),
                float(max_range),
            ],
            outputs=[ranges, normals, classes, instances],
            device=self.device,
        )
        return Echoes(*(array.numpy() for array in (ranges, normals, classes, instances)))


@wp.kernel
def listen(
    world: Geometry,
    origins: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    directions: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    max_range: float,
    ranges: wp.array(dtype=wp.float32),  # type: ignore[valid-type]
    normals: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    classes: wp.array(dtype=wp.uint8),  # type: ignore[valid-type]
    instances: wp.array(dtype=wp.uint16),  # type: ignore[valid-type]
):
    """Find the nearest surface along each ray."""
    i = wp.tid()
    direction = directions[i]
    hit = cast(world, origins[i], direction, max_range / wp.length(direction))
    distance = wp.float32(wp.inf)  # type: ignore[attr-defined]
    normal = wp.vec3(0.0, 0.0, 0.0)
    kind = wp.uint8(0)
    number = wp.uint16(0)
    if hit.instance != NOTHING:
        distance = hit.t * wp.length(direction)
        normal = surface_normal(world, hit, origins[i] + direction * hit.t)
        kind = wp.uint8(1)
        if hit.instance >= 0:
            kind = world.placed[hit.instance].kind
            number = world.placed[hit.instance].number
    ranges[i] = distance
    normals[i] = normal
    classes[i] = kind
    instances[i] = number
