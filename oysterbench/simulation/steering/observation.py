"""What a vehicle has seen of a site: live oysters, from masks, and the bottom, from depth images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.render.lens import pixel_rays
from oysterbench.simulation.steering.site import Site

COVER_CELL_M = 0.25
STRIDE = 3  # stride of the pixels that give the covered bottom: 5 cm on the bottom at 2 m


class Observation:
    """What has been seen so far; grows with every image. found (N,) bool: which of the live oysters have been seen."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.found = np.zeros(len(site.ids), dtype=bool)
        self._index = np.full(len(site.world.instances) + 2, -1)
        self._index[site.ids] = np.arange(len(site.ids))
        self._cells = max(1, round(2 * site.half_m / COVER_CELL_M))
        self._covered = np.zeros((self._cells, self._cells), dtype=bool)
        self._rays = pixel_rays(site.camera)[1:-1, 1:-1].astype(float)  # without its border
        self._rays[..., 2] = 1.0
        self._lengths = np.linalg.norm(self._rays, axis=-1)

    @property
    def covered(self) -> float:
        """Share of the area whose bottom has been seen."""
        return float(self._covered.mean())

    def observe(self, T_map_cam: Array, depth: NDArray[np.float32], instances: NDArray[np.uint16]) -> int:
        """Add an image's ground truth, and return how many live oysters it shows for the first time."""
        near = (depth > 0) & (depth * self._lengths <= self.site.range_m)
        pixels = np.bincount(instances[near].astype(np.intp), minlength=len(self._index))
        shown = self._index[np.flatnonzero(pixels >= self.site.task.view_px)]
        shown = shown[shown >= 0]
        new = int(np.count_nonzero(~self.found[shown]))
        self.found[shown] = True
        sparse = (slice(None, None, STRIDE),) * 2
        chosen = near[sparse]
        points = self._rays[sparse][chosen] * depth[sparse][chosen][:, None].astype(float)
        places = points @ T_map_cam[:3, :3].T + T_map_cam[:3, 3]
        cells = np.floor((places[:, :2] + self.site.half_m) / (2 * self.site.half_m) * self._cells).astype(int)
        cells = cells[((cells >= 0) & (cells < self._cells)).all(axis=1)]
        self._covered[cells[:, 1], cells[:, 0]] = True
        return new
