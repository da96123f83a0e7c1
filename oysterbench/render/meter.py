"""The exposure meter of a camera: a very small image of the same world, without caustics, snow and roaming things."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.render import caustics, lamps
from oysterbench.render.lens import pixel_rays
from oysterbench.render.optics import Optics
from oysterbench.render.tracing import Pose, ViewTracer

COLUMNS, ROWS = 32, 24
CENTRE = 0.5  # standard deviation of the centre weighting, relative to half the image's width and height


class Meter(ViewTracer):
    """Exposure meter for a camera, sharing the world that its renderer has on the device."""

    def __init__(self, renderer: ViewTracer) -> None:
        self.__dict__.update(renderer.__dict__)
        self.seconds = copy.copy(renderer.seconds)
        self.camera = dataclasses.replace(renderer.camera, width=COLUMNS, height=ROWS, readout_ms=0.0)
        self._rays = pixel_rays(self.camera)
        self._optics = _copied(renderer._optics)
        light, shape = self.recipe.light, (ROWS, COLUMNS)
        self._optics.lamps = lamps.build_lamps(self._lamps, light.lamps, self._water, shape, self.device)
        self._turbidity = self._fill(shape, self.device)
        if self._movers is not None:  # they would cost 30 ms and cover little of the image
            self._movers.move(None)
            self._movers = None
        still = dataclasses.replace(light, wind_m_s=0.0)
        self._waves = caustics.Waves(still, self._water, self.recipe.reef.depth_m, Streams(0), self.device)
        self._allocate()
        y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLUMNS), indexing="ij")
        weights = np.exp(-(x**2 + y**2) / (2 * CENTRE**2))
        self._weights = np.round(weights / weights.sum(), 9)

    def mean(self, T_map_cam: Pose, time_s: float, T_map_base: Pose) -> Array:
        """Centre-weighted mean radiance (3,) of what the camera sees at a pose."""
        self._prepare(T_map_cam, time_s, T_map_base)
        self._trace(self._view(T_map_cam), self._optics)
        parts = (self._sharp, self._forward_scatter, self._backscatter)
        seen = np.sum([part.numpy().astype(float) for part in parts], axis=0)
        return np.asarray((seen * self._weights[..., None]).sum(axis=(0, 1)))


def _copied(optics: Optics) -> Optics:
    copied = Optics()
    for name in Optics.vars:  # type: ignore[attr-defined]
        setattr(copied, name, getattr(optics, name))
    return copied
