"""Pressure sensor: the weight of air and water above it, with the tide and the waves of the site."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.polynomial.polynomial import polyval

from oysterbench.core.geometry import GRAVITY, Array, transform
from oysterbench.core.measurements import PressureMeasurement
from oysterbench.core.ros import Message, decode, encode, header, make, stamp_of
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.faults import Fault
from oysterbench.sensors.kind import Instants, SensedWorld, SensorKind, Strip, link, quantise

if TYPE_CHECKING:
    from oysterbench.scene.path import Path
    from oysterbench.scene.waves import Waves

FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
PRESSURE_STEP = 1e-3  # Pa, to which readings are rounded

ATMOSPHERE = 101_325.0
"""Pressure at the surface, Pa."""

FRESH = (999.842594, 6.793952e-2, -9.095290e-3, 1.001685e-4, -1.120083e-6, 6.536332e-9)
SALT = (8.24493e-1, -4.0899e-3, 7.6438e-5, -8.2467e-7, 5.3875e-9)
SALT_ROOT = (-5.72466e-3, 1.0227e-4, -1.6546e-6)
SALT_SQUARED = 4.8314e-4
"""Density coefficients, kg/m^3, by powers of deg C: of pure water, and with salinity S, S^1.5 and S^2 (Millero &
Poisson 1981; UNESCO 44)."""


@dataclass(frozen=True, kw_only=True)
class PressureRecipe(SensorRecipe):
    """A pressure sensor. Tide and waves are properties of the site (`SiteRecipe`)."""

    block: ClassVar[str] = "pressure"

    rate_hz: float = number(0.1, 1000, 20.0)
    offset_m: float = number(0, 5, 0.02)  # 1 sigma of a constant offset of depth
    noise_m: float = number(0, 1, 0.002)  # 1 sigma of depth
    step_pa: float = number(0, 1e5, 20.0)  # resolution of the digital reading
    max_depth_m: float = number(1, 11_000, 300.0)  # readings saturate there
    drift_m: float = number(0, 0.5, 0.0)
    """Zero drift in depth, 1 sigma, until the sensor has reached the water's temperature; 1 to 10 cm for sensors of the
    Bar30's class (practice)."""
    drift_tau_s: float = number(10, 36_000, 600.0)  # time constant of that drift


@dataclass(frozen=True)
class PressureCalibration:
    """A pressure sensor: pose; density of the water, kg/m^3, and air pressure at the surface, Pa."""

    T_base_sensor: Array
    density: float
    atmosphere: float


def density(site: SiteRecipe) -> float:
    """Density of the site's water at the surface, kg/m^3: the one-atmosphere equation of state EOS-80."""
    t, s = site.temperature_c, site.salinity_ppt
    return float(polyval(t, FRESH) + polyval(t, SALT) * s + polyval(t, SALT_ROOT) * s**1.5 + SALT_SQUARED * s**2)


def depth_of(pressure: Array, site: SiteRecipe) -> Array:
    """Depth (N,) m below the mean surface in still water at absolute pressures (N,) Pa."""
    return (np.asarray(pressure) - ATMOSPHERE) / (density(site) * GRAVITY)


def measure(
    path: Path, recipe: PressureRecipe, site: SiteRecipe, waves: Waves, times_s: Array, streams: Streams
) -> Array:
    """Absolute pressure (N,) Pa that the sensor reports at times (N,) s.

    waves: those of the site (`build_waves`), which also move the vehicle. Out of the water the sensor measures the air
    pressure.
    """
    motion = path.at(times_s)
    place = motion.position + motion.rotation @ np.asarray(recipe.position_m)
    head = np.maximum(tide(site, times_s, streams) - place[:, 2] + waves.head(place, times_s), 0.0)
    offset = recipe.offset_m * streams.generator("pressure", "offset").standard_normal()
    noise = recipe.noise_m * streams.generator("pressure", "noise").standard_normal(len(times_s))
    zero = np.full(len(times_s), offset)
    if recipe.drift_m:
        zero = zero + drift(recipe, times_s, streams)
    weight = density(site) * GRAVITY
    pressure: Array = ATMOSPHERE + weight * np.minimum(head + zero + noise, recipe.max_depth_m)
    return np.asarray(np.rint(pressure / recipe.step_pa) * recipe.step_pa) if recipe.step_pa else pressure


