"""Defocus: light from nearer or farther than the focus is spread over its circle of confusion, by depth per pixel."""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import Hit
from oysterbench.render.shutter import SOFT_DEPTH, depth_of
from oysterbench.render.target import KERNEL_OPTIONS

wp.set_module_options(KERNEL_OPTIONS)

SIDE = 16  # of the tiles in which the largest circle is found
LARGEST_PX = 12.0  # largest radius of a circle
LEAST_PX = wp.constant(0.5)  # circles of no larger radius stay in their pixel


class Defocus:
    """Defocuses images (H, W) of vec3 on the device; aperture_m: diameter of the lens aperture."""

    def __init__(self, shape: tuple[int, int], focal_px: float, aperture_m: float, focus_m: float, device: str) -> None:
        self.device = device
        self.shape = shape
        self._lens = (0.5 * focal_px * aperture_m, 1.0 / focus_m, LARGEST_PX)
        tiles = (-(-shape[0] // SIDE), -(-shape[1] // SIDE))
        self.radii = wp.zeros(shape, dtype=wp.float32, device=device)
        self._largest = wp.zeros(tiles, dtype=wp.float32, device=device)

    def spread(self, picture: wp.array, hits: wp.array, spread: wp.array) -> None:
        """Write the defocused image into `spread`."""
        inputs = [hits, *self._lens]
        wp.launch(find_circles, self.shape, inputs=inputs, outputs=[self.radii], device=self.device)
        largest = [self._largest]
        wp.launch(largest_circle, self._largest.shape, inputs=[self.radii, SIDE], outputs=largest, device=self.device)
        inputs = [picture, hits, self.radii, self._largest, SIDE]
        wp.launch(collect, self.shape, inputs=inputs, outputs=[spread], device=self.device)


@wp.kernel
def find_circles(
    hits: wp.array2d(dtype=Hit), scale: float, sharp: float, largest: float, radii: wp.array2d(dtype=wp.float32)
):
    """Compute the radius of each pixel's circle of confusion, px: f A |1 / z - 1 / focus| / 2 (thin lens)."""
    i, j = wp.tid()
    radii[i, j] = wp.min(scale * wp.abs(1.0 / depth_of(hits, i, j) - sharp), largest)


@wp.kernel
def largest_circle(radii: wp.array2d(dtype=wp.float32), side: int, largest: wp.array2d(dtype=wp.float32)):
    """Find the largest radius in each tile and as far around it as a circle can reach."""
    i, j = wp.tid()
    best = wp.float32(0.0)
    for row in range(wp.max(i * side - side, 0), wp.min((i + 2) * side, radii.shape[0])):
        for column in range(wp.max(j * side - side, 0), wp.min((j + 2) * side, radii.shape[1])):
            best = wp.max(best, radii[row, column])
    largest[i, j] = best


@wp.kernel
def collect(
    picture: wp.array2d(dtype=wp.vec3),
    hits: wp.array2d(dtype=Hit),
    radii: wp.array2d(dtype=wp.float32),
    largest: wp.array2d(dtype=wp.float32),
    side: int,
    spread: wp.array2d(dtype=wp.vec3),
):
    """Average the pixels whose circles reach a pixel; those behind it reach no farther than its own circle."""
    i, j = wp.tid()
    total = picture[i, j]
    reach = largest[i // side, j // side]
    if reach > LEAST_PX:
        own = radii[i, j]
        depth = depth_of(hits, i, j)
        total = wp.vec3(0.0, 0.0, 0.0)
        sum = wp.float32(0.0)
        n = int(wp.ceil(reach))
        for row in range(wp.max(i - n, 0), wp.min(i + n + 1, picture.shape[0])):
            for column in range(wp.max(j - n, 0), wp.min(j + n + 1, picture.shape[1])):
                radius = radii[row, column]
                if depth_of(hits, row, column) > depth * (1.0 + SOFT_DEPTH):
                    radius = wp.min(radius, own)
                radius = wp.max(radius, LEAST_PX)
                dx = float(column - j)
                dy = float(row - i)
                inside = wp.clamp(radius + 0.5 - wp.sqrt(dx * dx + dy * dy), 0.0, 1.0)
                if inside > 0.0:
                    weight = inside / (radius * radius)
                    total += picture[row, column] * weight
                    sum += weight
        total = total / sum
    spread[i, j] = total
