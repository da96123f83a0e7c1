"""Effect of added particles on a water's light, per unit of them: the difference of the solutions with and without.

There are two kinds: more of the water's own particles, and silt, which is mineral and so nearly the same at all
wavelengths. Because the difference is that of two full solutions, water with a unit of an admixture everywhere looks
like water whose recipe contains it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import WaterRecipe
from oysterbench.render.radiance import Daylight, solve_daylight
from oysterbench.render.spectra import (
    NAP_SLOPE,
    REFERENCE_NM,
    SCATTERING_NM,
    WATER_ABSORPTION,
    Constituents,
    camera_weights,
    molecular_scattering,
    water_constituents,
)
from oysterbench.render.water import ASYMMETRY, IMAGE_CONE_RAD, LEAST_RADIANCE, NEARBY_M, Water, forward_share, steady

SILT_SLOPE = 0.4
"""Exponent of silt's scattering over wavelength: 0.1 to 1.2 in three estuaries, lowest where mineral (Doxaran, Babin &
Leymarie, Optics Express 15, 2007); Babin et al. 2003 find it small in all coastal waters."""
SILT_ABSORPTION = 0.08
"""Silt's absorption at 440 nm over its scattering at 550 nm: 0.041 over 0.51 m^2/g (Babin et al., J. Geophys. Res. 108
and Limnol. Oceanogr. 48, 2003, means of coastal waters)."""
SILT_UNIT = 5.0  # attenuation of silt, 1/m, for which the light in a plume is solved
LEAST_AMOUNT = 1e-3  # unit metres
LEAST_MORE = 0.25  # smallest relative excess of own particles, for the two solutions to differ


@dataclass(frozen=True)
class Admixture:
    """Effect of one unit of particles: direct, image, veil (R, 3), 1/m: attenuation of the sharp and of all the light
    of a surface in daylight, and of the light that the water scatters in, at the ranges of the water's tables.
    scattering, spread (3,), 1/m: scattering and attenuation of a lamp's light. dimming (D, 3), 1/m: attenuation of
    daylight per metre of water above, at the depths of the tables. glow (D, K, 3), 1/m: radiance scattered into a view
    ray per metre, over the irradiance there (times pi, as Water.veil)."""

    direct: Array
    image: Array
    veil: Array
    scattering: Array
    spread: Array
    dimming: Array
    glow: Array


@dataclass(frozen=True)
class Ambient:
    """Uniform water without admixtures. glow (D, K, 3), 1/m, as in Admixture; left (R, 3): share of it that is left
    after the ranges; sky (K, 3): radiance just below the surface, times pi, over the irradiance there."""

    glow: Array
    left: Array
    sky: Array


def silt(attenuation: float) -> Constituents:
    """Silt with the given attenuation at 550 nm, 1/m."""
    absorbed = SILT_ABSORPTION * np.exp(-NAP_SLOPE * (SCATTERING_NM - REFERENCE_NM))
    scattering = attenuation / (1.0 + float(absorbed))
    return Constituents(cdom=0.0, nap=SILT_ABSORPTION * scattering, algae=0.0, scattering=scattering, slope=SILT_SLOPE)


def admixtures(
    recipe: WaterRecipe, water: Water, daylight: Daylight, depth_m: float
) -> tuple[Ambient, Admixture, Admixture]:
    """Uniform water, more of its own particles, and silt, for surfaces about depth_m below the water's surface.

    One unit of its own particles doubles them; one unit of silt attenuates by 1 per metre at 550 nm.
    """
    there = water_constituents(recipe)
    own = dataclasses.replace(there, cdom=0.0)
    more = max(recipe.layer.factor - 1.0, recipe.patches.contrast, LEAST_MORE)
    even = Solution(there.absorption(), there.scatter(), daylight)
    sky = np.stack([field.radiance(np.zeros(1), water.cosines)[0] for field in even.fields], axis=1)  # (K, L)
    nothing = np.zeros((len(water.ranges), 1))
    ambient = Ambient(
        glow=steady(_glow(even, water)),
        left=steady(_left(even.level_source(depth_m), even.image, water.ranges, even.image, nothing)),
        sky=steady(np.pi * np.maximum(sky, 0.0) @ camera_weights().T),
    )
    own_along, silt_along = more * water.ranges, np.ones(len(water.ranges))
    return (
        ambient,
        _admixture(even, own, more, own_along, True, water, daylight, depth_m),
        _admixture(even, silt(1.0), SILT_UNIT, silt_along, False, water, daylight, depth_m),
    )


class Solution:
    """The light field in water of absorption a and scattering b (L,), 1/m, solved for a given daylight."""

    def __init__(self, a: Array, b: Array, daylight: Daylight) -> None:
        self.a, self.b = a, b
        clear = np.minimum(molecular_scattering(), b)
        self.image = a + b - forward_share(IMAGE_CONE_RAD) * (b - clear)
        lines = zip(self.a, self.b, clear, strict=True)
        self.fields = [solve_daylight(x, y, ASYMMETRY, daylight, z) for x, y, z in lines]

    def irradiance(self, depths: Array) -> Array:
        """Irradiance (D, L) at depths (D,) m over that just below the surface."""
        return np.stack([field.irradiance(depths) for field in self.fields], axis=1)

    def source(self, depths: Array, cosines: Array) -> Array:
        """Radiance (D, K, L) that water adds to a view ray per metre, 1/m: c' L + mu dL / dz, the initial slope of the
        veil."""
        here, nearby = (
            np.stack([f.radiance(z, cosines) for f in self.fields], axis=2) for z in (depths, depths + NEARBY_M)
        )
        slope = self.image * np.maximum(here, 0.0) + cosines[:, None] * (nearby - here) / NEARBY_M
        return np.asarray(np.maximum(slope, LEAST_RADIANCE))

    def level_source(self, depth_m: float) -> Array:
        """Source along a level ray, weighted for each channel (3, L)."""
        return np.asarray(camera_weights() * self.source(np.array([depth_m]), np.zeros(1))[0])


def _glow(solution: Solution, water: Water) -> Array:
    """Glow (D, K, 3), 1/m, of a solution at the depths and cosines of the water's tables; see Admixture."""
    weights = camera_weights()
    irradiance = np.maximum(solution.irradiance(water.depths) @ weights.T, LEAST_RADIANCE)
    return np.asarray(np.pi * solution.source(water.depths, water.cosines) @ weights.T / irradiance[:, None])


