"""The sensor: vignetting, exposure and gain, noise, and quantisation to 8 bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe
from oysterbench.render.target import KERNEL_OPTIONS

wp.set_module_options(KERNEL_OPTIONS)

FULL_WELL = 6000.0  # electrons: the variance of shot noise is signal / FULL_WELL
READ_NOISE = 0.0015  # relative to full scale, before gain
GAMMA_LEVELS = 8192
HOT_PER_S = 6.0  # mean dark signal of a hot pixel over full scale, exponentially distributed: 0.15 in 25 ms
INSTANT_S = 0.010  # exposure time assumed for hot pixels if the shutter is open for an instant


def vignette(rays: NDArray[np.float32], camera: CameraRecipe) -> NDArray[np.float32]:
    """Share (H, W) of light that reaches each pixel: cos^4 of the angle from the axis, to the degree that the recipe
    asks for.

    rays (H + 2, W + 2, 3): as from lens.pixel_rays.
    """
    inside = rays[1:-1, 1:-1].astype(float)
    cosine2 = 1.0 / (1.0 + inside[..., 0] ** 2 + inside[..., 1] ** 2)
    share = 1.0 - camera.vignetting * (1.0 - cosine2**2)
    return np.round(share, 6).astype(np.float32)


def gamma_table() -> NDArray[np.uint8]:
    """sRGB codes (GAMMA_LEVELS,) of equally spaced linear levels from 0 to 1 (IEC 61966-2-1)."""
    linear = np.linspace(0.0, 1.0, GAMMA_LEVELS)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


@dataclass(frozen=True)
class Exposure:
    """Exposure of an image. shutter_s: time for which the shutter is open; 0 for an instant. gain: amplification.
    scale (3,): factor from radiance to the linear scale of the sensor, including gain and white balance."""

    shutter_s: float
    gain: float
    scale: Sequence[float]


def dark_signal(camera: CameraRecipe, streams: Streams) -> NDArray[np.float32]:
    """Signal (H, W, 3) added by hot pixels, per s and unit gain, each in the colour of its place in a Bayer mosaic
    (RGGB).

    Bilinear demosaicing spreads it over the neighbours.
    """
    shape = (camera.height, camera.width)
    generator = streams.generator("hot_pixels")
    n = round(camera.hot_pixels * 1e-6 * camera.height * camera.width)
    places = generator.choice(camera.height * camera.width, size=n, replace=False)
    rates = np.round(HOT_PER_S * generator.standard_exponential(n), 5)
    rows, columns = np.unravel_index(places, shape)
    signal = np.zeros((*shape, 3), dtype=np.float32)
    for row, column, rate in zip(rows.tolist(), columns.tolist(), rates.tolist(), strict=True):
        channel = row % 2 + column % 2
        for i in range(max(row - 1, 0), min(row + 2, shape[0])):
            for j in range(max(column - 1, 0), min(column + 2, shape[1])):
                steps = abs(i - row) + abs(j - column)
                share = (1.0, 0.25, 0.0)[steps] if channel == 1 else (1.0, 0.5, 0.25)[steps]
                signal[i, j, channel] += np.float32(share * rate)
    return signal


@wp.kernel
def part(
    share: float,
    silted: wp.array2d(dtype=wp.float32),
    forward_scatter: wp.array2d(dtype=wp.vec3),
    soft: wp.array2d(dtype=wp.vec3),
):
    """Move the part of the forward-scattered light to be blurred to `soft`: a share, and all that silt scatters."""
    i, j = wp.tid()
    moved = forward_scatter[i, j] * (share + (1.0 - share) * silted[i, j])
    forward_scatter[i, j] = forward_scatter[i, j] - moved
    soft[i, j] = moved


@wp.kernel
def compose(
    sharp: wp.array2d(dtype=wp.vec3),
    forward_scatter: wp.array2d(dtype=wp.vec3),
    blurred: wp.array2d(dtype=wp.vec3),
    backscatter: wp.array2d(dtype=wp.vec3),
    share: float,
    parted: int,
    radiance: wp.array2d(dtype=wp.vec3),
):
    """Compute the radiance that arrives in a pixel from surfaces and water.

    share: blurred share of the forward-scattered light; if `parted` is not 0, both parts count in full.
    """
    i, j = wp.tid()
    total = sharp[i, j] + backscatter[i, j]
    if parted != 0:
        total += forward_scatter[i, j] + blurred[i, j]
    else:
        total += forward_scatter[i, j] * (1.0 - share)
        if share > 0.0:
            total += blurred[i, j] * share
    radiance[i, j] = total


@wp.kernel
def add_flakes(snow: wp.array3d(dtype=wp.int32), unit: float, radiance: wp.array2d(dtype=wp.vec3)):
    """Add flakes in front of an image: their light and their opacity, counted in units."""
    i, j = wp.tid()
    hidden = wp.min(float(snow[i, j, 3]) * unit, 1.0)
    light = wp.vec3(float(snow[i, j, 0]), float(snow[i, j, 1]), float(snow[i, j, 2])) * unit
    radiance[i, j] = radiance[i, j] * (1.0 - hidden) + light


@wp.kernel
def apply_sensor_model(
    radiance: wp.array2d(dtype=wp.vec3),
    vignetting: wp.array2d(dtype=wp.float32),
    noise: wp.array3d(dtype=wp.float32),
    dark: wp.array2d(dtype=wp.vec3),
    dark_s: float,
    gain: wp.vec3,
    shot: float,
    read: float,
    gamma: wp.array(dtype=wp.uint8),
    colour: wp.array3d(dtype=wp.uint8),
):
    """Apply exposure, shot and read noise (variance = shot * signal + read^2), clipping, gamma by table, and 8 bits.

    dark: signal of hot pixels per s of `dark_s`, which is 0 if there are none.
    """
    row, column = wp.tid()
    signal = wp.cw_mul(radiance[row, column], gain) * vignetting[row, column]
    if dark_s > 0.0:
        signal += dark[row, column] * dark_s
    levels = float(gamma.shape[0] - 1)
    for channel in range(3):
        s = signal[channel]
        noisy = s + wp.sqrt(shot * s + read * read) * noise[row, column, channel]
        colour[row, column, channel] = gamma[int(wp.clamp(noisy, 0.0, 1.0) * levels + 0.5)]
