"""What echo-recording sonars share: from rays to power per range bin, and from power to amplitudes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.sensors import BinnedSonarRecipe
from oysterbench.sensors.acoustics import absorption, echo_strength, mount_pose, range_resolution, sound_speed

if TYPE_CHECKING:
    from oysterbench.render.rays import Echoes, RayCaster
    from oysterbench.sensors.kind import Instants, SensedWorld

T = TypeVar("T")

PLAIN_STEP = 5e-6
GAINED_STEP = 1e-4
"""Amplitude of one count, without and with time-varying gain, relative to a perfect scatterer at 1 m."""

FULL_SCALE = 2**16 - 1
BOTTOM_FOOTPRINT_M = 2.0
THING_FOOTPRINT_M = 0.1
"""Longest extent in range that one ray stands for, on the bottom and on what lies on it."""

PROBE_ROWS = 48  # rows of the probing rays that tell where elevations have to be dense
EVEN_SHARE = 0.35  # share of the rows that are spread evenly in elevation; the rest are spread evenly in range
SHORTEST_BINS = 1e-3  # least extent over which a return is spread
SIDELOBES = 3  # side lobes of the pulse's sinc^2 that are kept on each side


@dataclass(frozen=True)
class Medium:
    """Water at a sonar: its speed of sound, m/s, and its absorption (loss), dB/m."""

    speed: float
    loss: float

    @classmethod
    def at(cls, site: SiteRecipe, depth_m: float, frequency_khz: float) -> Medium:
        """Water at a depth in m."""
        return cls(sound_speed(site, depth_m), absorption(site, depth_m, frequency_khz))


@dataclass(frozen=True)
class RangeAxis:
    """Range bins of `step` m each from `start` m on, as the sonar believes them to be.

    stretch: ratio of believed to true range, which is that of the assumed to the true speed of sound.
    """

    start: float
    step: float
    bins: int
    stretch: float

    def bin_of(self, ranges: Array) -> Array:
        """Positions of true ranges (m) on the axis, in bins from the near edge of the first."""
        return (ranges * self.stretch - self.start) / self.step

    @property
    def reach(self) -> float:
        """True range of the far edge, m."""
        return (self.start + self.step * self.bins) / self.stretch


@dataclass(frozen=True)
class Rays:
    """Rays of a sonar, each at random in its cell of azimuth (to the left) and elevation (up), in the sonar's frame.

    azimuths (N,), elevations (N,): of the rays; middles (2, N): azimuths and elevations of the cells' centres; widths
    (N,), heights (N,): of the cells; all rad. columns (N,): columns in which echoes are summed. weights (N,): two-way
    response of the beam.
    """

    azimuths: Array
    elevations: Array
    middles: Array
    widths: Array
    heights: Array
    columns: NDArray[np.int64]
    weights: Array


@dataclass(frozen=True)
class Returns:
    """Returns along N rays: the surfaces that they meet, and their directions (N, 3) in `map`.

    nearest, farthest (N,): range interval, m, of the part of the surface that the ray's cell sees. powers (N,): 1 is
    that of a perfect scatterer that fills the beam at 1 m.
    """

    echoes: Echoes
    directions: Array
    nearest: Array
    farthest: Array
    powers: Array


def range_axis(recipe: BinnedSonarRecipe, true_speed: float) -> RangeAxis:
    """Range bins of a sonar in water with a speed of sound in m/s."""
    step = (recipe.max_range_m - recipe.min_range_m) / recipe.bins
    assumed = recipe.assumed_sound_speed_m_s or true_speed
    return RangeAxis(recipe.min_range_m, step, recipe.bins, assumed / true_speed)


def bin_middles(recipe: BinnedSonarRecipe) -> Array:
    """Ranges (bins,) m of the centres of a sonar's bins, as it believes them to be."""
    step = (recipe.max_range_m - recipe.min_range_m) / recipe.bins
    return np.asarray(recipe.min_range_m + step * (np.arange(recipe.bins) + 0.5))


def row_edges(
    caster: RayCaster, T_map_sonar: Array, axis: RangeAxis, azimuths: Array, highest: float, rows: int
) -> Array:
    """Elevations (rows + 1,) rad of the edges of the rows of rays, from -highest to highest.

    At grazing incidence a small step in elevation is a large one in range: a few probing rays at some azimuths (rad)
    tell where, and rows are closer there. Each ray stands for the height of its row, so the expected power is
    unchanged.
    """
    elevations = np.linspace(-highest, highest, PROBE_ROWS + 1)
    a, e = (values.ravel() for values in np.meshgrid(azimuths, elevations, indexing="ij"))
    probes = turn(T_map_sonar[:3, :3], np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e))
    ranges = caster.cast(T_map_sonar[:3, 3], probes, axis.reach).ranges.astype(float)
    seen = np.clip(ranges.reshape(len(azimuths), len(elevations)), axis.start / axis.stretch, axis.reach)
    change = np.abs(np.diff(seen, axis=1)).mean(axis=0)
    total = change.sum()
    spent = np.full(PROBE_ROWS, 1.0 / PROBE_ROWS)
    if total > 0:
        spent = EVEN_SHARE * spent + (1 - EVEN_SHARE) * change / total
    reached = np.concatenate([[0.0], np.cumsum(spent)])
    return np.interp(np.linspace(0.0, reached[-1], rows + 1), reached, elevations)


