"""The daylight field in a deep, horizontally uniform water body, by discrete ordinates.

Radiance, averaged over azimuth, of all orders of scattering (Chandrasekhar, Radiative Transfer, 1950, ch. 6; Stamnes
et al., Applied Optics 27, 1988), for a Henyey-Greenstein phase function truncated by the delta-M method (Wiscombe, J.
Atmos. Sci. 34, 1977). One wavelength at a time; the surface is level and index-matched, the sky fills Snell's cone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from oysterbench.core.geometry import Array

WATER_INDEX = 1.34
STREAMS = 24  # per hemisphere
WATER_SECOND_MOMENT = 2 * 0.835 / 15 / (1 + 0.835 / 3)  # chi_2 of 1 + 0.835 cos^2


@dataclass(frozen=True)
class Daylight:
    """Illumination of the water: unit downwelling irradiance just below the surface.

    sun_cosine: of the refracted sun's zenith angle; sky: share of the irradiance that comes from the sky.
    """

    sun_cosine: float = 0.88
    sky: float = 0.35


@dataclass(frozen=True)
class Field:
    """Radiance L(z, mu) = sum_k modes[k] exp(-rates[k] z) at depth z, m, along view rays of cosine mu with the zenith.

    A view ray that looks up (mu > 0) meets light travelling down. cosines (2N,), increasing; weights (2N,) of the
    quadrature; modes (N + 1, 2N); rates (N + 1,), 1/m; beam: irradiance of the unscattered sun at z = 0, which decays
    at rates[-1].
    """

    cosines: Array
    weights: Array
    modes: Array
    rates: Array
    beam: float

    def radiance(self, depth_m: Array, cosine: Array) -> Array:
        """Radiance (D, K), 1/sr, without the sun's own disc, for unit downwelling irradiance at the surface."""
        at_nodes = self._decay(depth_m) @ self.modes
        return np.stack([np.interp(cosine, self.cosines, row) for row in at_nodes])

    def irradiance(self, depth_m: Array) -> Array:
        """Downwelling plane irradiance (D,) over that at the surface."""
        decay = self._decay(depth_m)
        down = np.maximum(self.cosines, 0.0) * self.weights
        return 2 * np.pi * decay @ self.modes @ down + self.beam * decay[:, -1]

    def _decay(self, depth_m: Array) -> Array:
        return np.exp(-np.maximum(depth_m, 0.0)[:, None] * self.rates)


def solve_daylight(
    absorption: float, scattering: float, asymmetry: float, daylight: Daylight, molecular: float = 0.0
) -> Field:
    """Solve for the field in infinitely deep water with uniform absorption and scattering coefficients, 1/m.

    molecular: the part of the scattering, 1/m, due to the water itself, which is nearly isotropic.
    """
    cosines, weights, basis = _quadrature()
    moments, peak = _moments(asymmetry, molecular / scattering)
    b = (1.0 - peak) * scattering
    c = absorption + b
    degree = len(moments) - 1
    towards = (basis * moments) @ basis.T  # azimuth mean of 4 pi times the phase function
    gain = 0.5 * b * towards * weights
    values, vectors = np.linalg.eig((gain - c * np.eye(len(cosines))) / cosines[:, None])
    values, vectors = values.real, vectors.real
    order = np.argsort(values)[: len(cosines) // 2]  # the modes that decay with depth
    rates, modes = -values[order], vectors[:, order].T

    sun = 1.0 - daylight.sky
    incident = (
        b * sun / daylight.sun_cosine / (4 * np.pi) * (basis * moments) @ legvander([daylight.sun_cosine], degree)[0]
    )
    forced = np.linalg.solve(np.diag(c * (1.0 - cosines / daylight.sun_cosine)) - gain, incident)

    down = cosines > 0
    sky = _above(np.sqrt(1.0 - WATER_INDEX**-2), weights)
    sky *= daylight.sky / (2 * np.pi * np.sum(sky * cosines * weights))
    shares = np.linalg.solve(modes[:, down].T, sky[down] - forced[down])
    return Field(
        cosines,
        weights,
        np.vstack([shares[:, None] * modes, forced]),
        np.append(rates, c / daylight.sun_cosine),
        sun,
    )


@cache
def _quadrature() -> tuple[Array, Array, Array]:
    """Double Gauss quadrature: nodes increasing from -1 to 1, and weights (2N,), for each hemisphere separately; values
    (2N, 2N) of the Legendre polynomials of degree below 2N at the nodes."""
    nodes, weights = leggauss(STREAMS)
    half, share = 0.5 * (nodes + 1.0), 0.5 * weights
    cosines = np.concatenate([-half[::-1], half])
    found = cosines, np.concatenate([share[::-1], share]), legvander(cosines, 2 * STREAMS - 1)
    for shared in found:
        shared.setflags(write=False)
    return found


def _above(cosine: float, weights: Array) -> Array:
    """Share (2N,) of each node's interval of cosines that lies above a given positive cosine."""
    tops = np.cumsum(weights) - 1.0
    return np.clip((tops - cosine) / weights, 0.0, 1.0)


def _moments(asymmetry: float, molecular: float) -> tuple[Array, float]:
    """Moments (2l + 1) chi_l for l below 2N, and the share of scattering that delta-M treats as no scattering at all.

    molecular: share of scattering by water itself, with a phase function 1 + 0.835 cos^2 (Morel 1974).
    """
    orders = np.arange(2 * STREAMS)
    water = np.where(orders == 0, 1.0, np.where(orders == 2, WATER_SECOND_MOMENT, 0.0))
    moments = (1.0 - molecular) * asymmetry**orders + molecular * water
    peak = (1.0 - molecular) * asymmetry ** (2 * STREAMS)
    return (2 * orders + 1) * (moments - peak) / (1.0 - peak), peak
