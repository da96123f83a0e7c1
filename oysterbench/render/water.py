"""What a camera sees through water: tables over range, depth and direction, from spectra of absorption and scattering.

Light from a surface at range r arrives sharp (`direct`), or blurred by small-angle scattering on its way
(`forward_scatter`); the water in between adds veiling light. At each wavelength, with c = a + b and F the share of
scattering that stays within IMAGE_CONE_RAD of its direction and therefore in the image,

    direct = exp(-c r)
    direct + forward_scatter = exp(-c' r),   c' = a + (1 - F) b              (quasi-single scattering, Gordon 1973)
    veil   = L(z, mu) - exp(-c' r) L(z - mu r, mu)                           (Duntley, J. Opt. Soc. Am. 53, 1963)

where L is the radiance of all orders of scattering in deep water (render/radiance.py), and mu the cosine of the view
ray with the zenith. Integrated over a camera's response, attenuation falls with range (Akkaynak & Treibitz 2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from oysterbench.core.geometry import Array
from oysterbench.recipe import WaterRecipe
from oysterbench.render.radiance import Daylight, solve_daylight
from oysterbench.render.spectra import camera_weights, molecular_scattering, water_constituents

ASYMMETRY = 0.92  # of the Henyey-Greenstein phase function; gives a backscattered share of 0.018, as Petzold measured
IMAGE_CONE_RAD = float(np.deg2rad(45.0))
"""Light scattered by less than this still belongs to the scene's surface, only softened; the rest is replaced by other
light scattered in. Path tracing gives 45 to 60 deg (tests/render/test_against_mitsuba.py); exp(-c r) alone is too
dark."""
GLOW_SPREAD_RAD = 0.053
"""Standard deviation of the blur along either axis of the image: that of a blur of median radius 3.6 deg, half the
median angle of scattering within the cone, as light is scattered anywhere between surface and camera."""

LEAST_SCATTERING = 1e-9
"""Smallest scattering, 1/m: far below that of any water, but enough for the spectrum of a veil to be defined."""

LEAST_RADIANCE = 1e-30
LEAST_STRETCH = 1e-3
NEARBY_M = 1e-3  # step of a finite difference over depth

RANGES, DEPTHS, COSINES = 384, 40, 41  # nodes of the tables
OPAQUE = 8.0  # optical depth beyond which a surface is invisible
SHORTEST_M, LONGEST_M = 6.0, 120.0  # bounds of the range axis


@dataclass(frozen=True)
class Water:
    """Tables for red, green and blue. A radiance of 1 is that of a white matte surface under surface daylight.

    ranges (R,), depths (D,), in m, and cosines (K,) of the view ray with the zenith: evenly spaced axes.
    direct, forward_scatter (D, R, 3): shares of a surface's daylight signal that arrive sharp and blurred by
    spread_rad, for a surface at that depth. daylight (D, 3): downwelling irradiance over that just below the surface;
    beam (D, 3): the share of it that still comes from around the sun, scattered by less than IMAGE_CONE_RAD, and casts
    shadows.
    veil (D, K, 3): radiance of an infinite path from a camera at that depth; saturation (D, R, 3): the share of it that
    a path of that range contributes, for a horizontal ray; for other rays, look it up at range * stretch.
    stretch (D, K, 3): how much faster a ray of that cosine saturates than a level one, initially. absorption,
    scattering (3,): averages over the camera's bands, 1/m; asymmetry: of the phase function.
    """

    ranges: Array
    depths: Array
    cosines: Array
    direct: Array
    forward_scatter: Array
    saturation: Array
    veil: Array
    daylight: Array
    beam: Array
    stretch: Array
    absorption: Array
    scattering: Array
    asymmetry: float = ASYMMETRY
    spread_rad: float = GLOW_SPREAD_RAD

    def daylight_at(self, depth_m: float) -> Array:
        """Downwelling irradiance (3,) at a depth, m, over that just below the surface."""
        return _look_up(self.daylight, (depth_m / self.depths[1],))

    def arriving(self, depth_m: float, range_m: float) -> Array:
        """Share (3,) of the signal of a surface at depth_m that arrives over range_m, sharp or blurred."""
        place = (depth_m / self.depths[1], range_m / self.ranges[1])
        return _look_up(self.direct + self.forward_scatter, place)

    def veiling(self, depth_m: float, range_m: float, cosine: float) -> Array:
        """Veiling light (3,) that a camera at depth_m sees along a view ray of range_m."""
        row = depth_m / self.depths[1]
        column = (cosine + 1.0) / (self.cosines[1] - self.cosines[0])
        stretched = range_m * _look_up(self.stretch, (row, column)) / self.ranges[1]
        shares = [_look_up(self.saturation, (row, place))[i] for i, place in enumerate(stretched)]
        return np.asarray(_look_up(self.veil, (row, column)) * np.array(shares))

    def seen(self, albedo: ArrayLike, camera_depth_m: float, range_m: float, cosine: float) -> Array:
        """Mean radiance (3,) of a level matte surface of a given albedo, seen from camera_depth_m over range_m."""
        depth = camera_depth_m - cosine * range_m
        surface = np.asarray(albedo) * self.daylight_at(depth) * self.arriving(depth, range_m)
        return surface + self.veiling(camera_depth_m, range_m, cosine)


@lru_cache(maxsize=8)  # shared by all cameras, sonars and rollouts of a reef; solving it takes half a second
def build_water(recipe: WaterRecipe, daylight: Daylight | None = None, deepest_m: float = 10.0) -> Water:
    """Build the tables of a recipe's water under a given daylight, for cameras and surfaces down to deepest_m."""
    water = water_constituents(recipe)
    b = water.scatter()
    molecular = np.minimum(molecular_scattering(), b)
    return tabulate(water.absorption(), b, camera_weights(), daylight or Daylight(), deepest_m, molecular)