def send(
    caster: RayCaster, T_map_sonar: Array, rays: Rays, mu: Array, absorption_db_m: float, fill: float, reach: float
) -> Returns:
    """Cast rays from a pose and compute the power that they return.

    mu (12,): of the classes. fill: power of a perfect scatterer that fills the beam at 1 m. Each ray stands for its
    solid angle, so the power from a patch does not depend on how many rays meet it.
    """
    rotation = T_map_sonar[:3, :3]
    sin_a, cos_a = np.sin(rays.azimuths), np.cos(rays.azimuths)
    sin_e, cos_e = np.sin(rays.elevations), np.cos(rays.elevations)
    directions = turn(rotation, cos_e * cos_a, cos_e * sin_a, sin_e)
    echoes = caster.cast(T_map_sonar[:3, 3], directions, reach)
    ranges = echoes.ranges.astype(float)
    # Normals in the sonar's frame, then their components along the ray and perpendicular to it, to the left and up.
    x, y, z = turn(rotation.T, *echoes.normals.T.astype(float)).T
    level = cos_a * x + sin_a * y
    along, left, up = cos_e * level + sin_e * z, cos_a * y - sin_a * x, cos_e * z - sin_e * level
    cosines = np.abs(along)
    solid_angles = rays.widths * rays.heights * cos_e
    powers = echo_strength(ranges, cosines, mu[echoes.classes], absorption_db_m) * rays.weights * solid_angles / fill
    r = np.where(np.isfinite(ranges), ranges, 0.0)
    facing = np.where(cosines > 0, along, 1.0)
    longest = np.where(echoes.instances > 0, THING_FOOTPRINT_M, BOTTOM_FOOTPRINT_M)
    below, above = _stretch_of(r, up / facing, rays.middles[1] - rays.elevations, rays.heights, longest)
    right, left = _stretch_of(r, left / facing * cos_e, rays.middles[0] - rays.azimuths, rays.widths, longest)
    middle = r + 0.5 * (below + above + right + left)
    half = 0.5 * np.hypot(above - below, left - right)
    return Returns(echoes, directions, middle - half, middle + half, powers)


def _stretch_of(ranges: Array, slope: Array, offset: Array, size: Array, longest: Array) -> tuple[Array, Array]:
    """Extra range of the tangent plane, compared with the ray, at the two ends of its cell, (N,) m each.

    Along a ray turned from d by a small angle a towards e, the plane with normal n is at r / (1 + a n.e / n.d); slope
    is n.e / n.d, and the ends are at offset -+ size / 2, rad.
    """
    ends = []
    for end in (offset - 0.5 * size, offset + 0.5 * size):
        turned = np.maximum(1 + end * slope, ranges / (ranges + longest))
        ends.append(np.maximum(ranges / turned - ranges, -longest))
    return ends[0], ends[1]


def add_up(
    axis: RangeAxis, columns: NDArray[np.int64], count: int, nearest: Array, farthest: Array, powers: Array
) -> Array:
    """Power (count, bins) of returns, each spread evenly between its nearest and farthest range, m.

    The integral of a box over bins is the difference of two ramps, whose steps are accumulated per bin and then summed.
    """
    heard = powers > 0
    columns = columns[heard]
    near, far = axis.bin_of(nearest[heard]), axis.bin_of(farthest[heard])
    far = np.maximum(far, near + SHORTEST_BINS)
    density = powers[heard] / (far - near)
    length = axis.bins + 2  # one bin before the first for what is too near, and one for the overflow of the last
    cells, changes = [], []
    for edge, change in ((near, density), (far, -density)):
        place = np.clip(edge, -1.0, axis.bins) + 1.0
        whole = np.minimum(place.astype(np.int64), axis.bins)
        later = change * (place - whole)
        cell = columns * length + whole
        cells += [cell, cell + 1]
        changes += [change - later, later]
    steps = np.bincount(np.concatenate(cells), np.concatenate(changes), count * length).astype(float)
    return np.cumsum(steps.reshape(count, length), axis=1)[:, 1 : axis.bins + 1]


