"""Doppler velocity log: four beams in Janus form, each with a velocity, a range and a lock of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors import acoustics
from oysterbench.sensors.kind import XYZ, Instants, Row, SensedWorld, SensorKind, Strip, columns_of, link, quantise
from oysterbench.sensors.uncertainty import ErrorModel, Quality, independent, mount_errors

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.scene.path import Path

VELOCITY = "geometry_msgs/msg/TwistWithCovarianceStamped"
FREQUENCY_KHZ = 1000.0  # of the A50 class
BEAM_AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
CONE_RAYS, CONE_DEG = 6, 1.5  # around each beam's axis, and how far off it: a beam is some 4 deg wide
GRAZING_COSINE = 0.25  # of the incidence, below which an echo is too long to measure
WEAKEST_BOTTOM = "mud"  # that it holds on to at its greatest range
MARGIN = 1.2  # that rays reach farther, for an assumed speed of sound that makes ranges shorter
FEWEST_BEAMS = 3  # for three components of velocity
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
"""A beam as a point: where it meets the bottom in the DVL's frame (m), range (m) and velocity (m/s) along it, valid."""


@dataclass(frozen=True, kw_only=True)
class DvlRecipe(SensorRecipe):
    """A Doppler velocity log: four beams in Janus form, looking down."""

    block: ClassVar[str] = "dvl"

    rate_hz: float = number(0.1, 50, 8.0)
    yaw_deg: float = number(-180, 180, 0.0)  # of the mount; beams lie at 45, 135, 225 and 315 deg from its x axis
    janus_deg: float = number(5, 45, 22.5)  # beams off the vertical
    min_range_m: float = number(0.01, 5, 0.05)
    max_range_m: float = number(1, 300, 50.0)
    beam_noise_m_s: float = number(0, 1, 0.004)  # 1 sigma of a beam's velocity
    scale_error: float = number(0, 0.1, 0.001)  # 1 sigma of a constant share of the velocity
    range_noise_share: float = number(0, 0.1, 0.001)  # of a beam's range, 1 sigma
    misalignment_deg: float = number(0, 10, 0.0)  # of the mount against its calibration, 1 sigma
    assumed_sound_speed_m_s: float | None = number(1300, 1700, None)


@dataclass(frozen=True)
class DvlCalibration:
    """A DVL: pose; directions of its beams (4, 3), unit vectors in its frame; greatest range, m; its velocities over
    the true ones."""

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
) -> list[DvlMeasurement]:
    """What the log reports at times (N,) s, stamped with stamps_ns (N,); at its recipe's rate at any altitude.

    The velocity of the log along each beam, scaled by the error of scale and the assumed over the true speed of sound,
    with noise; a beam counts where it finds an echo that can be measured. bottom: of recipe.BOTTOMS. scale: a factor
    on all velocities, besides.
    """
    times_s = np.asarray(times_s, dtype=float)
    branch = streams.at("dvl")
    n = len(times_s)
    scale *= 1.0 + recipe.scale_error * float(branch.generator("scale").standard_normal())
    twist = np.radians(recipe.misalignment_deg) * branch.generator("misalignment").standard_normal(3)
    beams = beam_directions(recipe)
    mount = mount_rotation(recipe)
    true_beams = beams @ (mount @ Rotation.from_rotvec(twist).as_matrix()).T  # in base_link
    velocity_noise = recipe.beam_noise_m_s * branch.generator("velocity").standard_normal((n, 4))
    range_noise = 1.0 + recipe.range_noise_share * branch.generator("range").standard_normal((n, 4))

    motion = path.at(times_s)
    origins = motion.position + np.einsum("nij,j->ni", motion.rotation, recipe.position_m)
    moving = np.einsum("nji,nj->ni", motion.rotation, motion.velocity) + np.cross(motion.rate, recipe.position_m)
    speeds = np.array([acoustics.sound_speed(site, -z) for z in origins[:, 2]])
    stretch = ((recipe.assumed_sound_speed_m_s or speeds) / speeds)[:, None]
    ranges, valid = np.empty((n, 4)), np.empty((n, 4), dtype=bool)
    for first in range(0, n, PINGS_AT_ONCE):
        chunk = slice(first, first + PINGS_AT_ONCE)
        ranges[chunk], valid[chunk] = _listen(
            caster, recipe, site, bottom, origins[chunk], motion.rotation[chunk], true_beams
        )
    ranges = ranges * stretch * range_noise
    valid = valid & (ranges >= recipe.min_range_m) & (ranges <= recipe.max_range_m)
    along = moving @ true_beams.T * scale * stretch + velocity_noise
    return [
        _measurement(int(stamps_ns[k]), recipe, beams, np.where(valid[k], ranges[k], np.nan), along[k], valid[k])
        for k in range(n)
    ]


