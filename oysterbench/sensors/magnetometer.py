"""Magnetometer: the Earth's field in the sensor's frame, bent by the iron that the vehicle carries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import MagneticMeasurement
from oysterbench.core.ros import Message, decode, encode, header, make, stamp_of, vector
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.imu import imu_pose
from oysterbench.sensors.kind import XYZ, Instants, SensedWorld, SensorKind, Strip, columns_of, link, quantise

if TYPE_CHECKING:
    from oysterbench.scene.path import Path

MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
MICROTESLA = 1e-6  # T
FIELD_STEP = 1e-12  # T, to which readings are rounded


@dataclass(frozen=True, kw_only=True)
class MagnetometerRecipe(SensorRecipe):
    """Three fluxgates or the like, in the Earth's field (`SiteRecipe`) and the vehicle's own."""

    block: ClassVar[str] = "magnetometer"

    rate_hz: float = number(0.1, 1000, 50.0)
    noise_ut: float = number(0, 10, 0.3)  # uT, 1 sigma of a sample
    hard_iron_ut: tuple[float, float, float] = number(-1000, 1000, (0.0, 0.0, 0.0))  # in the sensor's frame
    soft_iron: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = number(
        -10, 10, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    )  # takes the Earth's field to the one at the sensor, both in its frame
    step_ut: float = number(0, 10, 0.0)
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # magnetometer to base_link


@dataclass(frozen=True)
class MagnetometerCalibration:
    """A magnetometer: pose."""

    T_base_sensor: Array


def earth_field(site: SiteRecipe) -> Array:
    """The Earth's magnetic field (3,) T at the site, in `map` (east, north, up)."""
    dip, east_of_north = np.radians(site.inclination_deg), np.radians(site.declination_deg)
    level = np.cos(dip)
    direction = [level * np.sin(east_of_north), level * np.cos(east_of_north), -np.sin(dip)]
    return site.field_ut * MICROTESLA * np.array(direction)


def measure(path: Path, recipe: MagnetometerRecipe, site: SiteRecipe, times_s: Array, streams: Streams) -> Array:
    """Field (N, 3) T that the sensor reports at times (N,) s, in its own frame.

    b = A R^T B + h + noise, with soft iron A and hard iron h (Gebre-Egziabher et al. 2006), in the steps of the
    digital reading.
    """
    rotation = path.at(times_s).rotation @ Rotation.from_euler("xyz", recipe.rpy_deg, degrees=True).as_matrix()
    earth = np.einsum("nji,j->ni", rotation, earth_field(site))
    noise = recipe.noise_ut * streams.generator("magnetometer", "noise").standard_normal((len(times_s), 3))
    field: Array = earth @ np.asarray(recipe.soft_iron).T + MICROTESLA * (np.asarray(recipe.hard_iron_ut) + noise)
    step = recipe.step_ut * MICROTESLA
    return np.asarray(np.rint(field / step) * step) if step else field


def noise_variance(recipe: MagnetometerRecipe) -> float:
    """Variance (T^2) of an axis of a reading about its mean: of its noise and of its steps."""
    return MICROTESLA**2 * (recipe.noise_ut**2 + recipe.step_ut**2 / 12)


class Magnetometer(SensorKind[MagnetometerRecipe, MagnetometerCalibration, MagneticMeasurement]):
    """The kind."""

    recipe = MagnetometerRecipe
    calibration = MagnetometerCalibration
    title = reader = "magnetometer"
    rank = 40
    leaves: ClassVar = {"": MAGNETIC_FIELD}
    tables: ClassVar = {"": lambda message: columns_of("field_", message.magnetic_field)}

    def calibrate(self, recipe: MagnetometerRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {"T_base_sensor": imu_pose(recipe).tolist()}

    def measure(self, world: SensedWorld, recipe: MagnetometerRecipe, at: Instants) -> Iterator[MagneticMeasurement]:
        fields = measure(world.path, recipe, world.recipe.site, at.times_s, world.streams)
        fields, variance = quantise(fields, FIELD_STEP), noise_variance(recipe)
        return (MagneticMeasurement(int(at.stamps_ns[k]), fields[k], variance) for k in at.wanted)

    def encode(self, recipe: MagnetometerRecipe, measurement: MagneticMeasurement) -> list[Message]:
        """Magnetic field, T."""
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
