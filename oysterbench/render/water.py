"""Optics of the water: coefficients of the Jerlov types, and image formation along a ray.

Revised underwater model (Akkaynak & Treibitz, CVPR 2018, eq. 20): I = J exp(-bD z) + Binf (1 - exp(-bB z)), with
separate coefficients for the direct light and for the backscatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.recipe import WaterRecipe

Array = NDArray[np.float64]

JERLOV = {  # a, b, Kd in 1/m, each at (650, 550, 450) nm
    "I": ((0.460, 0.062, 0.018), (0.0008, 0.0017, 0.0042), (0.356, 0.064, 0.018)),
    "IA": ((0.461, 0.062, 0.022), (0.002, 0.0035, 0.007), (0.360, 0.067, 0.026)),
    "IB": ((0.461, 0.062, 0.024), (0.043, 0.054, 0.070), (0.365, 0.072, 0.036)),
    "II": ((0.462, 0.062, 0.025), (0.250, 0.358, 0.524), (0.384, 0.086, 0.071)),
    "III": ((0.465, 0.065, 0.041), (0.683, 0.980, 1.43), (0.418, 0.114, 0.138)),
    "1C": ((0.480, 0.076, 0.120), (0.254, 0.365, 0.534), (0.453, 0.142, 0.205)),
    "3C": ((0.484, 0.082, 0.182), (0.741, 1.06, 1.56), (0.46, 0.19, 0.39)),
    "5C": ((0.520, 0.117, 0.347), (0.929, 1.33, 1.94), (0.54, 0.30, 0.56)),
    "7C": ((0.578, 0.195, 0.620), (1.64, 2.35, 3.43), (0.63, 0.46, 0.89)),
    "9C": ((0.621, 0.348, 1.06), (2.17, 3.12, 4.56), (0.76, 0.63, 1.6)),
}
"""Absorption and scattering as public simulators carry them (to be re-derived from Solonenko & Mobley 2015);
Kd: Austin & Petzold 1984 (I to 1C), Jerlov 1976 (3C to 9C)."""

RED_ABSORPTION_SHIFT = 0.21
"""1/m by which water absorbs less at 620 nm, where a camera's red channel looks, than the table says at 650 nm."""

ASYMMETRY = 0.92  # of the Henyey-Greenstein phase function; gives a backscattered share of 0.018, as Petzold measured
FORWARD_ANGLE_RAD = np.deg2rad(10.0)
"""Light scattered by less than this still forms the image, only softer: beam attenuation would be too dark."""

AMBIENT_GAIN = 2.0
"""Veiling light of all orders of scattering over that of the first: judged by eye against coastal photographs."""


@dataclass(frozen=True)
class Water:
    """Coefficients in 1/m, each (3,) for red, green, blue.

    direct attenuates what a surface sends, backscatter is the rate at which veiling light saturates, diffuse (Kd)
    weakens daylight with depth; veil: radiance of an infinite path over the radiance of a white matte surface.
    """

    direct: Array
    backscatter: Array
    diffuse: Array
    veil: Array

    def transmission(self, range_m: ArrayLike) -> Array:
        """Share (..., 3) of a surface's light that arrives from range_m (...,)."""
        return np.exp(-np.asarray(range_m, dtype=float)[..., None] * self.direct)

    def saturation(self, range_m: ArrayLike) -> Array:
        """Share (..., 3) of the infinite path's veiling light that a path of range_m (...,) gives."""
        return 1.0 - np.exp(-np.asarray(range_m, dtype=float)[..., None] * self.backscatter)

    def daylight(self, depth_m: ArrayLike) -> Array:
        """Downwelling irradiance (..., 3) at depth_m (...,) over that just below the surface (Beer, with Kd)."""
        return np.exp(-np.maximum(np.asarray(depth_m, dtype=float), 0.0)[..., None] * self.diffuse)


def build_water(recipe: WaterRecipe) -> Water:
    """Coefficients of a Jerlov type for a camera.

    direct: a + (1 - F) b, with F the share scattered by less than FORWARD_ANGLE_RAD (0.59), since that light stays in
    the image. backscatter: Kd, as veiling light is diffuse light. veil: single scattering of daylight by the mean
    angle between the horizontal and the refracted sky, pi p b / direct, times AMBIENT_GAIN.
    """
    a, b, diffuse = (np.array(row) for row in JERLOV[recipe.jerlov])
    a[0] -= RED_ABSORPTION_SHIFT
    # Kd follows absorption, a little faster (mean cosine of daylight under water, about 0.85).
    diffuse[0] = max(diffuse[0] - RED_ABSORPTION_SHIFT * 0.5, a[0])
    direct = a + (1.0 - forward_share(FORWARD_ANGLE_RAD)) * b
    veil = AMBIENT_GAIN * np.pi * phase(np.deg2rad(65.0)) * b / direct
    return Water(direct, diffuse, diffuse, veil)


def phase(angle: float, g: float = ASYMMETRY) -> float:
    """Henyey-Greenstein phase function (Henyey & Greenstein 1941) at a scattering angle in rad, 1/sr."""
    return float((1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * np.cos(angle)) ** 1.5))


def forward_share(angle: float, g: float = ASYMMETRY) -> float:
    """Share of scattered light turned by less than `angle` (rad): the integral of `phase` over that cone."""
    return float((1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g - 2 * g * np.cos(angle))))
