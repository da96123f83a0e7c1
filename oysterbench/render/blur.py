"""Forward-scattered light, blurred with a point spread function that is a mixture of three normal distributions.

The mixture is fitted to single scattering in a cone by the Henyey-Greenstein function, anywhere along the path
(apparent angle = scattering angle * U(0, 1)); its largest error as a distribution of angle is 0.026. The blurs are
computed on downsampled images, wider blurs on smaller ones.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oysterbench.render.target import KERNEL_OPTIONS

wp.set_module_options(KERNEL_OPTIONS)

SHARES = (0.171, 0.488, 0.341)
WIDTHS = (0.12, 0.71, 2.84)  # standard deviation along either axis, relative to Water.spread_rad
REACH = 2.5  # truncation of a blur, in standard deviations
COARSEST = 4  # coarsest level: downsampled images have 1 / 2 to 1 / 16 of the pixels per side


class Blur:
    """Blurs an image (H, W) of vec3 on the device."""

    def __init__(self, shape: tuple[int, int], focal_px: float, spread_rad: float, device: str) -> None:
        self.device = device
        self.shape = shape
        self._steps = []
        for width in WIDTHS:
            sigma = width * spread_rad * focal_px
            level = int(np.clip(np.floor(np.log2(max(sigma / 1.2, 1.0))), 0, COARSEST))
            offsets = np.arange(int(np.ceil(REACH * sigma / 2**level)) + 1)
            weights = np.exp(-((offsets * 2**level / max(sigma, 0.1)) ** 2) / 2)
            kernel = wp.array(np.round(weights, 6).astype(np.float32), dtype=wp.float32, device=device)
            small = (-(-shape[0] // 2**level), -(-shape[1] // 2**level))
            self._steps.append((level, kernel, *(wp.zeros(small, dtype=wp.vec3, device=device) for _ in range(3))))

    def spread(self, picture: wp.array, blurred: wp.array) -> None:
        """Write the blurred image into `blurred`."""
        levels = []
        for level, kernel, reduced, across, done in self._steps:
            shape = reduced.shape
            wp.launch(reduce, shape, inputs=[picture, 2**level], outputs=[reduced], device=self.device)
            wp.launch(smear, shape, inputs=[reduced, kernel, 0], outputs=[across], device=self.device)
            wp.launch(smear, shape, inputs=[across, kernel, 1], outputs=[done], device=self.device)
            levels += [done, 2**level]
        wp.launch(join, self.shape, inputs=[*levels, wp.vec3(*SHARES)], outputs=[blurred], device=self.device)


@wp.kernel
def reduce(picture: wp.array2d(dtype=wp.vec3), block: int, reduced: wp.array2d(dtype=wp.vec3)):
    """Average blocks of pixels."""
    i, j = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    rows = wp.min(block, picture.shape[0] - i * block)
    columns = wp.min(block, picture.shape[1] - j * block)
    for di in range(rows):
        for dj in range(columns):
            total += picture[i * block + di, j * block + dj]
    reduced[i, j] = total / float(rows * columns)


@wp.kernel
def smear(
    picture: wp.array2d(dtype=wp.vec3), weights: wp.array(dtype=wp.float32), axis: int, out: wp.array2d(dtype=wp.vec3)
):
    """Take the weighted mean along an axis (0 horizontal, 1 vertical); pixels beyond the border do not count."""
    i, j = wp.tid()
    total = picture[i, j] * weights[0]
    sum = weights[0]
    for k in range(1, weights.shape[0]):
        for side in range(2):
            offset = k
            if side == 1:
                offset = -k
            row = i
            column = j
            if axis == 0:
                column = j + offset
            else:
                row = i + offset
            if row >= 0 and column >= 0 and row < picture.shape[0] and column < picture.shape[1]:
                total += picture[row, column] * weights[k]
                sum += weights[k]
    out[i, j] = total / sum


@wp.func
def enlarged(picture: wp.array2d(dtype=wp.vec3), block: int, i: int, j: int):
    """Value of a downsampled image at a pixel of the full-size one, interpolated bilinearly."""
    y = wp.clamp((float(i) + 0.5) / float(block) - 0.5, 0.0, float(picture.shape[0] - 1))
    x = wp.clamp((float(j) + 0.5) / float(block) - 0.5, 0.0, float(picture.shape[1] - 1))
    r = wp.min(int(y), picture.shape[0] - 1)
    c = wp.min(int(x), picture.shape[1] - 1)
    below = wp.min(r + 1, picture.shape[0] - 1)
    right = wp.min(c + 1, picture.shape[1] - 1)
    u = x - float(c)
    low = picture[r, c] + (picture[r, right] - picture[r, c]) * u
    high = picture[below, c] + (picture[below, right] - picture[below, c]) * u
    return low + (high - low) * (y - float(r))


@wp.kernel
def join(
    fine: wp.array2d(dtype=wp.vec3),
    fine_block: int,
    middle: wp.array2d(dtype=wp.vec3),
    middle_block: int,
    wide: wp.array2d(dtype=wp.vec3),
    wide_block: int,
    shares: wp.vec3,
    out: wp.array2d(dtype=wp.vec3),
):
    """Mix the three blurs."""
    i, j = wp.tid()
    total = enlarged(fine, fine_block, i, j) * shares[0]
    total += enlarged(middle, middle_block, i, j) * shares[1]
    out[i, j] = total + enlarged(wide, wide_block, i, j) * shares[2]
