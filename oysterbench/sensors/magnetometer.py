"""Magnetometer: the Earth's field in the sensor's frame, distorted by iron on the vehicle and by other sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import MagneticMeasurement
from oysterbench.core.ros import Message, decode, encode, header, make, stamp_of, vector
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.faults import Fault, spans
from oysterbench.sensors.imu import imu_pose
from oysterbench.sensors.iron import build_iron, deviation, motor_field
from oysterbench.sensors.kind import XYZ, Instants, SensedWorld, SensorKind, Strip, columns_of, link, quantise
from oysterbench.sensors.uncertainty import ErrorModel, Quality, axes, independent, mount_errors

if TYPE_CHECKING:
    from oysterbench.scene.path import Path

MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
MICROTESLA = 1e-6  # T
FIELD_STEP = 1e-12  # T, to which readings are rounded
FAULT_STEP_S, LEAST_FAULT_DEG = 0.1, 1.0  # of the ground truth of faults: time step, and least deviation
HARD_IRON = tuple(axes("hard_iron", "t"))
SOFT_IRON = tuple(f"soft_iron_{row}{column}" for row in XYZ for column in XYZ)


@dataclass(frozen=True, kw_only=True)
class MagnetometerRecipe(SensorRecipe):
    """A three-axis magnetometer (fluxgates or similar), in the Earth's field (`SiteRecipe`) and that of the vehicle."""

    block: ClassVar[str] = "magnetometer"

    rate_hz: float = number(0.1, 1000, 50.0)
    noise_ut: float = number(0, 10, 0.3)  # uT, 1 sigma of a sample
    hard_iron_ut: tuple[float, float, float] = number(-1000, 1000, (0.0, 0.0, 0.0))
    """Constant field of the vehicle, uT, in the sensor's frame."""
    soft_iron: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = number(
        -10, 10, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    )  # matrix from the Earth's field to the field at the sensor, both in the sensor's frame
    step_ut: float = number(0, 10, 0.0)  # resolution of the digital reading
    throttle_deg: float = number(0, 25, 0.0)
    """Greatest heading error at full throttle over all headings, by the field of the motors: 5 to 20 deg close to them
    (ArduPilot calls interference of 30 % of the field, 17 deg, acceptable, and of 60 % not)."""
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # roll, pitch, yaw: magnetometer to base_link


@dataclass(frozen=True)
class MagnetometerCalibration:
    """A magnetometer: pose; and, if it was swung, the vehicle's iron in the sensor's frame: a constant field (3,) T and
    the matrix (3, 3) from the Earth's field to the field at the sensor; None where unknown."""

    T_base_sensor: Array
    hard_iron_t: Array | None = None
    soft_iron: Array | None = None


def earth_field(site: SiteRecipe) -> Array:
    """The Earth's magnetic field (3,) T at the site, in `map` (east, north, up)."""
    dip, east_of_north = np.radians(site.inclination_deg), np.radians(site.declination_deg)
    level = np.cos(dip)
    direction = [level * np.sin(east_of_north), level * np.cos(east_of_north), -np.sin(dip)]
    return site.field_ut * MICROTESLA * np.array(direction)


@dataclass(frozen=True)
class Iron:
    """Iron on the vehicle: a constant field (3,) uT, and a matrix (3, 3) applied to the Earth's field, both in the
    sensor's frame."""

    hard_ut: Array
    soft: Array

    @classmethod
    def of(cls, recipe: MagnetometerRecipe) -> Iron:
        """Iron that a recipe states."""
        return cls(np.asarray(recipe.hard_iron_ut), np.asarray(recipe.soft_iron))


def measure(
    path: Path,
    recipe: MagnetometerRecipe,
    site: SiteRecipe,
    times_s: Array,
    streams: Streams,
    iron: Iron | None = None,
    bending: Array | None = None,
) -> Array:
    """Field (N, 3) T that the sensor reports at times (N,) s, in its own frame.

    b = A R^T B + h + noise, with soft iron A and hard iron h (Gebre-Egziabher et al. 2006), in the steps of the
    digital reading. iron: replaces the recipe's. bending: fields (N, 3) T in `map` that add to the Earth's.
    """
    mount = scipy.spatial.transform.Rotation.from_euler("xyz", recipe.rpy_deg, degrees=True)
    rotation = path.at(times_s).rotation @ mount.as_matrix()
    earth = np.einsum("nji,j->ni", rotation, earth_field(site))
    if bending is not None:
        earth = earth + np.einsum("nji,nj->ni", rotation, bending)
    noise = recipe.noise_ut * streams.generator("magnetometer", "noise").standard_normal((len(times_s), 3))
    iron = iron or Iron.of(recipe)
    field: Array = earth @ iron.soft.T + MICROTESLA * (iron.hard_ut + noise)
    step = recipe.step_ut * MICROTESLA
    return np.asarray(np.rint(field / step) * step) if step else field


def noise_variance(recipe: MagnetometerRecipe) -> float:
    """Variance (T^2) of one axis of a reading about its mean: noise plus quantisation."""
    return MICROTESLA**2 * (recipe.noise_ut**2 + recipe.step_ut**2 / 12)


