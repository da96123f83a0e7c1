"""Doppler velocity log: four beams in Janus form, each with a velocity, a range and a lock of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array, transform
from oysterbench.core.measurements import DvlMeasurement
from oysterbench.core.ros import (
    POINTS,
    RANGE,
    Message,
    decode,
    encode,
    header,
    make,
    point_rows,
    points_bytes,
    range_bytes,
    stamp_of,
    vector,
)
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, count
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors import acoustics
from oysterbench.sensors.dvl_echoes import listen
from oysterbench.sensors.dvl_faults import Strikes, arrivals, ping_times, strike
from oysterbench.sensors.faults import Fault, spans
from oysterbench.sensors.kind import XYZ, Instants, Row, SensedWorld, SensorKind, Strip, columns_of, link, quantise
from oysterbench.sensors.uncertainty import ErrorModel, Quality, independent, mount_errors

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.scene.path import Path

VELOCITY = "geometry_msgs/msg/TwistWithCovarianceStamped"
BEAM_AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
FEWEST_BEAMS = 3  # for three components of velocity
ALTITUDE_STEP_S = 0.1  # time step of the altitudes that the rate follows
PINGS_AT_ONCE = 512  # bounds the memory
READING_STEP = 1e-6  # m/s and m, to which readings are rounded: far below the noise
READINGS = ("velocity", "altitude", "beam_ranges", "beam_velocities")

BEAM = np.dtype(
    {
        "names": ["x", "y", "z", "range", "velocity", "valid"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<f4", "u1"],
        "offsets": [0, 4, 8, 12, 16, 20],
        "itemsize": 24,
    }
)
"""Layout of a beam as a point: its intersection with the bottom in the DVL's frame (m), range (m) and velocity (m/s)
along it, valid."""


@dataclass(frozen=True, kw_only=True)
class DvlRecipe(SensorRecipe):
    """A Doppler velocity log: four beams in Janus form, looking down."""

    block: ClassVar[str] = "dvl"

    rate_hz: float = number(0.1, 50, 8.0)
    yaw_deg: float = number(-180, 180, 0.0)  # of the mount; beams lie at 45, 135, 225 and 315 deg from its x axis
    janus_deg: float = number(5, 45, 22.5)  # angle of the beams from the vertical
    min_range_m: float = number(0.01, 5, 0.05)  # a closer bottom gives no measurement
    max_range_m: float = number(1, 300, 50.0)  # a bottom farther away gives no measurement
    beam_noise_m_s: float = number(0, 1, 0.004)  # 1 sigma of the velocity of a beam
    scale_error: float = number(0, 0.1, 0.001)  # 1 sigma of a constant scale error of the velocity
    range_noise_share: float = number(0, 0.1, 0.001)  # 1 sigma of the range of a beam, as a share of it
    misalignment_deg: float = number(0, 10, 0.0)  # 1 sigma of the mount relative to its calibration
    assumed_sound_speed_m_s: float | None = number(1300, 1700, None)
    """Speed of sound that velocities are computed with; default: the true one."""
    invalid: float = number(0, 0.2, 0.0)  # share of pings without bottom lock although the bottom is there: 1 to 10 %
    invalid_risky: float | None = number(0, 1, None)  # the same over plants and below low_m; default: as elsewhere
    outliers: float = number(0, 0.1, 0.0)  # share of pings in which a beam has a wrong velocity that is marked valid
    outliers_risky: float | None = number(0, 0.5, None)  # the same over plants and below low_m
    outlier_m_s: float = number(0.01, 2, 0.5)  # 1 sigma of that error: a plant in the surge, or a side lobe
    low_m: float = number(0, 2, 0.3)
    """Altitude below which pings are at risk, as the transducer still rings when the echo arrives."""
    latency_ms: float = number(0, 300, 0.0)  # mean delay of the timestamps, which are those of arrival: 50 to 200 ms
    min_rate_hz: float | None = number(0.1, 50, None)
    """Rate at max_range_m; the time between pings grows linearly with altitude (A50: 2 to 15 Hz); default: rate_hz
    throughout."""

    def check(self, where: str) -> None:
        super().check(where)
        if self.min_rate_hz is not None and self.min_rate_hz > self.rate_hz:
            raise RecipeError(
                f"{where}: key 'dvl.min_rate_hz': expected at most rate_hz = {self.rate_hz:g}, got {self.min_rate_hz:g}"
            )
        for key in ("invalid", "outliers"):
            elsewhere, risky = getattr(self, key), getattr(self, f"{key}_risky")
            if risky is not None and risky < elsewhere:
                raise RecipeError(
                    f"{where}: key 'dvl.{key}_risky': expected at least {key} = {elsewhere:g}, got {risky:g}: "
                    "pings over plants and near the bottom fail more often, not less"
                )


@dataclass(frozen=True)
class DvlCalibration:
    """A DVL: pose; directions of its beams (4, 3), unit vectors in its frame; maximum range, m; scale, the ratio of its
    velocities to the true ones."""

    T_base_sensor: Array
    beam_directions: Array
    max_range_m: float
    scale: float = 1.0


def measure(
    path: Path,
    caster: RayCaster,
    recipe: DvlRecipe,
    site: SiteRecipe,
    times_s: Array,
    stamps_ns: Sequence[int] | NDArray[np.int64],
    streams: Streams,
    bottom: str = "sand",
    scale: float = 1.0,
) -> tuple[list[DvlMeasurement], Strikes]:
    """Measurements at times (N,) s, stamped with stamps_ns (N,), and the faults that struck them.

    The velocity of the DVL along each beam, multiplied by the scale error and the ratio of assumed to true speed of
    sound, plus noise; a beam is valid where its echo can be measured. bottom: one of recipe.BOTTOMS. scale: a further
    factor on all velocities.
    """
    times_s = np.asarray(times_s, dtype=float)
    branch = streams.at("dvl")
    n = len(times_s)
    scale *= 1.0 + recipe.scale_error * float(branch.generator("scale").standard_normal())
    twist = np.radians(recipe.misalignment_deg) * branch.generator("misalignment").standard_normal(3)
    beams = beam_directions(recipe)
    mount = mount_rotation(recipe)
    true_beams = beams @ (mount @ scipy.spatial.transform.Rotation.from_rotvec(twist).as_matrix()).T  # in base_link
    velocity_noise = recipe.beam_noise_m_s * branch.generator("velocity").standard_normal((n, 4))
    range_noise = 1.0 + recipe.range_noise_share * branch.generator("range").standard_normal((n, 4))

    motion = path.at(times_s)
    origins = motion.position + np.einsum("nij,j->ni", motion.rotation, recipe.position_m)
    moving = np.einsum("nji,nj->ni", motion.rotation, motion.velocity) + np.cross(motion.rate, recipe.position_m)
    speeds = np.array([acoustics.sound_speed(site, -z) for z in origins[:, 2]])
    stretch = ((recipe.assumed_sound_speed_m_s or speeds) / speeds)[:, None]
    ranges, valid, plants = np.empty((n, 4)), np.empty((n, 4), dtype=bool), np.empty(n, dtype=bool)
    for first in range(0, n, PINGS_AT_ONCE):
        chunk = slice(first, first + PINGS_AT_ONCE)
        ranges[chunk], valid[chunk], plants[chunk] = listen(
            caster, recipe, site, bottom, origins[chunk], motion.rotation[chunk], true_beams
        )
    heights = np.where(valid, ranges * np.cos(np.radians(recipe.janus_deg)), np.inf).min(axis=1)
    strikes = strike(recipe, plants | (heights < recipe.low_m), branch)
    ranges = ranges * stretch * range_noise
    valid = valid & ~strikes.invalid[:, None]
    valid = valid & (ranges >= recipe.min_range_m) & (ranges <= recipe.max_range_m)
    along = moving @ true_beams.T * scale * stretch + velocity_noise
    if recipe.outliers or recipe.outliers_risky:
        along[np.arange(n), branch.generator("outlier", "beam").integers(0, 4, n)] += strikes.outliers
    measured = [
        _measurement(int(stamps_ns[k]), recipe, beams, np.where(valid[k], ranges[k], np.nan), along[k], valid[k])
        for k in range(n)
    ]
    return measured, strikes


def beam_directions(recipe: DvlRecipe) -> Array:
    """Unit vectors (4, 3) of the beams in the DVL's frame (x forward, y left, z up)."""
    off, around = np.radians(recipe.janus_deg), np.radians(BEAM_AZIMUTHS_DEG)
    down = np.full(4, -np.cos(off))
    return np.column_stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), down])


