"""Dirt on the port: spots of algae and bubbles, far out of focus, fixed in the image.

A spot of diameter D on the port hides a share of the lens aperture A from each pixel: the overlap of two discs, over
an angle of (D + A) / d at a distance d from the pupil. The hidden light is replaced by a share of the mean light
around: large for a bubble, which scatters rays over a wide angle, small for algae. A bubble's rim bends what passes.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe
from oysterbench.render.blur import enlarged, reduce
from oysterbench.render.shutter import between
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.scene.rig import camera_matrix

wp.set_module_options(KERNEL_OPTIONS)

PUPIL_MM = 1.2  # diameter of the lens aperture, if the recipe has none
PORT_MM = 15.0  # distance of the port from the pupil, if the recipe has none
SMALLEST, LARGEST = 0.3, 3.0  # limits of a spot's diameter, which is log-normal, relative to the recipe's
SPREAD = 0.5  # sigma of the logarithm
BUBBLES = 0.3  # share of spots that are bubbles
ALGAE = (0.10, 0.14, 0.05)  # share of the light around that brown and green films pass on
BUBBLE = (0.80, 0.80, 0.80)
OPAQUE = (0.35, 0.9)  # range of the opacity of a film of algae
BEND_PX = 4.0  # largest deflection by the rim of a bubble
BLOCK = 32  # px over which the light around is averaged


class PortSpots:
    """Spots on one camera's port; streams: the branch from which they are drawn."""

    def __init__(self, camera: CameraRecipe, streams: Streams, device: str) -> None:
        self.device = device
        self.shape = (camera.height, camera.width)
        hidden, sent, bend = spot_maps(camera, streams.generator("port_spots"))
        self._hidden = wp.array(hidden.astype(np.float32), dtype=wp.float32, device=device)
        self._sent = wp.array(sent.astype(np.float32), dtype=wp.vec3, device=device)
        self._bend = wp.array(bend.astype(np.float32), dtype=wp.vec2, device=device)
        blocks = (-(-self.shape[0] // BLOCK), -(-self.shape[1] // BLOCK))
        self._around = wp.zeros(blocks, dtype=wp.vec3, device=device)

    def cover(self, picture: wp.array, covered: wp.array) -> None:
        """Write the image as seen through the port into `covered`."""
        around = [self._around]
        wp.launch(reduce, self._around.shape, inputs=[picture, BLOCK], outputs=around, device=self.device)
        inputs = [picture, self._around, BLOCK, self._hidden, self._sent, self._bend]
        wp.launch(look_through, self.shape, inputs=inputs, outputs=[covered], device=self.device)


def spot_maps(camera: CameraRecipe, generator: np.random.Generator) -> tuple[Array, Array, Array]:
    """Share (H, W) of a pixel's light that spots hide, share (H, W, 3) of the light around that replaces it, and
    deflection (H, W, 2), px, of the remaining light."""
    n = camera.port_spots
    middle = generator.random((n, 2)) * [camera.width, camera.height]
    diameters = camera.port_spot_mm * np.clip(np.exp(SPREAD * generator.standard_normal(n)), SMALLEST, LARGEST)
    bubbles = generator.random(n) < BUBBLES
    opacity = np.where(bubbles, 1.0, generator.uniform(*OPAQUE, n))
    px_per_mm = camera_matrix(camera)[0, 0] / (camera.port_mm or PORT_MM)
    opening = 0.5 * (camera.aperture_mm or PUPIL_MM) * px_per_mm
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    left, sent = np.ones(columns.shape), np.zeros((*columns.shape, 3))
    bend = np.zeros((*columns.shape, 2))
    for k in range(n):
        radius = 0.5 * diameters[k] * px_per_mm
        apart = np.hypot(columns - middle[k, 0], rows - middle[k, 1])
        share = opacity[k] * disc_overlap(apart, radius, opening)
        left *= 1.0 - share
        sent = sent * (1.0 - share[..., None]) + share[..., None] * (BUBBLE if bubbles[k] else ALGAE)
        if bubbles[k]:
            slope = np.stack(np.gradient(share)[::-1], axis=-1)
            steepest = max(float(np.hypot(slope[..., 0], slope[..., 1]).max()), 1e-9)
            bend += slope * (BEND_PX / steepest)
    return np.round(1.0 - left, 5), np.round(sent, 5), np.round(bend, 4)


def disc_overlap(apart: Array, radius: float, opening: float) -> Array:
    """Share of a disc of radius `opening` that one of radius `radius` covers, at centre distances `apart` (N, ...)."""
    small, large = min(radius, opening), max(radius, opening)
    d = np.clip(apart, large - small + 1e-9, large + small - 1e-9)
    a = np.arccos(np.clip((d**2 + small**2 - large**2) / (2 * d * small), -1, 1))
    b = np.arccos(np.clip((d**2 + large**2 - small**2) / (2 * d * large), -1, 1))
    lens = small**2 * (a - np.sin(2 * a) / 2) + large**2 * (b - np.sin(2 * b) / 2)
    area = np.where(apart <= large - small, np.pi * small**2, np.where(apart >= large + small, 0.0, lens))
    return np.asarray(area / (np.pi * opening**2))


@wp.kernel
def look_through(
    picture: wp.array2d(dtype=wp.vec3),
    around: wp.array2d(dtype=wp.vec3),
    block: int,
    hidden: wp.array2d(dtype=wp.float32),
    sent: wp.array2d(dtype=wp.vec3),
    bend: wp.array2d(dtype=wp.vec2),
    covered: wp.array2d(dtype=wp.vec3),
):
    """Add the remaining, deflected light of each pixel and the light around that replaces the rest."""
    i, j = wp.tid()
    share = hidden[i, j]
    light = picture[i, j]
    if share > 0.0:
        way = bend[i, j]
        light = between(picture, float(j) + way[0], float(i) + way[1]) * (1.0 - share)
        light += wp.cw_mul(enlarged(around, block, i, j), sent[i, j])
    covered[i, j] = light