def _admixture(
    even: Solution,
    particles: Constituents,
    more: float,
    along: Array,
    everywhere: bool,
    water: Water,
    daylight: Daylight,
    depth_m: float,
) -> Admixture:
    """Effect per unit of particles, from the difference of the solutions with and without `more` units of them.

    along (R,), unit metres: amount of them on the way to the water's ranges for which the attenuations are exact.
    everywhere: whether they also colour the daylight at depth_m.
    """
    weights, depths = camera_weights(), water.depths
    a, b = particles.absorption() - WATER_ABSORPTION, particles.scatter()
    solved = Solution(even.a + more * a, even.b + more * b, daylight)
    image = a + (1.0 - forward_share(IMAGE_CONE_RAD)) * b
    light = [solution.irradiance(depths[1:]) @ weights.T for solution in (even, solved)]
    dimming = np.log(light[0] / light[1]) / (more * depths[1:, None])
    amount = np.maximum(along, LEAST_AMOUNT)[:, None]
    coloured = solved if everywhere else even
    surface = [weights * solution.irradiance(np.array([depth_m])) for solution in (even, coloured)]
    source = [solution.level_source(depth_m) for solution in (even, coloured)]

    def attenuation(signals: list[Array], before: Array, unit: Array) -> Array:
        without = _left(signals[0], before, water.ranges, unit, 0.0 * amount)
        return steady(np.log(without / _left(signals[1], before, water.ranges, unit, amount)) / amount)

    return Admixture(
        direct=attenuation(surface, even.a + even.b, a + b),
        image=attenuation(surface, even.image, image),
        veil=attenuation(source, even.image, image),
        scattering=steady(weights @ b),
        spread=steady(weights @ image),
        dimming=steady(np.vstack([dimming[:1], dimming])),
        glow=steady((_glow(solved, water) - _glow(even, water)) / more),
    )


def _left(signal: Array, even: Array, ranges: Array, unit: Array, amount: Array) -> Array:
    """Share (R, 3) of a signal (3, L) left after ranges (R,) m of water that attenuates by `even` (L,), 1/m, and an
    amount (R, 1) of particles that attenuate by `unit` (L,), 1/m."""
    left = np.exp(-ranges[:, None] * even - amount * unit)
    return np.asarray(left @ (signal / signal.sum(axis=1, keepdims=True)).T)
