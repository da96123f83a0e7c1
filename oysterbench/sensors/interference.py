"""Interference in sonars: volume backscatter of the water, and pulses of other sonars, which show as radial lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import count
from oysterbench.recipe.sensors import BinnedSonarRecipe
from oysterbench.sensors import acoustics
from oysterbench.sensors.echoes import bin_middles
from oysterbench.sensors.faults import Fault

if TYPE_CHECKING:
    from oysterbench.sensors.kind import SensedWorld

SPEED_M_S = 1500.0  # nominal speed of sound: for the length of another sonar's pulse
PINGER_M = (10.0, 40.0)  # least and greatest distance of the other sonar from the middle of the reef


def volume_power(recipe: BinnedSonarRecipe, absorption_db_m: float) -> Array:
    """Power (bins,) scattered back by the water, s_v dr r^-2 10^(-2 a r / 10), relative to a perfect scatterer that
    fills the beam at 1 m, with s_v the volume backscattering in 1/m per steradian (Urick 1983, sec. 8.3)."""
    ranges = bin_middles(recipe)
    if recipe.volume_db is None:
        return np.zeros_like(ranges)
    step = float(ranges[1] - ranges[0])
    strength = 10 ** (recipe.volume_db / 10) * step
    return np.asarray(strength * ranges**-2 * 10 ** (-0.2 * absorption_db_m * ranges))


@dataclass(frozen=True)
class Beams:
    """Beams of a sonar: its pose in `map` (4, 4), azimuths (B,) rad of the beams, and their two-way half-power width,
    rad. listening: whether they are formed on reception only, as in a multibeam sonar, which transmits into its whole
    fan; otherwise half of the two-way pattern belongs to transmission."""

    T_map_sonar: Array
    azimuths: Array
    width: float
    listening: bool = False


@dataclass(frozen=True)
class Pulse:
    """A pulse of another sonar: azimuth that it comes from (rad, left of the sonar's x), and apparent ranges, m."""

    azimuth: float
    near_m: float
    far_m: float


def pulse(recipe: BinnedSonarRecipe, T_map_sonar: Array, site: Streams, ping: Streams) -> Pulse | None:
    """Draw the pulse that strikes a ping, or None: a share `interference` of all pings is struck.

    site: the sequence's streams, from which the position of the other sonar is drawn; ping: the branch of this ping.
    The two are not synchronised, so the pulse starts at any time.
    """
    if not recipe.interference:
        return None
    rng = ping.generator("interference")
    if rng.random() >= recipe.interference:
        return None
    drawn = site.generator("site", "pinger")
    bearing = drawn.uniform(0, 2 * np.pi)
    if recipe.interference_bearing_deg is not None:
        bearing = np.radians(recipe.interference_bearing_deg)
    place = drawn.uniform(*PINGER_M) * np.array([np.cos(bearing), np.sin(bearing)])
    x, y, _ = T_map_sonar[:3, :3].T @ np.append(place - T_map_sonar[:2, 3], 0.0)
    length = 0.5 * SPEED_M_S * 1e-3 * recipe.interference_ms
    near = rng.uniform(-length, recipe.max_range_m)
    return Pulse(float(np.arctan2(y, x)), near, near + length)


def line_power(recipe: BinnedSonarRecipe, found: Pulse, beams: Beams) -> Array:
    """Power (beams, bins) of a pulse: received one way, and equal in all its bins, since its source is at one range."""
    ranges = bin_middles(recipe)
    lasting = (ranges >= found.near_m) & (ranges < found.far_m)
    off = np.angle(np.exp(1j * (beams.azimuths - found.azimuth)))
    pattern = acoustics.beam_pattern(off, beams.width)
    heard = np.where(np.abs(off) < np.pi / 2, pattern if beams.listening else np.sqrt(pattern), 0.0)
    return 10 ** (recipe.interference_db / 10) * heard[:, None] * lasting


def added_power(recipe: BinnedSonarRecipe, absorption_db_m: float, beams: Beams, site: Streams, ping: Streams) -> Array:
    """Power (B, bins) that the water and other sonars add to a ping; site, ping: as for `pulse`."""
    total = np.tile(volume_power(recipe, absorption_db_m), (len(beams.azimuths), 1))
    struck = pulse(recipe, beams.T_map_sonar, site, ping)
    return total if struck is None else total + line_power(recipe, struck, beams)


def struck_pings(
    world: SensedWorld,
    recipe: BinnedSonarRecipe,
    T_base_sonar: Array,
    branch: Callable[[int], Streams],
    width: float,
    axis: Callable[[int], float] = lambda index: 0.0,
) -> list[Fault]:
    """Faults of the pings that are struck by a pulse within half of `width` (rad) of axis(index), rad left of the
    sonar's x; value: the pulse's azimuth in deg. branch: the streams of each ping."""
    if not recipe.interference:
        return []
    times = np.arange(count(world.recipe.duration_s, recipe.rate_hz)) / recipe.rate_hz
    found = []
    for index, (time, body) in enumerate(zip(times.tolist(), world.bodies(times), strict=True)):
        struck = pulse(recipe, body @ T_base_sonar, world.streams, branch(index))
        if struck is None or struck.far_m < recipe.min_range_m:
            continue
        off = np.angle(np.exp(1j * (struck.azimuth - axis(index))))
        if abs(off) <= width / 2:
            found.append(Fault(time, time, "interference_azimuth_deg", float(np.degrees(struck.azimuth))))
    return found