class Magnetometer(SensorKind[MagnetometerRecipe, MagnetometerCalibration, MagneticMeasurement]):
    """Sensor kind: magnetometer."""

    recipe = MagnetometerRecipe
    calibration = MagnetometerCalibration
    title = reader = "magnetometer"
    rank = 40
    leaves: ClassVar = {"": MAGNETIC_FIELD}
    tables: ClassVar = {"": lambda message: columns_of("field_", message.magnetic_field)}

    def calibrate(self, recipe: MagnetometerRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {"T_base_sensor": imu_pose(recipe).tolist()}

    def error_model(self, recipe: MagnetometerRecipe, entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
        mount = mount_errors(quality.mount_deg, quality.mount_m)
        hard = dict.fromkeys(HARD_IRON, MICROTESLA * quality.hard_iron_ut)
        return ErrorModel.of(mount | independent(hard | dict.fromkeys(SOFT_IRON, quality.soft_iron)))

    def as_given(
        self, recipe: MagnetometerRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        iron = Iron.of(recipe)
        given = super().as_given(recipe, entry, errors, quality)
        return given | {"hard_iron_t": (MICROTESLA * iron.hard_ut).tolist(), "soft_iron": iron.soft.tolist()}

    def as_true(
        self, recipe: MagnetometerRecipe, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        iron = Iron.of(recipe)
        hard = MICROTESLA * iron.hard_ut - [errors[name] for name in HARD_IRON]
        soft = iron.soft - np.reshape([errors[name] for name in SOFT_IRON], (3, 3))
        return {**entry, "hard_iron_t": hard.tolist(), "soft_iron": soft.tolist()}

    def measure(self, world: SensedWorld, recipe: MagnetometerRecipe, at: Instants) -> Iterator[MagneticMeasurement]:
        true = self.read_calibration(self.true_entry(world, recipe))
        iron = None
        if true.hard_iron_t is not None and true.soft_iron is not None:
            iron = Iron(true.hard_iron_t / MICROTESLA, true.soft_iron)
        sources = self.bending(world, recipe, at.times_s)
        bending = np.sum(list(sources.values()), axis=0) if sources else None
        fields = measure(world.path, recipe, world.recipe.site, at.times_s, world.streams, iron, bending)
        fields, variance = quantise(fields, FIELD_STEP), noise_variance(recipe)
        return (MagneticMeasurement(int(at.stamps_ns[k]), fields[k], variance) for k in at.wanted)

    def bending(self, world: SensedWorld, recipe: MagnetometerRecipe, times_s: Array) -> dict[str, Array]:
        """Source -> field (N, 3) T in `map`, of what is neither the Earth nor iron on board."""
        site = world.recipe.site
        found: dict[str, Array] = {}
        if not (recipe.throttle_deg or site.iron):
            return found
        motion = world.path.at(times_s)
        if recipe.throttle_deg:
            from oysterbench.scene.path.thrust import throttle

            opened = world.instrument(recipe, lambda: throttle(world.path, world.recipe, world.streams))
            shares = opened.at(times_s)
            found["motors"] = motor_field(earth_field(site), recipe.throttle_deg, shares, motion, world.streams)
        if site.iron:
            iron = build_iron(site, world.recipe.reef.size_m, world.caster.world.ground_height, world.streams)
            found["iron"] = iron.field(motion.position + motion.rotation @ np.asarray(recipe.position_m))
        return found

    def faults(self, world: SensedWorld, recipe: MagnetometerRecipe) -> list[Fault]:
        """Spans in which motors, or iron on the bottom, turn the heading by a degree or more."""
        times = np.arange(0.0, world.recipe.duration_s, FAULT_STEP_S)
        found = []
        for source, bent in self.bending(world, recipe, times).items():
            turned = np.degrees(deviation(earth_field(world.recipe.site), bent))
            found += spans(times, np.abs(turned) >= LEAST_FAULT_DEG, f"{source}_deg", turned)
        return found

    def encode(self, recipe: MagnetometerRecipe, measurement: MagneticMeasurement) -> list[Message]:
        """Message with the magnetic field, T."""
        message = make(
            MAGNETIC_FIELD,
            header=header(measurement.stamp_ns, link("magnetometer")),
            magnetic_field=vector(measurement.field),
            magnetic_field_covariance=np.diag([float(measurement.variance)] * 3).ravel(),
        )
        return [Message("/magnetometer", measurement.stamp_ns, encode(message))]

    def decode(self, name: str, calibration: MagnetometerCalibration, *data: bytes) -> MagneticMeasurement:
        message = decode(data[0], MAGNETIC_FIELD)
        field, variance = message.magnetic_field, float(message.magnetic_field_covariance[0])
        return MagneticMeasurement(stamp_of(message.header), np.array([field.x, field.y, field.z]), variance)

    def strips(self, name: str) -> list[Strip]:
        return [Strip("/magnetometer", "magnetic field, µT", tuple(f"field_{axis}" for axis in XYZ), 1e6)]


KIND = Magnetometer()
