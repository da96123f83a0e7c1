"""Spectra at WAVELENGTHS: absorption and scattering of water and its constituents, daylight, a camera's response.

The last axis of arrays runs over WAVELENGTHS; coefficients are in 1/m.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import WaterRecipe

WAVELENGTHS: Array = np.arange(400.0, 701.0, 10.0)
"""Wavelengths (31,), nm."""

# fmt: off
WATER_ABSORPTION: Array = np.array(
    [
        0.00663, 0.00473, 0.00454, 0.00495, 0.00635, 0.00922, 0.00979, 0.0106, 0.0127, 0.0150,
        0.0204, 0.0325, 0.0409, 0.0434, 0.0474, 0.0565, 0.0619, 0.0695, 0.0896, 0.1351,
        0.2224, 0.2644, 0.2755, 0.2916, 0.3108, 0.340, 0.410, 0.439, 0.465, 0.516, 0.624,
    ]
)
"""Absorption of pure water, 1/m (Pope & Fry, Applied Optics 36, 1997, table 3)."""

DAYLIGHT: Array = np.array(
    [
        82.75, 91.49, 93.43, 86.68, 104.86, 117.01, 117.81, 114.86, 115.92, 108.81,
        109.35, 107.80, 104.79, 107.69, 104.41, 104.05, 100.00, 96.33, 95.79, 88.69,
        90.01, 89.60, 87.70, 83.29, 83.70, 80.03, 80.21, 82.28, 78.28, 69.72, 71.61,
    ]
)
"""Relative spectral irradiance just below the surface: CIE standard illuminant D65 (ISO 11664-2)."""

# fmt: on

JERLOV: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]] = {
    # a, b, Kd in 1/m, each at (650, 550, 450) nm
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
"""Absorption and scattering after Solonenko & Mobley (Applied Optics 54, 2015), as used in public simulators;
Kd: Austin & Petzold 1984 (I to 1C), Jerlov 1976 (3C to 9C)."""

TABLE_WAVELENGTHS = np.array([650.0, 550.0, 450.0])
RED_TABLE_OFFSET = 0.120
"""Excess, 1/m, of the table's absorption at 650 nm in its clearest type over pure water. The table's red is that of
pure water near 678 nm and exceeds Kd, which is impossible; its steps from type to type are kept, above pure water at
650 nm."""

CDOM_SLOPE = 0.0176  # 1/nm, dissolved matter (Babin et al., J. Geophys. Res. 108, 2003, mean of European coasts)
NAP_SLOPE = 0.0110  # 1/nm, non-algal particles (Babin et al. 2003: 0.0123 +- 0.0013; Chesapeake: Tzortziou 2006, 0.011)
REFERENCE_NM = 440.0
SCATTERING_NM = 550.0
PURE_SCATTERING = 0.0019  # 1/m at 550 nm: scattering by sea water itself, close to that of type I
SECCHI_CONSTANT = 1.45


@dataclass(frozen=True)
class Constituents:
    """Constituents of water. cdom, nap, algae: absorption at 440 nm, 1/m; scattering: by particles at 550 nm, 1/m.

    Scattering is proportional to the wavelength to the power -slope.
    """

    cdom: float
    nap: float
    algae: float
    scattering: float
    slope: float = 1.0

    def absorption(self) -> Array:
        """Absorption a (31,), 1/m, of pure water, dissolved matter, algae and other particles."""
        return WATER_ABSORPTION + np.array([self.cdom, self.nap, self.algae]) @ absorbers(WAVELENGTHS)

    def scatter(self) -> Array:
        """Scattering b (31,), 1/m: a power law of the wavelength."""
        return self.scattering * (SCATTERING_NM / WAVELENGTHS) ** self.slope


CHESAPEAKE: dict[str, tuple[Constituents, float]] = {
    "chesapeake-clear": (Constituents(cdom=0.40, nap=0.10, algae=0.40, scattering=3.6, slope=1.0), 2.0),
    "chesapeake-mid": (Constituents(cdom=0.65, nap=0.25, algae=0.65, scattering=6.5, slope=0.9), 1.2),
    "chesapeake-turbid": (Constituents(cdom=0.90, nap=0.60, algae=0.90, scattering=12.0, slope=0.8), 0.65),
}
"""Mixtures of the magnitude measured in the bay (Tzortziou et al., Estuarine, Coastal and Shelf Science 68, 2006), each
to be scaled as a whole to a Secchi depth in m; the more turbid, the higher the share of mineral matter."""


def water_constituents(recipe: WaterRecipe) -> Constituents:
    """Constituents of a recipe's water: its type, particles times its turbidity, plus additions, scaled to a Secchi
    depth if one is given."""
    kind = recipe.type or recipe.jerlov or "pure"

    if kind in CHESAPEAKE:
        base, usual = CHESAPEAKE[kind]
        base = scale_to_secchi(base, usual)
    elif kind == "pure":
        base = Constituents(cdom=0.0, nap=0.0, algae=0.0, scattering=PURE_SCATTERING)
    else:
        base = jerlov_constituents(kind)
    water = Constituents(
        cdom=base.cdom + recipe.cdom_440,
        nap=base.nap * recipe.turbidity + recipe.nap_440,
        algae=base.algae * recipe.turbidity + recipe.algae_440,
        scattering=base.scattering * recipe.turbidity + recipe.scattering_550,
        slope=base.slope,
    )
    return water if recipe.secchi_m is None else scale_to_secchi(water, recipe.secchi_m)


def scale_to_secchi(water: Constituents, secchi_m: float) -> Constituents:
    """Scale a mixture so that a Secchi disc vanishes at secchi_m."""
    from scipy.optimize import brentq  # imported late: takes a third of a second, even if nothing is rendered

    def scaled(factor: float) -> Constituents:
        parts = {name: getattr(water, name) * factor for name in ("cdom", "nap", "algae", "scattering")}
        return dataclasses.replace(water, **parts)

    return scaled(float(brentq(lambda f: secchi_depth(scaled(f)) - secchi_m, 1e-6, 1e6, rtol=1e-12)))


def secchi_depth(water: Constituents) -> float:
    """Depth at which a white disc vanishes, m: 1.45 / Kd, with Kd averaged over the eye's sensitivity to daylight.

    Poole & Atkins 1929 in the form used for Chesapeake Bay; Kd after Kirk (Limnol. Oceanogr. 29, 1984).
    """
    kd = diffuse_attenuation(water.absorption(), water.scatter())
    return SECCHI_CONSTANT / float(np.average(kd, weights=luminosity() * DAYLIGHT))


def diffuse_attenuation(a: Array, b: Array, sun_cosine: float = 0.85) -> Array:
    """Diffuse attenuation Kd, 1/m, over the sunlit layer: sqrt(a^2 + G a b) / mu0, G = 0.425 mu0 - 0.19 (Kirk 1984,
    eqs. 9 and 14)."""
    return np.sqrt(a * a + (0.425 * sun_cosine - 0.19) * a * b) / sun_cosine


def molecular_scattering() -> Array:
    """Scattering of pure sea water (31,), 1/m, nearly isotropic: 0.00288 at 500 nm (Morel 1974)."""
    return 0.00288 * (500.0 / WAVELENGTHS) ** 4.32


def absorbers(wavelengths: Array) -> Array:
    """Absorption (3, N) of dissolved matter, non-algal particles and algae at (N,) nm, over that at 440 nm.

    Algae: the two bands of chlorophyll a on an accessory shoulder, in smooth form after the mean spectrum of Bricaud et
    al. (J. Geophys. Res. 100, 1995).
    """
    algae = band(wavelengths, 438, 26) + 0.62 * band(wavelengths, 487, 34) + 0.45 * band(wavelengths, 676, 12)
    algae = algae + 0.14 * band(wavelengths, 600, 60)
    at_reference = 0.9970 + 0.62 * np.exp(-0.5 * (47 / 34) ** 2) + 0.14 * np.exp(-0.5 * (160 / 60) ** 2)
    distance = wavelengths - REFERENCE_NM
    return np.stack([np.exp(-CDOM_SLOPE * distance), np.exp(-NAP_SLOPE * distance), algae / at_reference])


def band(wavelengths: Array, centre: float, width: float) -> Array:
    """Gaussian of unit height; width is its standard deviation, nm."""
    return np.exp(-0.5 * ((wavelengths - centre) / width) ** 2)


def jerlov_constituents(kind: str) -> Constituents:
    """Constituents of a Jerlov type, fitted to its row of the table.

    Absorption above that of pure water: non-negative least squares of relative residuals over the three absorbers;
    scattering: a straight line in logarithms.
    """
    from scipy.optimize import nnls  # imported late, like brentq

    a, b, _ = (np.array(row) for row in JERLOV[kind])
    a[0] -= RED_TABLE_OFFSET
    excess = np.maximum(a - np.interp(TABLE_WAVELENGTHS, WAVELENGTHS, WATER_ABSORPTION), 0.0)
    shares, _ = nnls(absorbers(TABLE_WAVELENGTHS).T / a[:, None], excess / a)
    slope, height = np.polyfit(np.log(SCATTERING_NM / TABLE_WAVELENGTHS), np.log(b), 1)
    cdom, nap, algae = (float(share) for share in shares)
    return Constituents(cdom, nap, algae, scattering=float(np.exp(height)), slope=float(slope))


def camera_response() -> Array:
    """Response (3, 31) of a generic colour camera in red, green and blue, each summing to 1.

    Bands typical of the 28 cameras of Jiang et al. (WACV 2013); red keeps the small second lobe through which it sees
    green light where all red has been absorbed.
    """
    red = band(WAVELENGTHS, 605, 28) + 0.10 * band(WAVELENGTHS, 535, 30)
    green = band(WAVELENGTHS, 538, 38) + 0.06 * band(WAVELENGTHS, 610, 25)
    blue = band(WAVELENGTHS, 462, 28) + 0.08 * band(WAVELENGTHS, 530, 25)
    curves = np.stack([red, green, blue])
    return np.asarray(curves / curves.sum(axis=1, keepdims=True))


def camera_weights() -> Array:
    """Share (3, 31) of each wavelength in a channel's signal from a white object just below the water's surface."""
    weights = camera_response() * DAYLIGHT
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def luminosity() -> Array:
    """Photopic luminous efficiency (31,) as a Gaussian (after CIE 1924; peak 555 nm)."""
    return band(WAVELENGTHS, 557, 42)
