"""Daylight under water: the refracted sun, the sky, and the camera's fixed exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.core.geometry import Array
from oysterbench.recipe import LampRecipe, LightRecipe
from oysterbench.render.lamps import DAYLIGHT_LUX, lamp_spread
from oysterbench.render.water import IMAGE_CONE_RAD, Water, forward_share

WATER_INDEX = 1.34  # refractive index of sea water
GREY_ALBEDO = 0.16  # mean of a reef; exposed to GREY_LEVEL at GREY_RANGE_M
GREY_LEVEL = 0.20  # linear; 0.48 after gamma
GREY_RANGE_M = 1.6
LAMP_RANGE_M = 1.0  # at which lamps are metered
GREY_SLOPE = 0.5  # of the ray to the metered reef, below the horizon
AMBER_BALANCE, GREEN_BALANCE = 0.6, 0.35
"""Strength of the fixed white balance, in logarithm, from none (0) to neutral grey (1), between amber and blue and
between green and magenta. Cameras are tuned to lamps and daylight, which differ along the first axis, and leave much of
a cast along the second: hence the green of water. Accordingly, red is 0.9 to 1.0 of green in the real clips."""
MIXED = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5]  # Bayer matrix: neighbours differ most
LOWEST_LIGHT = 0.3  # cosine with the zenith: little light arrives at flatter angles
LEAST_SEEN = 1e-5  # relative to full daylight: too dark for any camera


@dataclass(frozen=True)
class Light:
    """Daylight just below the surface.

    sun_direction (3,): unit vector in `map` from a point under water towards the refracted sun. sun, sky: their
    shares of the downwelling irradiance on a horizontal plane, which together are 1 in every channel.
    """

    sun_direction: Array
    sun: float
    sky: float

    def steepest_lit_slope(self) -> float:
        """Slope (rise over run) of the sun's ray: ground nowhere steeper than this casts no shadow on itself."""
        return float(self.sun_direction[2] / max(np.hypot(*self.sun_direction[:2]), 1e-9))


def build_light(recipe: LightRecipe) -> Light:
    """Build the light of a recipe; the sun's ray is refracted by Snell's law at a level surface."""
    azimuth = np.deg2rad(recipe.sun_azimuth_deg)
    horizontal = np.cos(np.deg2rad(recipe.sun_elevation_deg)) / WATER_INDEX  # sin of the zenith angle in water
    vertical = np.sqrt(1.0 - horizontal**2)
    direction = np.array([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), vertical])
    return Light(np.round(direction, 7), 1.0 - recipe.sky_fraction, recipe.sky_fraction)


def shadow_reach(
    envelope: NDArray[np.floating], ground: NDArray[np.floating], cell: float, fan: NDArray[np.floating], longest: float
) -> NDArray[np.bool_]:
    """Mask (M, M) of the grid cells where things may shade the seabed; everywhere else no shadow ray is needed.

    envelope, ground (M, M): z of the upper surface with and without things on the bottom, indexed [y, x], m, on a
    grid of `cell` m; fan (N, 3): unit vectors towards the light; longest: length of the shadow rays, m. Conservative by
    one cell on all sides.
    """
    things = np.where(envelope > ground + 1e-3, envelope, -np.inf)
    tops = ndimage.maximum_filter(things, size=5)
    floor = ndimage.minimum_filter(ground, size=3)
    tallest = float(np.max(tops - floor, initial=0.0))
    shaded = np.zeros(envelope.shape, dtype=bool)
    rows, columns = np.arange(envelope.shape[0]), np.arange(envelope.shape[1])
    lifts: dict[tuple[int, int], float] = {}  # rise of the lowest ray by the time it is over a cell at that offset
    for direction in np.unique(np.asarray(fan, dtype=float), axis=0):
        for distance in np.arange(0.0, longest, cell):
            lift = (distance - cell) * direction[2]
            if lift > tallest:
                break
            column, row = np.round(distance * direction[:2] / cell).astype(int)
            lifts[row, column] = min(lifts.get((row, column), np.inf), lift)
    for (row, column), lift in lifts.items():
        over = tops[np.clip(rows + row, 0, len(rows) - 1)][:, np.clip(columns + column, 0, len(columns) - 1)]
        shaded |= over > floor + lift
    return shaded


def sky_fan() -> NDArray[np.float32]:
    """Directions (16, 3) in the hemisphere around z, with cosine-weighted density, in an order that mixes them."""
    k = np.arange(16)
    radius, turn = np.sqrt((k + 0.5) / 16), k * np.pi * (3.0 - np.sqrt(5.0))
    fan = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)], axis=1)
    return np.round(fan[MIXED], 7).astype(np.float32)


def sun_fan(light: Light, water: Water, depth_m: float) -> NDArray[np.float32]:
    """Directions (16, 3) in `map` towards the sun's light at a depth, with equal shares of it, mixed as in `sky_fan`.

    Of the light scattered by less than IMAGE_CONE_RAD, a share exp((F(r) - F(cone)) b z / mu) is scattered by less than
    r, in green: quasi-single scattering, as in Water; F is forward_share.
    """
    path = float(water.scattering[1]) * depth_m / light.sun_direction[2]
    angles = np.linspace(0.0, IMAGE_CONE_RAD, 200)
    within = np.exp([(forward_share(angle) - forward_share(IMAGE_CONE_RAD)) * path for angle in angles])
    k = np.arange(16)
    turned, turn = np.interp((k + 0.5) / 16, within, angles), k * np.pi * (3.0 - np.sqrt(5.0))
    side = np.cross([0.0, 1.0, 0.0], light.sun_direction)
    side /= np.linalg.norm(side)
    other = np.cross(light.sun_direction, side)
    across = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
    fan = np.cos(turned)[:, None] * light.sun_direction + np.sin(turned)[:, None] * across
    fan[:, 2] = np.maximum(fan[:, 2], LOWEST_LIGHT)
    fan /= np.linalg.norm(fan, axis=1, keepdims=True)
    return np.asarray(np.round(fan[MIXED], 6).astype(np.float32))


def exposure(
    water: Water, depth_m: float, daylight: float = 1.0, lamps: Sequence[LampRecipe] = (), factor: float = 1.0
) -> Array:
    """Gain (3,) from radiance (white matte surface under unit irradiance = 1) to the sensor's linear scale.

    Exposure and white balance of a camera that metered a grey reef at depth_m, GREY_RANGE_M away, and was then locked.
    daylight: as a share of full daylight; factor: on the lamps' intensity.
    """
    seen = daylight * water.seen(GREY_ALBEDO, depth_m - GREY_RANGE_M * GREY_SLOPE, GREY_RANGE_M, -GREY_SLOPE)
    left = np.exp(-LAMP_RANGE_M * lamp_spread(water)) * water.arriving(depth_m, LAMP_RANGE_M)
    for lamp in lamps:
        power = np.array(lamp.colour) * lamp.intensity_cd * factor / DAYLIGHT_LUX
        seen = seen + GREY_ALBEDO * power / LAMP_RANGE_M**2 * left
    seen = np.maximum(seen, LEAST_SEEN)
    balance = white_balance(seen)
    return np.asarray(GREY_LEVEL * balance / np.mean(balance * seen))


def white_balance(seen: Array) -> Array:
    """White-balance gains (3,), up to a common factor, for a mean radiance (3,): part of the way to neutral grey."""
    amber, green = np.log(seen[0] / seen[2]) / 2, np.log(seen[1]) - np.log(seen[0] * seen[2]) / 2
    return np.asarray(np.exp([-AMBER_BALANCE * amber, -GREEN_BALANCE * green, AMBER_BALANCE * amber]))