def beam_directions(recipe: DvlRecipe) -> Array:
    """Unit vectors (4, 3) of the beams in the log's frame (x forward, y left, z up)."""
    off, around = np.radians(recipe.janus_deg), np.radians(BEAM_AZIMUTHS_DEG)
    down = np.full(4, -np.cos(off))
    return np.column_stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), down])


def mount_rotation(recipe: DvlRecipe) -> Array:
    """R_base_dvl (3, 3) as calibrated."""
    return Rotation.from_euler("Z", recipe.yaw_deg, degrees=True).as_matrix()


def solve(beams: Array, along: Array, valid: NDArray[np.bool_], noise: float) -> tuple[Array, Array]:
    """Velocity (3,) and its covariance (3, 3), by least squares, from velocities (4,) along beams (4, 3) of which those
    marked valid (4,) count, with a noise of 1 sigma each; NaN with fewer than three beams."""
    if valid.sum() < FEWEST_BEAMS:
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    matrix = beams[valid]
    inverse = np.linalg.inv(matrix.T @ matrix)
    velocity: Array = inverse @ (matrix.T @ along[valid])
    return velocity, np.round(noise**2 * inverse, 15)


def _listen(
    caster: RayCaster,
    recipe: DvlRecipe,
    site: SiteRecipe,
    bottom: str,
    origins: Array,
    rotations: Array,
    beams: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """True ranges (N, 4) m of the beams (4, 3) in base_link, and whether their echoes can be measured (N, 4).

    The mean over a beam's rays, by the strength of their echoes. An echo is lost where the beam grazes the surface, and
    where it is weaker than that of mud, at the incidence of a level bottom, from the greatest range.
    """
    rays = np.concatenate([_cone(beam) for beam in beams])
    directions = np.einsum("nij,rj->nri", rotations, rays)
    starts = np.repeat(origins, len(rays), axis=0)
    echoes = caster.cast(starts, directions.reshape(-1, 3), MARGIN * recipe.max_range_m)
    cosines = np.abs(np.einsum("ni,ni->n", echoes.normals.astype(float), directions.reshape(-1, 3)))
    loss = acoustics.absorption(site, -float(origins[:, 2].mean()), FREQUENCY_KHZ)
    mu = acoustics.backscatter(bottom)[echoes.classes]
    steep = np.where(cosines >= GRAZING_COSINE, mu, 0.0)
    shape = (len(origins), 4, CONE_RAYS + 1)
    seen = echoes.ranges.astype(float).reshape(shape)
    strengths = acoustics.echo_strength(seen, cosines.reshape(shape), steep.reshape(shape), loss)
    total = strengths.sum(axis=2)
    ranges = (strengths * np.where(np.isfinite(seen), seen, 0.0)).sum(axis=2) / np.where(total > 0, total, 1.0)
    weakest = acoustics.backscatter(WEAKEST_BOTTOM)[1]
    slant = np.cos(np.radians(recipe.janus_deg + CONE_DEG))
    threshold = acoustics.echo_strength(np.array(recipe.max_range_m), slant, weakest, loss)
    return ranges, total / (CONE_RAYS + 1) >= threshold


def _cone(axis: Array) -> Array:
    """The axis (3,) of a beam and CONE_RAYS rays around it, unit vectors."""
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    around = 2 * np.pi * np.arange(CONE_RAYS)[:, None] / CONE_RAYS
    off = np.radians(CONE_DEG)
    ring = np.cos(off) * axis + np.sin(off) * (np.cos(around) * side + np.sin(around) * other)
    return np.concatenate([axis[None], ring])


def _measurement(
    stamp: int, recipe: DvlRecipe, beams: Array, ranges: Array, along: Array, valid: NDArray[np.bool_]
) -> DvlMeasurement:
    """One message's worth."""
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
    """The kind."""

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
        site, bottom = world.recipe.site, world.recipe.reef.bottom
        times, stamps = at.times_s, at.stamps_ns
        scale = self.true_entry(world, recipe).get("scale", 1.0)
        measured = measure(world.path, world.caster, recipe, site, times, stamps, world.streams, bottom, scale)
        for k in at.wanted:
            readings: dict[str, Any] = {key: quantise(getattr(measured[k], key), READING_STEP) for key in READINGS}
            yield dataclasses.replace(measured[k], **readings)

    def encode(self, recipe: DvlRecipe, measurement: DvlMeasurement) -> list[Message]:
        """Velocity with its covariance, its rates marked as not measured by a variance of -1; the beams, a point each,
        NaN where one has no lock; and the altitude along the DVL's -z, NaN without lock (REP 117)."""
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
        """Beams and altitude travel as float32; the figure of merit is the root of the covariance's trace."""
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
