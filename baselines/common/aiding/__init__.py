"""Aiding sensors of a rig: each kind by itself, and all of them together as an estimator uses them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.common.aiding.dvl import Dvl, DvlSettings
from oysterbench_baselines.common.aiding.magnetometer import Magnetometer, MagnetometerSettings
from oysterbench_baselines.common.aiding.pressure import Pressure, PressureSettings
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings
from oysterbench_baselines.common.aiding.sonar import Ground, Sonar, SonarSettings
from oysterbench_baselines.common.filter import InvariantFilter
from oysterbench_baselines.common.inertial import Segment

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import Keyframe, State

KINDS = ("dvl", "pressure", "magnetometer")
FRESH_NS = 1_000_000_000  # a velocity older than this no longer says how an ROV moves


@dataclass(frozen=True)
class AidingSettings:
    """Settings of the aiding sensors that no calibration gives. Sigmas of constants are priors: they are estimated."""

    dvl: DvlSettings = field(default_factory=DvlSettings)
    pressure: PressureSettings = field(default_factory=PressureSettings)
    magnetometer: MagnetometerSettings = field(default_factory=MagnetometerSettings)
    gate: GateSettings = field(default_factory=GateSettings)


@dataclass(frozen=True)
class SonarAidingSettings(AidingSettings):
    """`AidingSettings` with those of an imaging sonar."""

    sonar: SonarSettings = field(default_factory=SonarSettings)


def sensors_of(sequence: Sequence) -> list[str]:
    """The aiding sensors that a rig has, as `Sequence.stream` names them."""
    return [kind for kind in KINDS if getattr(sequence, f"{kind}_calibration") is not None]


def aiding_sensors(sequence: Sequence, settings: AidingSettings, kinds: Collection[str] = KINDS) -> list[AidingSensor]:
    """Create the aiding sensors of the given kinds that a rig has."""
    T_imu_base, gravity = invert(sequence.imu_calibration.T_base_imu), sequence.imu_calibration.gravity
    dvl, pressure, compass = (getattr(sequence, f"{kind}_calibration") if kind in kinds else None for kind in KINDS)
    sensors = list[AidingSensor]()
    if dvl is not None:
        mount = T_imu_base @ dvl.T_base_sensor
        sensors.append(Dvl(mount, gravity, settings.dvl, settings.gate, sequence.uncertainty))
    if pressure is not None:
        mount = T_imu_base @ pressure.T_base_sensor
        sensors.append(Pressure(mount, gravity, pressure, settings.pressure, settings.gate))
    if compass is not None:
        mount = T_imu_base @ compass.T_base_sensor
        swung = compass.hard_iron_t is not None and compass.soft_iron is not None
        iron = (compass.hard_iron_t, compass.soft_iron) if swung else None
        sensors.append(Magnetometer(mount[:3, :3], iron, settings.magnetometer, settings.gate, sequence.uncertainty))
    return sensors


def imaging_sonar(
    sequence: Sequence, settings: SonarAidingSettings, reach: int, dvl: Dvl | None = None
) -> Sonar | None:
    """Create the first imaging sonar of a rig, with all that sounds the bottom below it; None where there is none.

    reach: keyframes back to which its factors may go. dvl: the log that takes precedence, where one is used.
    """
    T_imu_base, chosen, stated = invert(sequence.imu_calibration.T_base_imu), settings.sonar, sequence.uncertainty
    altimeters = {name: (T_imu_base @ of.T_base_sensor, of) for name, of in sequence.altimeters.items()}
    ground = Ground(altimeters, None if dvl is None else dvl.T_imu_dvl, chosen.ground)
    for name, calibration in sequence.sonars.items():
        mount = T_imu_base @ calibration.T_base_sensor
        return Sonar(name, mount, calibration, ground, reach, chosen, settings.gate, stated, dvl)
    return None


class Aiding:
    """All aiding sensors of an estimator; none at all for a rig of cameras and an IMU."""

    def __init__(self, sensors: Iterable[AidingSensor] = ()) -> None:
        self.sensors = {sensor.kind: sensor for sensor in sensors}

    @property
    def refused(self) -> dict[str, int]:
        """Number of samples refused, in part or as a whole, by kind."""
        kinds = dict.fromkeys([*KINDS, *(kind for kind in self.sensors if kind == Sonar.kind)])
        return {kind: self.sensors[kind].refused if kind in self.sensors else 0 for kind in kinds}

    def found(self, filter: InvariantFilter) -> dict[str, float]:
        """Estimates of the sensors' constants by now, for the record."""
        return {name: value for sensor in self.sensors.values() for name, value in sensor.found(filter).items()}

    def counts(self) -> dict[str, int]:
        """See `AidingSensor`."""
        return {name: count for sensor in self.sensors.values() for name, count in sensor.counts().items()}

    @property
    def knows_velocity(self) -> bool:
        """Whether the filter has ever been given a velocity: without one it dead-reckons by the IMU alone."""
        dvl = self.sensors.get("dvl")
        return (dvl is not None and dvl.rows is not None) or bool(self._velocities())

    def measures_velocity(self, stamp_ns: int) -> bool:
        """Whether a velocity has been believed within the last second."""
        return any(stamp_ns - velocity_ns < FRESH_NS for velocity_ns in self._velocities())

    def _velocities(self) -> list[int]:
        """Stamps, ns, of the last velocity believed of each sensor that has given any."""
        stamps = (sensor.velocity_ns for sensor in self.sensors.values() if isinstance(sensor, Dvl | Sonar))
        return [stamp for stamp in stamps if stamp is not None]

    def update(self, filter: InvariantFilter, sample: Any) -> None:
        """Correct a filter that has been propagated to the sample's stamp."""
        for sensor in self.sensors.values():
            if isinstance(sample, sensor.measures):
                sensor.update(filter, sample)

    def propagate(self, segment: Segment) -> None:
        """See `AidingSensor`, likewise below."""
        for sensor in self.sensors.values():
            sensor.propagate(segment)

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        for sensor in self.sensors.values():
            sensor.add_keyframe(keyframe, stamp_ns, filter, interval_s)

    def forget_intervals(self) -> None:
        for sensor in self.sensors.values():
            sensor.forget_intervals()

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        for sensor in self.sensors.values():
            sensor.initialise(keyframe, state, filter)

    def calibrations(self) -> list[Calibration]:
        """Calibrations of the sensors that take part in the graph, sorted by kind."""
        found = (self.sensors[kind].calibration() for kind in sorted(self.sensors))
        return [calibration for calibration in found if calibration is not None]

    def shared_states(self) -> dict[int, tuple[slice, Array]]:
        """Variables that filter and graph share besides the vehicle's state, by key: rows of the filter's error, units
        (N,)."""
        shared = {}
        for sensor in self.sensors.values():
            calibration = sensor.calibration()
            if calibration is not None and sensor.rows is not None:
                shared[calibration.key] = sensor.rows, sensor.unit
        return shared

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        return [factor for sensor in self.sensors.values() for factor in sensor.factors(keyframe, before)]

    def stretch_factors(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        sensors = self.sensors.values()
        return [f for sensor in sensors for f in sensor.stretch_factors(keyframes, states, ids, points)]
