"""Altimeter: a single-beam echo sounder that reports the range of the first strong echo in its cone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import RangeMeasurement
from oysterbench.core.ros import RANGE, Message, decode, range_bytes, stamp_of
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import AcousticRecipe
from oysterbench.sensors import acoustics
from oysterbench.sensors.kind import Instants, SensedWorld, SensorKind, Strip, link, quantise

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.scene.path import Path

RAYS = 401  # rays over the main lobe
PULSE_M = 0.05  # range over which the echo's envelope integrates: about 70 us
STRONG = 0.5  # share of the strongest echo that the detector takes for the bottom
WEAKEST_BOTTOM = "mud"  # weakest bottom that it detects at max_range_m
PINGS_AT_ONCE = 128  # bounds the memory
RANGE_STEP = 1e-6  # m, to which readings are rounded


@dataclass(frozen=True, kw_only=True)
class AltimeterRecipe(AcousticRecipe):
    """A single-beam echo sounder: the range of the first strong echo in its cone."""

    block: ClassVar[str] = "altimeter"

    pitch_deg: float = number(-90, 90, 90.0)
    frequency_khz: float = number(10, 3000, 115.0)  # of the carrier
    beam_deg: float = number(1, 60, 28.0)  # full width of the cone at half power
    min_range_m: float = number(0.05, 20, 0.3)  # closer echoes are missed
    max_range_m: float = number(0.5, 300, 100.0)  # farther echoes are missed
    noise_m: float = number(0, 1, 0.005)  # 1 sigma of the range; its square is the variance that messages state
    noise_share: float = number(0, 0.2, 0.002)  # 1 sigma of the range, as a share of it, in addition
    step_m: float = number(0, 1, 0.001)  # resolution of the reading


@dataclass(frozen=True)
class AltimeterCalibration:
    """An altimeter: width of its cone, rad; minimum and maximum range, m; pose, x along its axis."""

    beam_rad: float
    min_range_m: float
    max_range_m: float
    T_base_sensor: Array


def measure(
    path: Path,
    caster: RayCaster,
    recipe: AltimeterRecipe,
    site: SiteRecipe,
    times_s: Array,
    streams: Streams,
    bottom: str = "sand",
) -> Array:
    """Ranges (N,) m at times (N,) s; +inf where there is no echo between min_range_m and max_range_m.

    The range of the first echo with half the strength of the strongest, after compensation of spreading and absorption;
    then the error of the assumed speed of sound, noise, and the step of the digital reading. Nothing is detected where
    the total echo is weaker than that of level mud at max_range_m. bottom: one of recipe.BOTTOMS.
    """
    T_base_sounder = acoustics.mount_pose(recipe)
    cone, weights = beam_rays(np.radians(recipe.beam_deg))
    mu = acoustics.backscatter(bottom)
    ranges = np.empty(len(times_s))
    for first in range(0, len(times_s), PINGS_AT_ONCE):
        chunk = slice(first, first + PINGS_AT_ONCE)
        motion = path.at(times_s[chunk])
        origins = motion.position + np.einsum("nij,j->ni", motion.rotation, T_base_sounder[:3, 3])
        directions = np.einsum("nij,jk,rk->nri", motion.rotation, T_base_sounder[:3, :3], cone)
        speeds = np.array([acoustics.sound_speed(site, -z) for z in origins[:, 2]])
        stretch = (recipe.assumed_sound_speed_m_s or speeds) / speeds
        starts = np.repeat(origins, RAYS, axis=0)
        reach = 1.1 * recipe.max_range_m / float(np.min(stretch))
        echoes = caster.cast(starts, directions.reshape(-1, 3), reach)
        cosines = np.abs(np.einsum("ni,ni->n", echoes.normals.astype(float), directions.reshape(-1, 3)))
        strengths = (mu[echoes.classes] * cosines).reshape(-1, RAYS) * weights
        seen = echoes.ranges.astype(float).reshape(-1, RAYS)
        first_echoes = np.array([first_strong(r, s) for r, s in zip(seen, strengths, strict=True)])
        loss = acoustics.absorption(site, -float(origins[:, 2].mean()), recipe.frequency_khz)
        arriving = acoustics.echo_strength(seen, np.ones_like(seen), strengths, loss).sum(axis=1)
        level = np.array(recipe.max_range_m) / cone[:, 0]
        weakest = acoustics.echo_strength(level, cone[:, 0], weights * acoustics.backscatter(WEAKEST_BOTTOM)[1], loss)
        ranges[chunk] = np.where(arriving >= weakest.sum(), first_echoes * stretch, np.inf)
    noise = streams.generator("altimeter", recipe.name, "noise").standard_normal(len(times_s))
    answered = (ranges >= recipe.min_range_m) & (ranges <= recipe.max_range_m)
    certain = np.where(answered, ranges, 0.0)
    read = certain + noise * np.hypot(recipe.noise_m, recipe.noise_share * certain)
    if recipe.step_m:
        read = np.rint(read / recipe.step_m) * recipe.step_m
    return np.where(answered, read, np.inf)


def first_strong(ranges: Array, strengths: Array) -> float:
    """Range of the first echo, of ranges (R,) m and strengths (R,), from which on one pulse length holds a share STRONG
    of what the strongest pulse length holds; inf without echoes."""
    heard = np.isfinite(ranges) & (strengths > 0)
    if not heard.any():
        return float("inf")
    order = np.argsort(ranges[heard], kind="stable")
    nearest, strength = ranges[heard][order], strengths[heard][order]
    total = np.concatenate([[0.0], np.cumsum(strength)])
    within = total[np.searchsorted(nearest, nearest + PULSE_M, side="right")] - total[:-1]
    return float(nearest[np.argmax(within >= STRONG * within.max())])


def beam_rays(width: float) -> tuple[Array, Array]:
    """Unit vectors (RAYS, 3) around x, evenly spread over the cap up to the first null of a round beam with a
    half-power width in rad, the first on the axis; and the beam's two-way response (RAYS,) along them."""
    limit = acoustics.first_null(width)
    k = np.arange(RAYS)
    cosines = 1 - (1 - np.cos(limit)) * k / RAYS
    around = np.pi * (3 - np.sqrt(5)) * k  # the golden angle (Vogel 1979)
    sines = np.sqrt(1 - cosines**2)
    rays = np.column_stack([cosines, sines * np.cos(around), sines * np.sin(around)])
    return rays, acoustics.beam_pattern(np.arccos(cosines), width)


