"""Magnetometer: the Earth's field in the sensor's frame, bent by the iron that the vehicle carries."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import MagnetometerRecipe, SiteRecipe
from oysterbench.scene.path import Path

MICROTESLA = 1e-6  # T


def earth_field(site: SiteRecipe) -> Array:
    """The Earth's magnetic field (3,) T at the site, in `map` (east, north, up)."""
    dip, east_of_north = np.radians(site.inclination_deg), np.radians(site.declination_deg)
    level = np.cos(dip)
    direction = [level * np.sin(east_of_north), level * np.cos(east_of_north), -np.sin(dip)]
    return site.field_ut * MICROTESLA * np.array(direction)


def measure(path: Path, recipe: MagnetometerRecipe, site: SiteRecipe, times_s: Array, streams: Streams) -> Array:
    """Field (N, 3) T that the sensor reports at times (N,) s, in its own frame.

    b = A R^T B + h + noise, with soft iron A and hard iron h (Gebre-Egziabher et al. 2006), in the steps of the
    digital reading.
    """
    rotation = path.at(times_s).rotation @ Rotation.from_euler("xyz", recipe.rpy_deg, degrees=True).as_matrix()
    earth = np.einsum("nji,j->ni", rotation, earth_field(site))
    noise = recipe.noise_ut * streams.generator("magnetometer", "noise").standard_normal((len(times_s), 3))
    field = earth @ np.asarray(recipe.soft_iron).T + MICROTESLA * (np.asarray(recipe.hard_iron_ut) + noise)
    step = recipe.step_ut * MICROTESLA
    return np.rint(field / step) * step if step else field


def noise_variance(recipe: MagnetometerRecipe) -> float:
    """Variance (T^2) of an axis of a reading about its mean: of its noise and of its steps."""
    return MICROTESLA**2 * (recipe.noise_ut**2 + recipe.step_ut**2 / 12)
