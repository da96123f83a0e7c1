"""Underwater acoustics: speed and absorption of sound, backscatter of surfaces, and beam patterns."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

from oysterbench.core.geometry import Array, transform
from oysterbench.recipe import CLASSES, SiteRecipe
from oysterbench.recipe.sensors import AcousticRecipe

BOTTOM_DB = {"mud": -32.0, "sand": -24.0, "gravel": -17.0, "shell": -16.0}
"""Lambert's parameter 10 log10(mu) of bottom types at hundreds of kHz, dB: engineering values, of the order of those in
APL-UW 1994 (TR 9407, sec. IV); measurements on bottoms of the same name scatter by 5 dB or more either way."""

CLASS_DB = {"oyster": -13.0, "stone": -14.0, "plant": -26.0, "sponge": -22.0, "vehicle": -8.0, "hash": -16.0}
CLASS_DB |= {"fish": -14.0, "crab": -15.0, "debris": -26.0, "tether": -18.0}
"""Lambert's parameter, dB, of what lies on the bottom and swims over it: engineering values; shell and stone are rough
and at least as hard as gravel, plants, sponges and debris are nearly water, and fish echo by their swim bladders."""

NEAREST_M = 0.01  # closer to a transducer than this, the far-field model does not apply

HALF_POWER = 0.442946
"""Solution x of sinc(x)^2 = 1/2, where sinc(x) = sin(pi x) / (pi x)."""


def sound_speed(site: SiteRecipe, depth_m: float) -> float:
    """Speed of sound in m/s at a depth in m (Medwin 1975, eq. 1)."""
    t, s = site.temperature_c, site.salinity_ppt
    return 1449.2 + 4.6 * t - 0.055 * t**2 + 0.00029 * t**3 + (1.34 - 0.010 * t) * (s - 35) + 0.016 * depth_m


def absorption(site: SiteRecipe, depth_m: float, frequency_khz: float) -> float:
    """Absorption of sound in dB/m, one way (Francois & Garrison 1982, part II, table IV).

    The sum of the relaxation of boric acid, that of magnesium sulphate, and the viscosity of pure water.
    """
    t, s, f = site.temperature_c, site.salinity_ppt, frequency_khz
    kelvin = 273.0 + t
    speed = 1412 + 3.21 * t + 1.19 * s + 0.0167 * depth_m
    boric_khz = 2.8 * np.sqrt(s / 35) * 10 ** (4 - 1245 / kelvin)
    boric = 8.86 / speed * 10 ** (0.78 * site.ph - 5) * boric_khz * f**2 / (boric_khz**2 + f**2)
    sulphate_khz = 8.17 * 10 ** (8 - 1990 / kelvin) / (1 + 0.0018 * (s - 35))
    pressed = 1 - 1.37e-4 * depth_m + 6.2e-9 * depth_m**2
    sulphate = 21.44 * s / speed * (1 + 0.025 * t) * pressed * sulphate_khz * f**2 / (sulphate_khz**2 + f**2)
    if t <= 20:
        water = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
    else:
        water = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
    viscous = water * (1 - 3.83e-5 * depth_m + 4.9e-10 * depth_m**2) * f**2
    return float(boric + sulphate + viscous) / 1000.0


def backscatter(bottom: str) -> Array:
    """Lambert's mu (12,) of each class of recipe.CLASSES, for a bottom type of recipe.BOTTOMS; 0 for water.

    A patch dA seen at the angle theta from its normal returns, per unit solid angle, mu cos^2(theta) dA of the power
    that arrives per unit area (Lambert's law).
    """
    decibels = {"bottom": BOTTOM_DB[bottom], **CLASS_DB}
    return np.array([10 ** (decibels[name] / 10) if name in decibels else 0.0 for name in CLASSES.values()])


def range_resolution(speed_m_s: float, bandwidth_khz: float) -> float:
    """Range resolution of a pulse, c / 2B, m."""
    return speed_m_s / (2e3 * bandwidth_khz)


def beam_pattern(angles: ArrayLike, width: float) -> Array:
    """Two-way power response at angles (rad) off a line aperture's axis: 1 on the axis and 1/2 at half its width (rad).

    sinc^2 of the sine of the angle, the pattern of a uniformly weighted aperture (Urick 1983, sec. 3.3).
    """
    return np.asarray(np.sinc(HALF_POWER / np.sin(width / 2) * np.sin(angles)) ** 2)


def first_null(width: float) -> float:
    """Angle (rad) off the axis at which `beam_pattern` first vanishes; pi/2 where it does not."""
    return float(np.arcsin(min(np.sin(width / 2) / HALF_POWER, 1.0)))


def aperture(width: float) -> float:
    """Integral of the two-way response over the elevations up to its first nulls, per radian of azimuth, rad."""
    limit = first_null(width)
    fine = 4096
    elevations = limit * ((np.arange(fine) + 0.5) / fine * 2 - 1)
    return float(np.round(np.sum(beam_pattern(elevations, width) * np.cos(elevations)) * 2 * limit / fine, 12))


def mount_pose(recipe: AcousticRecipe) -> Array:
    """T_base_sensor (4, 4) of a frame with x along the sensor's axis, y left, z up."""
    from_euler = scipy.spatial.transform.Rotation.from_euler
    turn = from_euler("ZY", [recipe.yaw_deg, recipe.pitch_deg], degrees=True).as_matrix()
    return transform(turn, recipe.position_m)


def echo_strength(ranges: Array, cosines: Array, mu: Array, absorption_db_m: float) -> Array:
    """Ratio of returned to transmitted power of the patch in a unit of solid angle, in the shape of the arguments.

    ranges: m, inf for no patch; ranges below NEAREST_M are raised to it. A solid angle dW holds a patch of
    dA = r^2 dW / cos(theta), and each way costs r^-2 and the absorption:
    mu cos^2(theta) dA r^-4 10^(-2 a r / 10) = mu cos(theta) dW r^-2 10^(-2 a r / 10).
    """
    heard = np.isfinite(ranges)
    near = np.where(heard, np.maximum(ranges, NEAREST_M), 1.0)
    return np.where(heard, mu * cosines * near**-2.0 * 10 ** (-0.2 * absorption_db_m * near), 0.0)
