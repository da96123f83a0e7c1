"""Pressure sensor: the weight of air and water above it, with the tide and the waves of the site."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyval

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import PressureRecipe, SiteRecipe
from oysterbench.scene.path import Path
from oysterbench.scene.rig import GRAVITY
from oysterbench.scene.waves import Waves

ATMOSPHERE = 101_325.0
"""Pressure at the surface, Pa."""

FRESH = (999.842594, 6.793952e-2, -9.095290e-3, 1.001685e-4, -1.120083e-6, 6.536332e-9)
SALT = (8.24493e-1, -4.0899e-3, 7.6438e-5, -8.2467e-7, 5.3875e-9)
SALT_ROOT = (-5.72466e-3, 1.0227e-4, -1.6546e-6)
SALT_SQUARED = 4.8314e-4
"""kg/m^3 by powers of deg C: of pure water, and with salinity S, S^1.5 and S^2 (Millero & Poisson 1981; UNESCO 44)."""


def density(site: SiteRecipe) -> float:
    """Of the site's water at the surface, kg/m^3: the one-atmosphere equation of state EOS-80."""
    t, s = site.temperature_c, site.salinity_ppt
    return float(polyval(t, FRESH) + polyval(t, SALT) * s + polyval(t, SALT_ROOT) * s**1.5 + SALT_SQUARED * s**2)


def depth_of(pressure: Array, site: SiteRecipe) -> Array:
    """Depth (N,) m below the mean surface in still water at absolute pressures (N,) Pa."""
    return (np.asarray(pressure) - ATMOSPHERE) / (density(site) * GRAVITY)


def measure(
    path: Path, recipe: PressureRecipe, site: SiteRecipe, waves: Waves, times_s: Array, streams: Streams
) -> Array:
    """Absolute pressure (N,) Pa that the sensor reports at times (N,) s.

    waves: those of the site (`build_waves`), which also move the vehicle. Where the sensor leaves the water it feels
    the air.
    """
    motion = path.at(times_s)
    place = motion.position + motion.rotation @ np.asarray(recipe.position_m)
    head = np.maximum(tide(site, times_s, streams) - place[:, 2] + waves.head(place, times_s), 0.0)
    offset = recipe.offset_m * streams.generator("pressure", "offset").standard_normal()
    noise = recipe.noise_m * streams.generator("pressure", "noise").standard_normal(len(times_s))
    weight = density(site) * GRAVITY
    pressure = ATMOSPHERE + weight * np.minimum(head + offset + noise, recipe.max_depth_m)
    return np.rint(pressure / recipe.step_pa) * recipe.step_pa if recipe.step_pa else pressure


def tide(site: SiteRecipe, times_s: Array, streams: Streams) -> Array:
    """Height (N,) m of the tide above z = 0: a sine that the sequence meets anywhere."""
    phase = streams.generator("site", "tide").uniform(0, 2 * np.pi)
    return site.tide_m * np.sin(2 * np.pi * times_s / (3600.0 * site.tide_period_h) + phase)


def noise_variance(recipe: PressureRecipe, site: SiteRecipe) -> float:
    """Variance (Pa^2) of a reading about its mean: of its noise and of its steps."""
    return (density(site) * GRAVITY * recipe.noise_m) ** 2 + recipe.step_pa**2 / 12