class Altimeter(SensorKind[AltimeterRecipe, AltimeterCalibration, RangeMeasurement]):
    """Sensor kind: altimeter."""

    recipe = AltimeterRecipe
    calibration = AltimeterCalibration
    title = "altimeter"
    reader = "ranges"
    rank = 50
    leaves: ClassVar = {"range": RANGE}
    tables: ClassVar = {"range": lambda message: {"range": message.range}}

    def calibrate(self, recipe: AltimeterRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {
            "beam_rad": float(np.radians(recipe.beam_deg)),
            "min_range_m": recipe.min_range_m,
            "max_range_m": recipe.max_range_m,
            "T_base_sensor": acoustics.mount_pose(recipe).tolist(),
        }

    def measure(self, world: SensedWorld, recipe: AltimeterRecipe, at: Instants) -> Iterator[RangeMeasurement]:
        site, bottom = world.recipe.site, world.recipe.reef.bottom
        ranges = measure(world.path, world.caster, recipe, site, at.times_s, world.streams, bottom)
        ranges = quantise(ranges, RANGE_STEP)
        return (RangeMeasurement(int(at.stamps_ns[k]), recipe.name, float(ranges[k])) for k in at.wanted)

    def encode(self, recipe: AltimeterRecipe, measurement: RangeMeasurement) -> list[Message]:
        """Message with the range along the altimeter's axis, m, +inf without an echo (REP 117). Its variance is that of
        noise_m alone: what grows with the range, noise_share, is not in it."""
        stamp, limits = measurement.stamp_ns, (recipe.min_range_m, recipe.max_range_m)
        beam, variance = float(np.radians(recipe.beam_deg)), recipe.noise_m**2
        data = range_bytes(stamp, link(measurement.sensor), measurement.range, limits, beam, variance)
        return [Message(f"/{measurement.sensor}/range", stamp, data)]

    def decode(self, name: str, calibration: AltimeterCalibration, *data: bytes) -> RangeMeasurement:
        message = decode(data[0], RANGE)
        return RangeMeasurement(stamp_of(message.header), name, float(message.range))

    def strips(self, name: str) -> list[Strip]:
        return [Strip(f"/{name}/range", f"{name} range, m", ("range",))]


KIND = Altimeter()