def drift(recipe: PressureRecipe, times_s: Array, streams: Streams) -> Array:
    """Drift of the zero in depth (N,) m since the start, towards a random final value: as 1 - exp(-t / tau)."""
    end = recipe.drift_m * float(streams.generator("pressure", "drift").standard_normal())
    return np.asarray(-end * np.expm1(-times_s / recipe.drift_tau_s))


def tide(site: SiteRecipe, times_s: Array, streams: Streams) -> Array:
    """Height (N,) m of the tide above z = 0: a sine with a random phase at the start of the sequence."""
    phase = streams.generator("site", "tide").uniform(0, 2 * np.pi)
    return site.tide_m * np.sin(2 * np.pi * times_s / (3600.0 * site.tide_period_h) + phase)


def noise_variance(recipe: PressureRecipe, site: SiteRecipe) -> float:
    """Variance (Pa^2) of a reading about its mean: noise plus quantisation."""
    return (density(site) * GRAVITY * recipe.noise_m) ** 2 + recipe.step_pa**2 / 12


class PressureSensor(SensorKind[PressureRecipe, PressureCalibration, PressureMeasurement]):
    """Sensor kind: pressure sensor."""

    recipe = PressureRecipe
    calibration = PressureCalibration
    title = "pressure sensor"
    reader = "pressure"
    rank = 30
    leaves: ClassVar = {"": FLUID_PRESSURE}
    tables: ClassVar = {"": lambda message: {"pressure": message.fluid_pressure, "variance": message.variance}}

    def calibrate(self, recipe: PressureRecipe, site: SiteRecipe) -> dict[str, Any]:
        T_base_sensor = transform(np.eye(3), recipe.position_m).tolist()
        return {"T_base_sensor": T_base_sensor, "density": density(site), "atmosphere": ATMOSPHERE}

    def measure(self, world: SensedWorld, recipe: PressureRecipe, at: Instants) -> Iterator[PressureMeasurement]:
        from oysterbench.scene.waves import build_waves

        site, streams = world.recipe.site, world.streams
        waves = build_waves(site, world.recipe.reef.depth_m, streams)  # the ones that move the vehicle
        values = measure(world.path, recipe, site, waves, at.times_s, streams)
        values, variance = quantise(values, PRESSURE_STEP), noise_variance(recipe, site)
        return (PressureMeasurement(int(at.stamps_ns[k]), float(values[k]), variance) for k in at.wanted)

    def faults(self, world: SensedWorld, recipe: PressureRecipe) -> list[Fault]:
        """Drift of the sensor's zero over the sequence."""
        if not recipe.drift_m:
            return []
        end = world.recipe.duration_s
        return [Fault(0.0, end, "zero_drift_m", float(drift(recipe, np.array([end]), world.streams)[0]))]

    def encode(self, recipe: PressureRecipe, measurement: PressureMeasurement) -> list[Message]:
        """Message with the absolute pressure, Pa."""
        message = make(
            FLUID_PRESSURE,
            header=header(measurement.stamp_ns, link("pressure")),
            fluid_pressure=float(measurement.pressure),
            variance=float(measurement.variance),
        )
        return [Message("/pressure", measurement.stamp_ns, encode(message))]

    def decode(self, name: str, calibration: PressureCalibration, *data: bytes) -> PressureMeasurement:
        message = decode(data[0], FLUID_PRESSURE)
        return PressureMeasurement(stamp_of(message.header), float(message.fluid_pressure), float(message.variance))

    def strips(self, name: str) -> list[Strip]:
        return [Strip("/pressure", "pressure, kPa", ("pressure",), 1e-3)]


KIND = PressureSensor()