def tabulate(
    a: Array, b: Array, weights: Array, daylight: Daylight, deepest_m: float, molecular: ArrayLike = 0.0
) -> Water:
    """Build tables from absorption a and scattering b (L,), 1/m, and weights (3, L) of the wavelengths per channel.

    molecular (L,): the part of b due to water itself, nearly isotropic; none of it stays in the image.
    """
    b = np.maximum(b, LEAST_SCATTERING)
    c = a + b
    clear = np.broadcast_to(molecular, b.shape)
    image = c - forward_share(IMAGE_CONE_RAD) * (b - clear)
    span = float(np.clip(OPAQUE / image.min(), SHORTEST_M, LONGEST_M))
    ranges, depths = np.linspace(0.0, span, RANGES), np.linspace(0.0, deepest_m, DEPTHS)
    cosines = np.linspace(-1.0, 1.0, COSINES)

    fields = [solve_daylight(x, y, ASYMMETRY, daylight, z) for x, y, z in zip(a, b, clear, strict=True)]
    irradiance = np.stack([field.irradiance(depths) for field in fields], axis=1)  # (D, L)
    radiance = np.stack([field.radiance(depths, cosines) for field in fields], axis=2)
    radiance = np.maximum(radiance, 0.0)  # (D, K, L)
    horizontal = radiance[:, COSINES // 2]

    beam = (1.0 - daylight.sky) * np.exp(-depths[:, None] / daylight.sun_cosine * image)  # (D, L)

    signal = irradiance[:, None] * weights  # (D, 3, L)
    direct = _attenuate(signal, c, ranges)
    arriving = _attenuate(signal, image, ranges)
    ambient = horizontal[:, None] * weights
    nearby = np.stack([field.radiance(depths + NEARBY_M, cosines) for field in fields], axis=2)
    slope = image * radiance + cosines[:, None] * (nearby - radiance) / NEARBY_M  # initial slope of the veil
    filling = np.maximum(slope, 0.0) @ weights.T / np.maximum(radiance @ weights.T, LEAST_RADIANCE)  # (D, K, 3), 1/m
    level = filling[:, COSINES // 2, None]
    return Water(
        ranges=ranges,
        depths=depths,
        cosines=cosines,
        direct=steady(direct),
        forward_scatter=steady(arriving - direct),
        saturation=steady(1.0 - _attenuate(ambient, image, ranges)),
        veil=steady(np.pi * radiance @ weights.T),
        daylight=steady(irradiance @ weights.T),
        beam=steady(np.minimum(beam @ weights.T / (irradiance @ weights.T), 1.0 - daylight.sky)),
        stretch=steady(np.maximum(filling / level, LEAST_STRETCH)),
        absorption=steady(weights @ a),
        scattering=steady(weights @ b),
    )


def _attenuate(signal: Array, coefficient: Array, ranges: Array) -> Array:
    """Share (D, R, 3) of a signal (D, 3, L) left after ranges (R,), m, with an attenuation (L,) per wavelength, 1/m."""
    left = np.exp(-ranges[:, None] * coefficient)
    spectrum = signal / signal.sum(axis=2, keepdims=True)
    return np.swapaxes(spectrum @ left.T, 1, 2)


def steady(values: Array) -> Array:
    """Round values to 20 bits, so that the last bits of another processor's linear algebra do not matter."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2**20) / 2**20, exponent)


def _look_up(table: Array, place: tuple[float, ...]) -> Array:
    """Interpolate a table (..., 3) linearly at fractional indices, clamped."""
    at = np.array([[float(p)] for p in place])
    return np.array([map_coordinates(table[..., i], at, order=1, mode="nearest")[0] for i in range(3)])


def phase(angle: float, g: float = ASYMMETRY) -> float:
    """Henyey-Greenstein phase function (Henyey & Greenstein 1941) at a scattering angle in rad, 1/sr."""
    return float((1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * np.cos(angle)) ** 1.5))


def forward_share(angle: float, g: float = ASYMMETRY) -> float:
    """Share of scattered light turned by less than `angle` (rad): the integral of `phase` over that cone."""
    return float((1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g - 2 * g * np.cos(angle))))