def mount_rotation(recipe: DvlRecipe) -> Array:
    """R_base_dvl (3, 3) as calibrated."""
    return scipy.spatial.transform.Rotation.from_euler("Z", recipe.yaw_deg, degrees=True).as_matrix()


def solve(beams: Array, along: Array, valid: NDArray[np.bool_], noise: float) -> tuple[Array, Array]:
    """Least-squares velocity (3,) and its covariance (3, 3) from velocities (4,) along those beams (4, 3) that are
    valid (4,); noise: 1 sigma of each. NaN with fewer than three valid beams."""
    if valid.sum() < FEWEST_BEAMS:
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    matrix = beams[valid]
    inverse = np.linalg.inv(matrix.T @ matrix)
    velocity: Array = inverse @ (matrix.T @ along[valid])
    return velocity, np.round(noise**2 * inverse, 15)


def _measurement(
    stamp: int, recipe: DvlRecipe, beams: Array, ranges: Array, along: Array, valid: NDArray[np.bool_]
) -> DvlMeasurement:
    """Measurement of one ping."""
    velocity, covariance = solve(beams, along, valid, recipe.beam_noise_m_s)
    locked = valid.sum() >= FEWEST_BEAMS
    return DvlMeasurement(
        stamp_ns=stamp,
        velocity=velocity,
        covariance=covariance,
        figure_of_merit=float(np.sqrt(np.trace(covariance))),
        altitude=float(np.mean(-ranges[valid] * beams[valid, 2])) if locked else float("nan"),
        beam_directions=beams,
        beam_ranges=ranges,
        beam_velocities=np.where(valid, along, np.nan),
        beam_valid=valid,
    )


