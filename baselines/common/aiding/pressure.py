"""Pressure sensor: z of its position in odom plus a constant, the depth of odom with the sensor's own offset."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import PressureMeasurement
from oysterbench.sequence.types import PressureCalibration
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings, python_factor, symbol
from oysterbench_baselines.common.filter import ATTITUDE, CORE, POSITION, VELOCITY, InvariantFilter, cross

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

DEPTH_KEY = symbol("z")


@dataclass(frozen=True)
class PressureSettings:
    """Settings of depth that the samples do not give; waves press alike on successive readings."""

    height_sigma: float = 10.0  # m, of the sensor's height over odom: nothing is known of it
    sigma: float = 0.005  # m: pressure of water currents on the sensor besides its own noise
    wave_sigma: float = 0.03  # m, of the pressure of waves, before it has been estimated
    wave_memory_s: float = 10.0  # over which it is estimated: two or three waves
    wave_climb: float = 0.02  # m/s, 1 sigma of the vertical velocity, above which waves cannot be told from motion
    wave_tau_s: float = 1.0  # readings closer than this err alike: a quarter of a wave
    walk: float = 5e-4  # m/sqrt(s): the tide, taken as a walk: 6 cm in four hours, 1 cm in seven minutes
    max_delay_s: float = 0.5  # a reading older than this does not count for a keyframe
    climb_sigma: float = 0.02  # m/s, 1 sigma of the speed at which a reading is moved to a keyframe


class Pressure(AidingSensor):
    """Pressure sensor as an aiding sensor. T_imu_pressure (4, 4): its mount. offset: its height over z of odom where a
    graph starts, m."""

    kind = "pressure"
    measures = (PressureMeasurement,)
    suspect = POSITION

    def __init__(
        self,
        T_imu_pressure: Array,
        gravity: float,
        calibration: PressureCalibration,
        settings: PressureSettings,
        gate: GateSettings,
    ) -> None:
        super().__init__(gate)
        self.lever, self.settings = T_imu_pressure[:3, 3], settings
        self._weight = calibration.density * gravity  # of the water, Pa/m
        self._atmosphere = calibration.atmosphere
        self._waves = settings.wave_sigma**2  # m^2, variance of the height due to waves
        self._off = 0.0  # m, mean deviation of readings from the prediction
        self._last_ns: int | None = None
        self._believed: PressureMeasurement | None = None
        self._heights: dict[int, tuple[float, float]] = {}  # at a keyframe, and 1 sigma, m
        self.offset: float | None = None

    def update(self, filter: InvariantFilter, sample: PressureMeasurement) -> bool:
        """Correct the filter, and estimate the pressure of waves by the scatter of readings about the known motion."""
        settings, height = self.settings, self.height(sample)
        place = filter.position + filter.rotation @ self.lever
        if self.rows is None:
            self.rows = filter.append(np.array([height - place[2]]), np.array([settings.height_sigma]))
        at = self.rows.start
        elapsed = (sample.stamp_ns - (sample.stamp_ns - 10**8 if self._last_ns is None else self._last_ns)) * 1e-9
        self._last_ns = sample.stamp_ns
        filter.covariance[at, at] += elapsed * settings.walk**2
        slope = np.zeros((1, len(filter.covariance)))
        slope[0, POSITION] = [0.0, 0.0, 1.0]
        slope[0, ATTITUDE] = -cross(place)[2]
        slope[0, at] = 1.0
        residual = np.array([height - place[2] - filter.extra[at - CORE]])
        climb = float(np.sqrt(filter.covariance[VELOCITY, VELOCITY][2, 2]))
        believed = self.correct(filter, residual, slope, np.array([[self.variance(sample, elapsed)]]))
        if believed and climb < settings.wave_climb:
            share = min(elapsed / settings.wave_memory_s, 1.0)
            scatter = (residual.item() - self._off) ** 2 - settings.sigma**2
            self._off += share * (residual.item() - self._off)
            self._waves += share * (max(scatter, 0.0) - self._waves)
        if believed:
            self._believed = sample
        return believed

    def height(self, sample: PressureMeasurement) -> float:
        """z (m) of the sensor over the water's surface, by its reading."""
        return (self._atmosphere - sample.pressure) / self._weight

    def variance(self, sample: PressureMeasurement, interval_s: float) -> float:
        """Variance (m^2) of the height, apart from constant errors, for readings `interval_s` apart.

        Waves press alike on successive readings: treated as white noise, these must count for less.
        """
        alike = max(1.0, self.settings.wave_tau_s / max(interval_s, 1e-3))
        return sample.variance / self._weight**2 + self.settings.sigma**2 + self._waves * alike

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """Keep the last reading, moved to the keyframe at the filter's vertical speed."""
        if self._believed is None:
            return
        delay = (stamp_ns - self._believed.stamp_ns) * 1e-9
        height = self.height(self._believed) + delay * filter.velocity[2]
        variance = self.variance(self._believed, interval_s)
        if delay <= self.settings.max_delay_s:
            moved = float(np.sqrt(variance + (self.settings.climb_sigma * delay) ** 2))
            self._heights[keyframe] = float(height), moved

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        if filter is not None:
            self.offset = None if self.rows is None else float(filter.extra[self.rows.start - CORE])
        elif self.offset is None and self._heights:
            self.offset = next(iter(self._heights.values()))[0]  # odom is about where it starts

    def calibration(self) -> Calibration | None:
        """The offset as a variable: otherwise, waves during the first reading would lift the whole path."""
        if self.offset is None:
            return None
        return Calibration(DEPTH_KEY, np.array([self.offset]), np.array([self.settings.height_sigma]))

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        if keyframe not in self._heights or self.offset is None:
            return []
        height, sigma = self._heights[keyframe]
        return [depth_factor(keyframe, height, self.lever, sigma)]


def depth_error(height: float, lever: Array, pose: gtsam.Pose3, offset: Array) -> tuple[Array, list[Array]]:
    """(p + R r)_z + offset - height (1,), m, and derivatives by pose (1, 6) and offset (1, 1); x and y have no part."""
    down_row = pose.rotation().matrix()[2]
    error = pose.z() + down_row @ lever + offset - height
    return error, [np.concatenate([np.cross(lever, down_row), down_row])[None], np.ones((1, 1))]


def depth_factor(keyframe: int, height: float, lever: Array, sigma: float) -> gtsam.NonlinearFactor:
    """Factor of the height (m) of a point at `lever` (3,) from the IMU, over odom's zero level up to an offset."""
    return python_factor([symbol("x", keyframe), DEPTH_KEY], sigma, 1, partial(depth_error, height, lever))
