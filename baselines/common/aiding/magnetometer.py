"""Magnetometer: it measures A R_mag_imu R^T f + h, with the Earth's field f in odom, hard iron h and soft iron A.

With f free, one attitude says nothing; yaw is constrained by how the field turns relative to the vehicle. Motors add a
field that comes and goes with their current: its mean is hard iron, the rest is noise, correlated over seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import MagneticMeasurement
from oysterbench.sequence.types import Uncertainty
from oysterbench_baselines.common.aiding.sensor import (
    ROTATION,
    AidingSensor,
    Calibration,
    GateSettings,
    python_factor,
    stated_sigmas,
    symbol,
)
from oysterbench_baselines.common.filter import ATTITUDE, CORE, InvariantFilter, cross

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

HARD_IRON = tuple(f"hard_iron_{axis}_t" for axis in "xyz")
SOFT_IRON = tuple(f"soft_iron_{row}{column}" for row in "xyz" for column in "xyz")
"""Parameters of the iron, of which a calibration states sigmas."""
COMPASS_KEY = symbol("m")
"""The Earth's field in odom (3), hard iron (3), both in FIELD_UNIT, and soft iron (9, row by row): (15,)."""
FIELD_UNIT = 1e-5
"""T: makes a field a number near one, as the solver prefers its variables."""


@dataclass(frozen=True)
class MagnetometerSettings:
    """Settings of iron and fields that the samples do not give, and which samples count for keyframes."""

    field_sigma: float = 15e-6  # T, per axis, of the first reading as the Earth's field: what hard iron hides
    hard_iron_sigma: float = 10e-6  # T, per axis, of a vehicle that was not swung
    soft_iron_sigma: float = 0.03  # of each element, about the identity, likewise
    mean_motor_sigma: float = 1e-6  # T, per axis: of the mean field of motors, since it was swung
    sigma: float = 0.3e-6  # T: other errors besides the sensor's own noise
    motor_sigma: float = 0.15e-6  # T, per axis, of the changing field of motors, before it has been estimated
    motor_memory_s: float = 20.0  # over which it is estimated
    motor_tau_s: float = 3.0  # readings closer than this err alike: as long as a correction, or a wave
    interval_s: float = 0.1  # readings in between say nothing new: iron, not noise, limits the compass
    max_delay_s: float = 0.06  # a reading older than this does not count for a keyframe
    keyframes: int = 1  # from one reading that counts to the next; 3 saves an eighth of the time, but costs heading
    huber: float = 3.0  # sigmas; beyond, a residual in the graph counts linearly


