"""A dive of all scalar sensors over a level bottom, made by oysterbench's own sensors; no picture is rendered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from oysterbench.core.geometry import Array, left_product
from oysterbench.core.measurements import (
    DvlMeasurement,
    Image,
    ImuMeasurement,
    MagneticMeasurement,
    PressureMeasurement,
)
from oysterbench.core.streams import Streams
from oysterbench.core.trajectory import Trajectory
from oysterbench.recipe import RigRecipe, SensorRecipe, SiteRecipe
from oysterbench.render.rays import Echoes
from oysterbench.scene.path import Path
from oysterbench.scene.waves import build_waves
from oysterbench.sensors import dvl, imu, magnetometer, pressure
from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.imu import COMMON, IMU_GRADES, ImuRecipe
from oysterbench.sensors.magnetometer import MagnetometerRecipe
from oysterbench.sensors.pressure import PressureRecipe
from oysterbench.sensors.registry import read_calibrations, rig_calibration, rig_sensors
from oysterbench.sequence.types import Sequence

START_NS = 1_700_000_000_000_000_000
BOTTOM_M, DEPTH_M = 5.0, 3.5
REST_S, RAMP_S = 2.0, 4.0
KNOT_S = 0.05


class LevelBottom:
    """What a ray caster says of a level bottom of sand at BOTTOM_M."""

    def cast(self, origins: Array, directions: Array, max_range: float) -> Echoes:
        starts = np.broadcast_to(origins, directions.shape)
        falling = np.minimum(directions[:, 2], -1e-9)
        ranges = (starts[:, 2] + BOTTOM_M) / -falling
        met = (directions[:, 2] < -1e-6) & (ranges < max_range)
        n = len(ranges)
        return Echoes(
            np.where(met, ranges, np.inf).astype(np.float32),
            np.where(met[:, None], [0.0, 0.0, 1.0], 0.0).astype(np.float32),
            met.astype(np.uint8),
            np.zeros(n, dtype=np.uint16),
        )


def survey_path(duration_s: float, resting: bool = True, phase: float = 0.0) -> Path:
    """A lawnmower's long figure of eight at 0.5 m/s with sway and lean, from rest or in motion from the first moment.

    phase: rad, at which the sway begins.
    """
    times = np.arange(-1.0, duration_s + 1.0, KNOT_S)
    begun = np.clip((times - REST_S) / RAMP_S, 0, 1) if resting else np.ones(len(times))
    begun = begun**3 * (10 - 15 * begun + 6 * begun**2)  # smooth to the second derivative
    way = np.cumsum(0.5 * begun) * KNOT_S
    angle = way / 6.0
    x, y = 9.0 * np.sin(angle), 5.0 * np.sin(2 * angle) / 2
    heading = np.unwrap(np.arctan2(5.0 * np.cos(2 * angle), 9.0 * np.cos(angle)))
    wave = lambda f, p: begun * np.sin(2 * np.pi * f * times + p + phase)  # noqa: E731
    position = np.column_stack([x + 0.04 * wave(0.21, 0), y + 0.05 * wave(0.17, 1), -DEPTH_M + 0.08 * wave(0.23, 2)])
    attitude = np.column_stack(
        [heading + 0.06 * wave(0.13, 0.5), 0.05 * wave(0.27, 0.7) - 0.02, 0.05 * wave(0.31, 0.2) + 0.01]
    )
    return Path(make_interp_spline(times, position, k=5), make_interp_spline(times, attitude, k=5), duration_s)


WARMING = {"warming_k": 30.0, "gyro_bias_per_k": 5e-4, "accel_bias_per_k": 7e-3}
"""A MEMS unit without compensation that has just been switched on: 0.1 K/s."""


def rig(*sensors: str, unit: Mapping[str, float] | None = None, **dvl_keys: Any) -> RigRecipe:
    """A vehicle with a MEMS unit and some of dvl, pressure, magnetometer. unit: further keys of the MEMS unit."""
    grade: dict[str, Any] = {**COMMON, **IMU_GRADES["mems"], "accel_range": None, "gyro_range": None, **(unit or {})}
    known: dict[str, SensorRecipe] = {
        "imu": ImuRecipe(rate_hz=100.0, position_m=(-0.05, 0.02, 0.03), **grade),
        "dvl": DvlRecipe(position_m=(-0.08, 0.0, -0.12), misalignment_deg=0.3, **dvl_keys),
        "pressure": PressureRecipe(position_m=(-0.2, 0.0, 0.05)),
        "magnetometer": MagnetometerRecipe(
            rate_hz=10.0,
            hard_iron_ut=(4.0, -7.0, 2.5),
            soft_iron=((1.03, 0.01, 0.0), (0.01, 0.98, 0.02), (0.0, 0.02, 1.0)),
        ),
    }
    return RigRecipe(
        name="scalar",
        summary="no camera",
        camera=(),
        sensors=tuple(sensor for block, sensor in known.items() if block in ("imu", *sensors)),
    )


class SensorDive(Sequence):
    """Samples of a rig's inertial unit, DVL, pressure sensor and magnetometer along a path."""

    name = "dive"

    def __init__(self, seed: int, vehicle: RigRecipe, path: Path) -> None:
        streams, site, waves = Streams(seed), SiteRecipe(), None
        waves = build_waves(site, BOTTOM_M, streams)
        known = read_calibrations({"cameras": {}, **rig_calibration(vehicle, site)})
        self.cameras, self.metadata, self.path = {}, {}, path
        for kind, _ in rig_sensors(vehicle):
            setattr(self, kind.attribute, known[kind.block][kind.block])
        (unit,) = vehicle.of(ImuRecipe)
        times, stamps = self._clock(unit.rate_hz)
        readings = zip(stamps, *imu.measure(path, unit, times, streams), strict=True)
        self._samples: dict[str, list[Any]] = {"imu": [ImuMeasurement(int(s), g, f) for s, g, f in readings]}
        for dvl_recipe in vehicle.of(DvlRecipe):
            times, stamps = self._clock(dvl_recipe.rate_hz)
            caster: Any = LevelBottom()
            self._samples["dvl"] = dvl.measure(path, caster, dvl_recipe, site, times, stamps, streams)[0]
        for pressure_recipe in vehicle.of(PressureRecipe):
            times, stamps = self._clock(pressure_recipe.rate_hz)
            values = pressure.measure(path, pressure_recipe, site, waves, times, streams)
            variance = pressure.noise_variance(pressure_recipe, site)
            self._samples["pressure"] = [
                PressureMeasurement(int(s), float(v), variance) for s, v in zip(stamps, values, strict=True)
            ]
        for magnetometer_recipe in vehicle.of(MagnetometerRecipe):
            times, stamps = self._clock(magnetometer_recipe.rate_hz)
            fields = magnetometer.measure(path, magnetometer_recipe, site, times, streams)
            variance = magnetometer.noise_variance(magnetometer_recipe)
            self._samples["magnetometer"] = [
                MagneticMeasurement(int(s), f, variance) for s, f in zip(stamps, fields, strict=True)
            ]

    def _clock(self, rate_hz: float) -> tuple[Array, np.ndarray]:
        times = np.arange(0, self.path.duration_s, 1 / rate_hz)
        return times, START_NS + np.round(times * 1e9).astype(np.int64)

    def _read(self, kind: str, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        low, high = start_ns or 0, end_ns or 2**62
        return (sample for sample in self._samples[kind] if low <= sample.stamp_ns < high)

    def change(self, kind: str, how: Any) -> None:
        """Put how(sample) in the place of every sample of a kind."""
        self._samples[kind] = [how(sample) for sample in self._samples[kind]]

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        return iter(())

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        return self._read("imu", start_ns, end_ns)

    def dvl(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[DvlMeasurement]:
        return self._read("dvl", start_ns, end_ns)

    def pressure(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[PressureMeasurement]:
        return self._read("pressure", start_ns, end_ns)

    def magnetometer(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[MagneticMeasurement]:
        return self._read("magnetometer", start_ns, end_ns)

    @property
    def duration_s(self) -> float:
        return self.path.duration_s

    def contents(self) -> list[tuple[str, str, int]]:
        return []

    def truth(self) -> Trajectory:
        return self.path.trajectory(*self._clock(100.0))

    def truth_from_start(self) -> Trajectory:
        """The truth in odom: from where the vehicle starts and the way it points, z up."""
        truth = self.truth()
        first = truth.matrices[0]
        angle = np.arctan2(first[1, 0], first[0, 0])
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        half = np.array([0, 0, -np.sin(angle / 2), np.cos(angle / 2)])
        quaternions = truth.quaternions @ left_product(half).T
        return Trajectory(truth.stamps_ns, (truth.positions - truth.positions[0]) @ turn.T, quaternions)
