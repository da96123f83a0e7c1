"""From an ideal image to a file: softness of the lens, and the processing inside a camera.

Cheap cameras smooth what they take for noise, and faint texture with it; sharpen edges with an unsharp mask, which
leaves a bright and a dark halo beside them; and boost contrast and colours: on the encoded levels, as their processors
do.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oysterbench.recipe import CameraRecipe
from oysterbench.render.blur import smear
from oysterbench.render.target import KERNEL_OPTIONS

wp.set_module_options(KERNEL_OPTIONS)

REACH = 3.0  # truncation of a blur, in standard deviations
MASK_PX = 1.3  # standard deviation of the blur that an unsharp mask subtracts
LUMA = wp.constant(wp.vec3(0.299, 0.587, 0.114))  # ITU-R BT.601
MIDDLE = wp.constant(118.0)  # level of middle grey, 18 % of the light, in sRGB gamma
STEPS_PX = (1, 2)  # spacing of the 5 x 5 taps in each pass of noise reduction


def processes(camera: CameraRecipe) -> bool:
    """Whether a camera processes its sensor's image at all."""
    return camera.denoising > 0 or camera.sharpening > 0 or camera.contrast != 1 or camera.saturation != 1


def weights_of(sigma_px: float, device: str) -> wp.array:
    """One side (n,) of a Gaussian kernel, centre first, not normalised: blur.smear divides by the sum."""
    offsets = np.arange(int(np.ceil(REACH * sigma_px)) + 1)
    weights = np.exp(-((offsets / max(sigma_px, 0.1)) ** 2) / 2)
    return wp.array(np.round(weights, 6).astype(np.float32), dtype=wp.float32, device=device)


class Softness:
    """Blurs images (H, W) of vec3 on the device uniformly, as lens, demosaicing and video rescaling do."""

    def __init__(self, shape: tuple[int, int], sigma_px: float, device: str) -> None:
        self.device = device
        self._weights = weights_of(sigma_px, device)
        self._across = wp.zeros(shape, dtype=wp.vec3, device=device)

    def spread(self, picture: wp.array, blurred: wp.array) -> None:
        """Write the blurred image into `blurred`."""
        shape, device = picture.shape, self.device
        wp.launch(smear, shape, inputs=[picture, self._weights, 0], outputs=[self._across], device=device)
        wp.launch(smear, shape, inputs=[self._across, self._weights, 1], outputs=[blurred], device=device)


class Developer:
    """Processes images (H, W, 3) of uint8 on the device according to the camera's recipe (see `processes`)."""

    def __init__(self, camera: CameraRecipe, device: str) -> None:
        shape = (camera.height, camera.width)
        self.device = device
        self._denoising = camera.denoising
        self._how = (camera.sharpening, camera.contrast, camera.saturation)
        self._mask = Softness(shape, MASK_PX, device)
        self._levels, self._spare = (wp.zeros(shape, dtype=wp.vec3, device=device) for _ in range(2))

    def develop(self, colour: wp.array) -> None:
        """Process an image in place."""
        device, levels, spare = self.device, self._levels, self._spare
        shape = levels.shape
        wp.launch(read_levels, shape, inputs=[colour], outputs=[levels], device=device)
        if self._denoising:
            for step in STEPS_PX:
                wp.launch(denoise, shape, inputs=[levels, step, self._denoising], outputs=[spare], device=device)
                levels, spare = spare, levels
        self._mask.spread(levels, spare)
        wp.launch(finish, shape, inputs=[levels, spare, *self._how], outputs=[colour], device=device)


@wp.kernel
def read_levels(colour: wp.array3d(dtype=wp.uint8), levels: wp.array2d(dtype=wp.vec3)):
    """Convert 8-bit codes to floating-point levels."""
    i, j = wp.tid()
    levels[i, j] = wp.vec3(float(colour[i, j, 0]), float(colour[i, j, 1]), float(colour[i, j, 2]))


@wp.kernel
def denoise(levels: wp.array2d(dtype=wp.vec3), step: int, most: float, smooth: wp.array2d(dtype=wp.vec3)):
    """Average over 5 x 5 pixels of similar brightness, with Tukey's biweight of the difference, cut off at `most`
    levels."""
    i, j = wp.tid()
    own = wp.dot(levels[i, j], LUMA)
    total = wp.vec3(0.0, 0.0, 0.0)
    weight = wp.float32(0.0)
    for di in range(-2, 3):
        for dj in range(-2, 3):
            row = wp.clamp(i + di * step, 0, levels.shape[0] - 1)
            column = wp.clamp(j + dj * step, 0, levels.shape[1] - 1)
            there = levels[row, column]
            apart = (wp.dot(there, LUMA) - own) / most
            alike = wp.max(1.0 - apart * apart, 0.0)
            w = alike * alike / (1.0 + 0.25 * float(di * di + dj * dj))
            total += there * w
            weight += w
    smooth[i, j] = total / weight


@wp.kernel
def finish(
    levels: wp.array2d(dtype=wp.vec3),
    soft: wp.array2d(dtype=wp.vec3),
    sharpening: float,
    contrast: float,
    saturation: float,
    colour: wp.array3d(dtype=wp.uint8),
):
    """Sharpen the brightness with an unsharp mask, stretch it about middle grey, and move colours away from grey."""
    i, j = wp.tid()
    level = levels[i, j]
    grey = wp.dot(level, LUMA)
    bright = MIDDLE + (grey - MIDDLE) * contrast + sharpening * (grey - wp.dot(soft[i, j], LUMA))
    for channel in range(3):
        value = bright + (level[channel] - grey) * saturation * contrast
        colour[i, j, channel] = wp.uint8(int(wp.clamp(value, 0.0, 255.0) + 0.5))