def _velocity_row(message: Any) -> Row:
    variances = message.twist.covariance[[0, 7, 14]]
    return columns_of("velocity_", message.twist.twist.linear) | {
        f"variance_{axis}": float(value) for axis, value in zip(XYZ, variances, strict=True)
    }


def _beams_row(message: Any) -> Row:
    keys = ("range", "velocity", "valid")
    return {f"{key}_{k}": beam[key].item() for k, beam in enumerate(point_rows(message)) for key in keys}


class Dvl(SensorKind[DvlRecipe, DvlCalibration, DvlMeasurement]):
    """Sensor kind: DVL."""

    recipe = DvlRecipe
    calibration = DvlCalibration
    title = "DVL"
    reader = "dvl"
    rank = 20
    leaves: ClassVar = {"velocity": VELOCITY, "beams": POINTS, "altitude": RANGE}
    tables: ClassVar = {
        "velocity": _velocity_row,
        "beams": _beams_row,
        "altitude": lambda message: {"range": message.range},
    }

    def calibrate(self, recipe: DvlRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {
            "T_base_sensor": transform(mount_rotation(recipe), recipe.position_m).tolist(),
            "beam_directions": beam_directions(recipe).tolist(),
            "max_range_m": recipe.max_range_m,
        }

    def error_model(self, recipe: DvlRecipe, entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
        mount = mount_errors(quality.dvl_deg, quality.mount_m)
        return ErrorModel.of(mount | independent({"scale": quality.dvl_scale}))

    def as_given(
        self, recipe: DvlRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        return super().as_given(recipe, entry, errors, quality) | {"scale": 1.0}

    def as_true(
        self, recipe: DvlRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        return {**entry, "scale": 1.0 - errors["scale"]}

    def measure(self, world: SensedWorld, recipe: DvlRecipe, at: Instants) -> Iterator[DvlMeasurement]:
        measured, _ = self._measured(world, recipe, at.times_s, arrivals(recipe, at.stamps_ns, world.streams))
        for k in at.wanted:
            readings: dict[str, Any] = {key: quantise(getattr(measured[k], key), READING_STEP) for key in READINGS}
            yield dataclasses.replace(measured[k], **readings)

    def _measured(
        self, world: SensedWorld, recipe: DvlRecipe, times_s: Array, stamps_ns: NDArray[np.int64]
    ) -> tuple[list[DvlMeasurement], Strikes]:
        site, bottom = world.recipe.site, world.recipe.reef.bottom
        scale = self.true_entry(world, recipe).get("scale", 1.0)
        return measure(world.path, world.caster, recipe, site, times_s, stamps_ns, world.streams, bottom, scale)

    def times(self, world: SensedWorld, recipe: DvlRecipe) -> Array | None:
        """Times (N,) s of the pings, which depend on the altitude with `min_rate_hz`; None (even) without it."""
        if recipe.min_rate_hz is None:
            return None
        grid = np.arange(0.0, world.recipe.duration_s + ALTITUDE_STEP_S, ALTITUDE_STEP_S)
        motion = world.path.at(grid)
        places = motion.position + motion.rotation @ np.asarray(recipe.position_m)
        down = np.tile([0.0, 0.0, -1.0], (len(grid), 1))
        ranges = world.caster.cast(places, down, recipe.max_range_m).ranges.astype(float)
        heights = np.round(np.minimum(ranges, recipe.max_range_m), 3)
        return ping_times(recipe, world.recipe.duration_s, lambda time: float(np.interp(time, grid, heights)))

    def faults(self, world: SensedWorld, recipe: DvlRecipe) -> list[Fault]:
        """Pings without bottom lock, pings with an outlier, and the latency."""
        found = []
        if recipe.latency_ms:
            found.append(Fault(0.0, world.recipe.duration_s, "latency_s", 1e-3 * recipe.latency_ms))
        if recipe.invalid or recipe.invalid_risky or recipe.outliers or recipe.outliers_risky:
            known = self.times(world, recipe)
            regular = np.arange(count(world.recipe.duration_s, recipe.rate_hz)) / recipe.rate_hz
            times = regular if known is None else known
            _, strikes = self._measured(world, recipe, times, np.zeros(len(times), dtype=np.int64))
            found += spans(times, strikes.invalid, "invalid", np.ones(len(times)))
            for k in np.flatnonzero(strikes.outliers):
                found.append(Fault(float(times[k]), float(times[k]), "outlier_m_s", float(strikes.outliers[k])))
        return found

    def encode(self, recipe: DvlRecipe, measurement: DvlMeasurement) -> list[Message]:
        """Messages: velocity with its covariance, angular rates marked as not measured by a variance of -1; the beams,
        one point each, NaN without lock; and the altitude along the DVL's -z, NaN without lock (REP 117)."""
        stamp, frame = measurement.stamp_ns, link("dvl")
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = measurement.covariance
        covariance[3, 3] = -1.0
        twist = make("geometry_msgs/msg/Twist", linear=vector(measurement.velocity), angular=vector(np.zeros(3)))
        velocity = make(
            VELOCITY,
            header=header(stamp, frame),
            twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()),
        )
        rows = np.zeros(len(measurement.beam_ranges), dtype=BEAM)
        hits = measurement.beam_directions * np.asarray(measurement.beam_ranges)[:, None]
        for axis, values in zip("xyz", hits.T, strict=True):
            rows[axis] = values
        rows["range"], rows["velocity"] = measurement.beam_ranges, measurement.beam_velocities
        rows["valid"] = measurement.beam_valid
        limits, span = (recipe.min_range_m, recipe.max_range_m), 2.0 * np.radians(recipe.janus_deg)
        return [
            Message("/dvl/velocity", stamp, encode(velocity)),
            Message("/dvl/beams", stamp, points_bytes(stamp, frame, rows)),
            Message("/dvl/altitude", stamp, range_bytes(stamp, frame, measurement.altitude, limits, span)),
        ]

    def decode(self, name: str, calibration: DvlCalibration, *data: bytes) -> DvlMeasurement:
        """Decode a measurement. Beams and altitude are stored as float32; the figure of merit is the square root of the
        covariance's trace. Raises ValueError where the stamps differ."""
        velocity, points, height = (decode(one, kind) for one, kind in zip(data, self.leaves.values(), strict=True))
        stamps = {stamp_of(message.header) for message in (velocity, points, height)}
        if len(stamps) > 1:
            raise ValueError(f"the DVL's velocity, beams and altitude at {min(stamps)} are not of one stamp")
        rows, linear = point_rows(points), velocity.twist.twist.linear
        covariance = np.array(velocity.twist.covariance, dtype=float).reshape(6, 6)[:3, :3].copy()
        return DvlMeasurement(
            stamp_ns=stamps.pop(),
            velocity=np.array([linear.x, linear.y, linear.z]),
            covariance=covariance,
            figure_of_merit=float(np.sqrt(np.trace(covariance))),
            altitude=float(height.range),
            beam_directions=calibration.beam_directions,
            beam_ranges=rows["range"].astype(float),
            beam_velocities=rows["velocity"].astype(float),
            beam_valid=rows["valid"].astype(bool),
        )

    def strips(self, name: str) -> list[Strip]:
        return [
            Strip("/dvl/velocity", "DVL velocity, m/s", tuple(f"velocity_{axis}" for axis in XYZ)),
            Strip("/dvl/altitude", "DVL altitude, m", ("range",)),
        ]


KIND = Dvl()
