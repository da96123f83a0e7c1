"""Magnetometer: A R_mag_imu R^T f + h, the Earth's field f in odom, hard iron h and soft iron A, all of them unknown.

With f free, one attitude says nothing; yaw is held by how the field turns against the vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import MagneticMeasurement
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings, python_factor, symbol
from oysterbench_baselines.common.filter import ATTITUDE, CORE, InvariantFilter, cross

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

COMPASS_KEY = symbol("m")
"""The Earth's field in odom (3), hard iron (3), both in FIELD_UNIT, and soft iron (9, row by row): (15,)."""
FIELD_UNIT = 1e-5
"""T: makes a field a number near one, as the solver likes its variables."""


@dataclass(frozen=True)
class MagnetometerSettings:
    """What the samples do not say of iron and fields, and which of them count for key frames."""

    field_sigma: float = 15e-6  # T, per axis, of the first field reading as the Earth's: what hard iron hides
    hard_iron_sigma: float = 10e-6  # T, per axis
    soft_iron_sigma: float = 0.03  # of each element, about the identity
    sigma: float = 0.3e-6  # T: motors and currents, beside the sensor's own noise
    interval_s: float = 0.1  # readings in between say nothing new: iron, not noise, limits the compass
    max_delay_s: float = 0.06  # a reading older than this does not count for a key frame
    keyframes: int = 1  # from one reading that counts to the next; 3 saves an eighth of the time, and heading
    huber: float = 3.0  # sigmas; beyond, a residual in the graph counts linearly


class Magnetometer(AidingSensor):
    """R_imu_compass (3, 3): its mount. earth: the Earth's field (3,) in odom, FIELD_UNIT, where a graph begins."""

    kind = "magnetometer"
    measures = (MagneticMeasurement,)
    suspect = ATTITUDE
    unit = np.r_[[FIELD_UNIT] * 6, np.ones(9)]

    def __init__(self, R_imu_compass: Array, settings: MagnetometerSettings, gate: GateSettings) -> None:
        super().__init__(gate)
        self.R_compass_imu, self.settings = R_imu_compass.T, settings
        self._last_ns: int | None = None
        self._believed: MagneticMeasurement | None = None
        self._fields: dict[int, tuple[Array, float]] = {}  # at a key frame, and 1 sigma, FIELD_UNIT
        self._first_field: Array | None = None
        self.earth: Array | None = None

    def update(self, filter: InvariantFilter, sample: MagneticMeasurement) -> bool:
        settings = self.settings
        if self._last_ns is not None and sample.stamp_ns - self._last_ns < settings.interval_s * 1e9:
            believed = self._refused_in_a_row == 0
        else:
            self._last_ns = sample.stamp_ns
            believed = self._update(filter, sample)
        if believed:
            self._believed = sample
        return believed

    def _update(self, filter: InvariantFilter, sample: MagneticMeasurement) -> bool:
        settings = self.settings
        to_sensor = self.R_compass_imu @ filter.rotation.T
        if self.rows is None:
            mean = np.concatenate([to_sensor.T @ sample.field, np.zeros(3), np.eye(3).ravel()])
            sigmas = [settings.field_sigma] * 3 + [settings.hard_iron_sigma] * 3 + [settings.soft_iron_sigma] * 9
            self.rows = filter.append(mean, np.array(sigmas))
        at = self.rows
        field, hard, soft = np.split(filter.extra[at.start - CORE : at.stop - CORE], [3, 6])
        soft = soft.reshape(3, 3)
        local = to_sensor @ field
        slope = np.zeros((3, len(filter.covariance)))
        slope[:, ATTITUDE] = soft @ to_sensor @ cross(field)
        slope[:, at.start : at.start + 3] = soft @ to_sensor
        slope[:, at.start + 3 : at.start + 6] = np.eye(3)
        slope[:, at.start + 6 : at.stop] = np.kron(np.eye(3), local)
        variance = np.full(3, sample.variance + settings.sigma**2)
        return self.correct(filter, sample.field - soft @ local - hard, slope, variance)

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """The field, if it was read a moment ago; less certain as the vehicle turns."""
        sample, settings = self._believed, self.settings
        if sample is None or (stamp_ns - sample.stamp_ns) * 1e-9 > settings.max_delay_s:
            return
        if self._fields and keyframe < next(reversed(self._fields)) + settings.keyframes:
            return
        field = sample.field / FIELD_UNIT
        turned = np.linalg.norm(filter.rate) * (stamp_ns - sample.stamp_ns) * 1e-9
        own = (sample.variance + settings.sigma**2) / FIELD_UNIT**2
        self._fields[keyframe] = field, float(np.sqrt(own + (turned * np.linalg.norm(field)) ** 2))
        if self._first_field is None:
            self._first_field = field

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        """The Earth's field as it was seen from there: it is free, and this is only where the solver begins."""
        if self._first_field is None or (filter is None and self.earth is not None):
            return
        field, _ = self._fields.get(keyframe, (self._first_field, 0.0))
        self.earth = (self.R_compass_imu @ state.nav.attitude().matrix().T).T @ field

    def calibration(self) -> Calibration | None:
        if self.earth is None:
            return None
        settings = self.settings
        iron = [settings.field_sigma / FIELD_UNIT] * 3 + [settings.hard_iron_sigma / FIELD_UNIT] * 3
        mean = np.concatenate([self.earth, np.zeros(3), np.eye(3).ravel()])
        return Calibration(COMPASS_KEY, mean, np.array(iron + [settings.soft_iron_sigma] * 9))

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        if keyframe not in self._fields or self.earth is None:
            return []
        field, sigma = self._fields[keyframe]
        keys, error = [symbol("x", keyframe), COMPASS_KEY], partial(field_error, field, self.R_compass_imu)
        return [python_factor(keys, sigma, 3, error, huber=self.settings.huber)]


def field_error(field: Array, R_compass_imu: Array, pose: gtsam.Pose3, iron: Array) -> tuple[Array, list[Array]]:
    """A R_compass_imu R^T f + h - measured, in FIELD_UNIT (3,), and derivatives by pose (3, 6) and iron (3, 15)."""
    earth, hard, soft = iron[:3], iron[3:6], iron[6:].reshape(3, 3)
    to_body = pose.rotation().matrix().T
    local = R_compass_imu @ to_body @ earth
    by_pose = np.hstack([soft @ R_compass_imu @ cross(to_body @ earth), np.zeros((3, 3))])
    by_iron = np.zeros((3, 15))
    by_iron[:, :3], by_iron[:, 3:6] = soft @ R_compass_imu @ to_body, np.eye(3)
    for row in range(3):  # np.kron took half of the factor's time
        by_iron[row, 6 + 3 * row : 9 + 3 * row] = local
    return soft @ local + hard - field, [by_pose, by_iron]