@lru_cache(maxsize=64)
def pulse_kernel(width: float) -> Array:
    """Shares (2 k + 1,) of an echo's power that fall into its own bin and the k bins on each side; their sum is 1.

    A compressed pulse with a flat spectrum has the power envelope sinc^2(r / width), with width c / 2B, here in bins.
    It is averaged over the bin that the echo comes from and the bin that it falls into.
    """
    fine = 64
    side = max(1, int(np.ceil((SIDELOBES + 1) * width)))
    offsets = np.arange(-(side + 1) * fine, (side + 1) * fine + 1) / fine
    pulse = np.zeros_like(offsets)
    samples = np.linspace(-0.5, 0.5, 65)[:-1] + 1 / 128  # within one step of the fine grid: narrow pulses need them
    for sample in samples / fine:
        place = (offsets + sample) / width
        pulse += np.where(np.abs(place) <= SIDELOBES + 1, np.sinc(place) ** 2, 0.0)
    taps = np.array([np.sum(pulse * np.maximum(1 - np.abs(offsets - k), 0.0)) for k in range(-side, side + 1)])
    return np.asarray(np.round(taps / taps.sum(), 12))


def resolve(power: Array, axis: RangeAxis, true_speed: float, bandwidth_khz: float) -> Array:
    """Power (beams, bins) smeared in range by the pulse's resolution; what leaves the axis is lost."""
    width = range_resolution(true_speed, bandwidth_khz) * axis.stretch / axis.step
    taps = pulse_kernel(max(round(width, 3), 0.001))
    side = len(taps) // 2
    smeared: Array = taps[side] * power
    part = np.empty_like(power)
    for k in range(1, side + 1):
        np.multiply(power, taps[side + k], out=part)
        smeared[:, k:] += part[:, :-k]
        smeared[:, :-k] += part[:, k:]
    np.maximum(smeared, 0.0, out=smeared)
    return smeared


def record(
    power: Array,
    recipe: BinnedSonarRecipe,
    absorption_db_m: float,
    generator: np.random.Generator,
) -> NDArray[np.uint16]:
    """Amplitudes (..., bins) uint16 that a sonar records for expected powers (..., bins).

    Speckle multiplies the power by a Gamma variable of mean 1 and shape `looks`; one look is fully developed speckle,
    with Rayleigh amplitude. The noise floor is complex Gaussian and adds to the complex echo, whose amplitude is
    recorded in counts of `amplitude_step`: linear, not in dB, and clipped at full scale.
    """
    noise = 10 ** (recipe.noise_db / 10)
    if recipe.looks == 1:  # a complex Gaussian echo, to which the noise adds another
        squared = (power + noise) * generator.standard_exponential(power.shape)
    else:
        speckled = power * generator.standard_gamma(recipe.looks, power.shape) / recipe.looks
        quadratures = np.sqrt(noise / 2) * generator.standard_normal((2, *power.shape))
        squared = (np.sqrt(speckled) + quadratures[0]) ** 2 + quadratures[1] ** 2
    counts = np.sqrt(squared) * (time_varying_gain(recipe, absorption_db_m) / amplitude_step(recipe))
    return np.minimum(np.rint(counts), FULL_SCALE).astype(np.uint16)


def time_varying_gain(recipe: BinnedSonarRecipe, absorption_db_m: float) -> Array:
    """Gain (bins,) of amplitudes: r^2 10^(2 a r / 20), which compensates spreading and absorption; 1 without `tvg`."""
    if not recipe.tvg:
        return np.ones(recipe.bins)
    ranges = bin_middles(recipe)
    return np.asarray(ranges**2 * 10 ** (0.1 * absorption_db_m * ranges))


def amplitude_step(recipe: BinnedSonarRecipe) -> float:
    """Amplitude of one count of a sonar's record, relative to a perfect scatterer that fills a beam at 1 m."""
    return GAINED_STEP if recipe.tvg else PLAIN_STEP


def calibrate(recipe: BinnedSonarRecipe) -> dict[str, Any]:
    """Common part of the calibrations of all sonars: ranges of the bins, amplitude of one count, and pose."""
    return {
        "ranges_m": bin_middles(recipe).tolist(),
        "amplitude_step": amplitude_step(recipe),
        "T_base_sensor": mount_pose(recipe).tolist(),
    }


def dot(a: Array, b: Array) -> Array:
    """Scalar products (N,) of vectors (N, 3) or (1, 3), summed in the same order on every processor."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def turn(rotation: Array, x: Array, y: Array, z: Array) -> Array:
    """Vectors (N, 3), given by components and rotated by rotation (3, 3), summed in the same order on every
    processor."""
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in rotation], axis=-1)


def pings(world: SensedWorld, at: Instants, ping: Callable[[Array, Streams, int, int], T]) -> Iterator[T]:
    """Yield a sonar's measurements at the wanted instants, each in the world as it is at that time.

    ping: makes a measurement from T_map_base (4, 4), the random streams, its index and its stamp (ns).
    """
    for index, T_map_base in zip(at.wanted.tolist(), world.bodies(at.times_s[at.wanted]), strict=True):
        with world.caster.at(float(at.times_s[index])):
            measured = ping(T_map_base, world.streams, index, int(at.stamps_ns[index]))
        yield measured