class Magnetometer(AidingSensor):
    """Magnetometer as an aiding sensor. R_imu_compass (3, 3): its mount. earth: the Earth's field (3,) in odom,
    FIELD_UNIT, where a graph starts."""

    kind = "magnetometer"
    measures = (MagneticMeasurement,)
    suspect = ATTITUDE
    unit = np.r_[[FIELD_UNIT] * 6, np.ones(9)]

    def __init__(
        self,
        R_imu_compass: Array,
        iron: tuple[Array, Array] | None,
        settings: MagnetometerSettings,
        gate: GateSettings,
        uncertainty: Uncertainty | None = None,
    ) -> None:
        """iron: see `known_iron`. uncertainty: of the whole rig, as its calibration states it."""
        super().__init__(gate)
        self.R_compass_imu, self.settings = R_imu_compass.T, settings
        self._hard, self._soft, self._sigmas = known_iron(iron, settings, uncertainty)
        self._motors = np.full(3, settings.motor_sigma**2)  # T^2, variances of their field, by axis
        self._last_ns: int | None = None
        self._believed: MagneticMeasurement | None = None
        self._fields: dict[int, tuple[Array, Array]] = {}  # at a keyframe, and 1 sigma by axis, FIELD_UNIT
        self._first_field: Array | None = None
        self.earth: Array | None = None

    def update(self, filter: InvariantFilter, sample: MagneticMeasurement) -> bool:
        elapsed = self.settings.interval_s if self._last_ns is None else (sample.stamp_ns - self._last_ns) * 1e-9
        if elapsed < self.settings.interval_s:
            believed = self._refused_in_a_row == 0
        else:
            self._last_ns = sample.stamp_ns
            believed = self._update(filter, sample, elapsed)
        if believed:
            self._believed = sample
        return believed

    def _update(self, filter: InvariantFilter, sample: MagneticMeasurement, elapsed: float) -> bool:
        """Correct the filter, and estimate how much motors bend the field by how far readings are off beyond what the
        filter expects (Mehra 1970, IEEE TAC 15(2), on estimating noise from innovations)."""
        to_sensor = self.R_compass_imu @ filter.rotation.T
        if self.rows is None:
            mean = np.concatenate([to_sensor.T @ self._outside(sample.field), self._hard, self._soft.ravel()])
            self.rows = filter.append(mean, self._sigmas)
        at = self.rows
        field, hard, soft = np.split(filter.extra[at.start - CORE : at.stop - CORE], [3, 6])
        soft = soft.reshape(3, 3)
        local = to_sensor @ field
        slope = np.zeros((3, len(filter.covariance)))
        slope[:, ATTITUDE] = soft @ to_sensor @ cross(field)
        slope[:, at.start : at.start + 3] = soft @ to_sensor
        slope[:, at.start + 3 : at.start + 6] = np.eye(3)
        slope[:, at.start + 6 : at.stop] = np.kron(np.eye(3), local)
        residual = sample.field - soft @ local - hard
        expected = np.einsum("ki,ij,kj->k", slope, filter.covariance, slope) + self._own(sample)
        believed = self.correct(filter, residual, slope, np.diag(self.variances(sample, elapsed)))
        if believed:
            share = min(elapsed / self.settings.motor_memory_s, 1.0)
            self._motors += share * (np.maximum(residual**2 - expected, 0.0) - self._motors)
        return believed

    def _outside(self, field: Array) -> Array:
        """Field (3,) T as it would be without the vehicle's iron, in the sensor's frame."""
        return np.asarray(np.linalg.solve(self._soft, field - self._hard))

    def _own(self, sample: MagneticMeasurement) -> float:
        return float(sample.variance) + self.settings.sigma**2

    def variances(self, sample: MagneticMeasurement, interval_s: float) -> Array:
        """Variances (3,) T^2 of readings `interval_s` apart: motors bend successive ones alike, which, treated as white
        noise, must count for less."""
        alike = max(1.0, self.settings.motor_tau_s / max(interval_s, 1e-3))
        return self._own(sample) + self._motors * alike

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """Keep the field, if it was read a moment ago; less certain as the vehicle turns."""
        sample, settings = self._believed, self.settings
        if sample is None or (stamp_ns - sample.stamp_ns) * 1e-9 > settings.max_delay_s:
            return
        if self._fields and keyframe < next(reversed(self._fields)) + settings.keyframes:
            return
        turned = np.linalg.norm(filter.rate) * (stamp_ns - sample.stamp_ns) * 1e-9
        variances = self.variances(sample, interval_s) + (turned * np.linalg.norm(sample.field)) ** 2
        field = sample.field / FIELD_UNIT
        self._fields[keyframe] = field, np.sqrt(variances) / FIELD_UNIT
        if self._first_field is None:
            self._first_field = field

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        """Set the Earth's field as seen from there: it is free, and this is only where the solver starts."""
        if self._first_field is None or (filter is None and self.earth is not None):
            return
        field, _ = self._fields.get(keyframe, (self._first_field, None))
        to_sensor = self.R_compass_imu @ state.nav.attitude().matrix().T
        self.earth = to_sensor.T @ self._outside(field * FIELD_UNIT) / FIELD_UNIT

    def calibration(self) -> Calibration | None:
        if self.earth is None:
            return None
        mean = np.concatenate([self.earth, self._hard / FIELD_UNIT, self._soft.ravel()])
        return Calibration(COMPASS_KEY, mean, self._sigmas / self.unit)

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        if keyframe not in self._fields or self.earth is None:
            return []
        field, sigmas = self._fields[keyframe]
        keys, error = [symbol("x", keyframe), COMPASS_KEY], partial(field_error, field, self.R_compass_imu)
        return [python_factor(keys, sigmas, 3, error, huber=self.settings.huber)]


def known_iron(
    iron: tuple[Array, Array] | None, settings: MagnetometerSettings, uncertainty: Uncertainty | None
) -> tuple[Array, Array, Array]:
    """Hard (3,) T and soft iron (3, 3) as a calibration has them, and 1 sigmas (15,) of the Earth's field and of both.

    iron: as found by the swing; None where there was none. A mount error of a small rotation e turns A into
    A (1 - [e]x): soft iron off the diagonal.
    """
    field = np.full(3, settings.field_sigma)
    if iron is None:
        sigmas = np.r_[np.full(3, settings.hard_iron_sigma), np.full(9, settings.soft_iron_sigma)]
        return np.zeros(3), np.eye(3), np.r_[field, sigmas]
    hard = np.hypot(stated_sigmas(uncertainty, "magnetometer", HARD_IRON), settings.mean_motor_sigma)
    turn = np.abs(cross(stated_sigmas(uncertainty, "magnetometer", ROTATION)))
    soft = np.hypot(stated_sigmas(uncertainty, "magnetometer", SOFT_IRON), turn.ravel())
    return iron[0], iron[1], np.r_[field, hard, soft]


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
