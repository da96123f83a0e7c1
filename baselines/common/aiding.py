"""What a DVL, a pressure sensor and a magnetometer say to the navigation filter, each if the rig has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import DvlMeasurement, MagneticMeasurement, PressureMeasurement
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.common.filter import (
    ATTITUDE,
    CORE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    InvariantFilter,
    cross,
    left_jacobian,
    rotation_exp,
)


@dataclass(frozen=True)
class AidingSettings:
    """What calibrations do not say of the aiding sensors. sigmas are priors of constants that the filter estimates."""

    dvl_scale_sigma: float = 0.003  # of 1: a DVL of the A50 class is sold as good to 1 %, the better model to 0.1 %
    dvl_misalignment_sigma_deg: float = 0.5  # per axis: what a mount is made and measured to
    dvl_noise_floor: float = 0.001  # m/s, 1 sigma of a beam, whatever the sample says
    height_sigma: float = 10.0  # m, of what a pressure sensor's height is over odom: nothing is known of it
    depth_sigma: float = 0.005  # m: what water currents press on the sensor beside its own noise
    wave_sigma: float = 0.03  # m, of what waves press, before it has been seen
    wave_memory_s: float = 10.0  # over which it is seen: two or three waves
    wave_climb: float = 0.02  # m/s, 1 sigma of the vertical velocity, above which waves cannot be told from motion
    wave_tau_s: float = 1.0  # readings closer than this err alike: a quarter of a wave
    depth_walk: float = 5e-4  # m/sqrt(s): the tide, taken as a walk: 6 cm in four hours, 1 cm in seven minutes
    field_sigma: float = 15e-6  # T, per axis, of the first field reading as the Earth's: what hard iron hides
    hard_iron_sigma: float = 10e-6  # T, per axis
    soft_iron_sigma: float = 0.03  # of each element, about the identity
    magnetic_sigma: float = 0.3e-6  # T: motors and currents, beside the sensor's own noise
    magnetic_interval_s: float = 0.1  # readings in between say nothing new: iron, not noise, limits the compass
    gate: float = 1e-5  # chance with which a good measurement is refused
    patience: int = 5  # samples refused in a row, after which it is the filter that is taken to be wrong


WRONG = {"dvl": VELOCITY, "pressure": POSITION, "magnetometer": ATTITUDE}
"""What of the filter is taken to be wrong when a sensor contradicts it for long."""


def sensors_of(sequence: Sequence) -> list[str]:
    """The aiding sensors that a rig has, as `Sequence.stream` names them."""
    kinds = ("dvl", "pressure", "magnetometer")
    return [kind for kind in kinds if getattr(sequence, f"{kind}_calibration") is not None]


def dvl_rows(sample: DvlMeasurement, floor: float) -> tuple[Array, Array, Array] | None:
    """Directions (K, 3) in the DVL's frame, velocities (K,) m/s along them, and their variances (K,).

    The beams that are valid, each for itself: fewer than three, which give no velocity, still say something. The noise
    of a beam follows from the covariance of the velocity, sigma^2 (B^T B)^-1, or is the floor. None where there
    is neither.
    """
    valid = np.asarray(sample.beam_valid, dtype=bool) & np.isfinite(sample.beam_velocities)
    if valid.any():
        beams = sample.beam_directions[valid]
        variance = 0.0
        if valid.sum() >= 3 and np.isfinite(sample.covariance).all():
            variance = float(np.trace(sample.covariance) / np.trace(np.linalg.inv(beams.T @ beams)))
        return beams, sample.beam_velocities[valid], np.full(len(beams), max(variance, floor**2))
    if np.isfinite(sample.velocity).all() and np.isfinite(sample.covariance).all():
        # Turned to its principal axes, so that each row is independent.
        variances, axes = np.linalg.eigh(sample.covariance)
        return axes.T, axes.T @ sample.velocity, np.maximum(variances, floor**2)
    return None


class Aiding:
    """Feeds a filter; adds its states of a sensor at that sensor's first sample."""

    def __init__(self, sequence: Sequence, settings: AidingSettings | None = None) -> None:
        self.settings = settings or AidingSettings()
        self.imu = sequence.imu_calibration
        self.refused = {"dvl": 0, "pressure": 0, "magnetometer": 0}
        T_imu_base = invert(self.imu.T_base_imu)
        mounts = (sequence.dvl_calibration, sequence.pressure_calibration, sequence.magnetometer_calibration)
        # Of a sensor that the rig lacks there is no sample either, and its place is not asked for.
        self.T_imu_dvl, self.T_imu_pressure, self.T_imu_compass = (
            np.full((4, 4), np.nan) if mount is None else T_imu_base @ mount.T_base_sensor for mount in mounts
        )
        depth = sequence.pressure_calibration
        self.weight = 1.0 if depth is None else depth.density * self.imu.gravity  # of the water, Pa/m
        self.atmosphere = 0.0 if depth is None else depth.atmosphere
        self._rows: dict[str, slice] = {}
        self._stamps: dict[str, int] = {}
        self._in_a_row = dict.fromkeys(self.refused, 0)
        self._beam_variance = 0.0
        self._waves = self.settings.wave_sigma**2  # m^2, variance of the height that waves press
        self._off = 0.0  # m, by how much readings are off the prediction in the mean

    def add(self, filter: InvariantFilter, sample: DvlMeasurement | PressureMeasurement | MagneticMeasurement) -> bool:
        """Correct a filter that has been propagated to the sample's stamp; whether any of it was believed."""
        if isinstance(sample, DvlMeasurement):
            return self._add_velocity(filter, sample)
        if isinstance(sample, PressureMeasurement):
            return self._add_depth(filter, sample)
        return self._add_field(filter, sample)

    def rows(self, kind: str) -> slice | None:
        """The rows of a sensor's states in the filter's error; None before its first sample."""
        return self._rows.get(kind)

    def height_offset(self, filter: InvariantFilter) -> float | None:
        """What a pressure sensor's height (m) is over z of odom; None without one."""
        at = self._rows.get("pressure")
        return None if at is None else float(filter.extra[at.start - CORE])

    def height(self, sample: PressureMeasurement) -> float:
        """z (m) of the pressure sensor over the water's surface, by its reading."""
        return (self.atmosphere - sample.pressure) / self.weight

    def height_variance(self, sample: PressureMeasurement, interval_s: float) -> float:
        """Variance (m^2) of that, less what is constant, for readings that are so far apart.

        Waves press alike on readings that follow each other: as white noise they must count for less.
        """
        alike = max(1.0, self.settings.wave_tau_s / max(interval_s, 1e-3))
        return sample.variance / self.weight**2 + self.settings.depth_sigma**2 + self._waves * alike

    def _add_velocity(self, filter: InvariantFilter, sample: DvlMeasurement) -> bool:
        """Along beam b: b . (1 + s) Exp(-m) R_dvl_imu (R^T v + w x r), scale s and misalignment m of the DVL's axes.

        Linear in v, but not in v and the calibration together: the slopes by the calibration are taken at the velocity
        that the sample leads to. At the one before it, which at a start in motion is nothing, or after a long silence
        wrong, the sample would say nothing of the misalignment, the next one would, and from the two of them the filter
        would believe to know it.
        """
        beams = dvl_rows(sample, self.settings.dvl_noise_floor)
        if beams is None:
            return False
        directions, along, variances = beams
        if len(directions) >= 3:
            self._beam_variance = float(variances.max())
        variances = np.maximum(variances, self._beam_variance)
        settings = self.settings
        if "dvl" not in self._rows:
            twist = np.radians(settings.dvl_misalignment_sigma_deg)
            self._rows["dvl"] = filter.append(np.zeros(4), np.array([settings.dvl_scale_sigma, twist, twist, twist]))
        at = self._rows["dvl"]
        calibration = filter.extra[at.start - CORE : at.stop - CORE]
        rotation, lever = self.T_imu_dvl[:3, :3], self.T_imu_dvl[:3, 3]
        turn = (1.0 + calibration[0]) * rotation_exp(-calibration[1:])
        by_velocity = turn @ rotation.T @ filter.rotation.T
        seen = by_velocity @ filter.velocity + turn @ rotation.T @ np.cross(filter.rate, lever)
        residual = along - directions @ seen
        rows = directions @ by_velocity
        gain = filter.covariance[VELOCITY, VELOCITY] @ rows.T
        change = gain @ np.linalg.solve(rows @ gain + np.diag(variances), residual)
        then = seen + by_velocity @ change
        slope = np.zeros((3, len(filter.covariance)))
        slope[:, VELOCITY] = by_velocity
        slope[:, GYRO_BIAS] = turn @ rotation.T @ cross(lever)
        slope[:, at.start] = then / (1.0 + calibration[0])
        slope[:, at.start + 1 : at.stop] = cross(then) @ left_jacobian(-calibration[1:])
        return self._update(filter, "dvl", residual, directions @ slope, variances)

    def _add_depth(self, filter: InvariantFilter, sample: PressureMeasurement) -> bool:
        """z of the sensor in odom, and a constant: the depth at which odom lies, with the sensor's own offset.

        How much waves press is told by how far the readings scatter about the motion that is known otherwise.
        """
        settings, height = self.settings, self.height(sample)
        place = filter.position + filter.rotation @ self.T_imu_pressure[:3, 3]
        if "pressure" not in self._rows:
            self._rows["pressure"] = filter.append(np.array([height - place[2]]), np.array([settings.height_sigma]))
        at = self._rows["pressure"].start
        elapsed = (sample.stamp_ns - self._stamps.get("pressure", sample.stamp_ns - 10**8)) * 1e-9
        self._stamps["pressure"] = sample.stamp_ns
        filter.covariance[at, at] += elapsed * settings.depth_walk**2
        slope = np.zeros((1, len(filter.covariance)))
        slope[0, POSITION] = [0.0, 0.0, 1.0]
        slope[0, ATTITUDE] = -cross(place)[2]
        slope[0, at] = 1.0
        variance = self.height_variance(sample, elapsed)
        residual = np.array([height - place[2] - filter.extra[at - CORE]])
        climb = float(np.sqrt(filter.covariance[VELOCITY, VELOCITY][2, 2]))
        believed = self._update(filter, "pressure", residual, slope, np.array([variance]))
        if believed and climb < settings.wave_climb:
            share = min(elapsed / settings.wave_memory_s, 1.0)
            scatter = (residual.item() - self._off) ** 2 - settings.depth_sigma**2
            self._off += share * (residual.item() - self._off)
            self._waves += share * (max(scatter, 0.0) - self._waves)
        return believed

    def _add_field(self, filter: InvariantFilter, sample: MagneticMeasurement) -> bool:
        """A R_mag_imu R^T f + h: field f in odom, hard iron h and soft iron A, none of which is known beforehand.

        With f free, one attitude says nothing; yaw is held by how the field turns against the vehicle.
        """
        settings = self.settings
        last = self._stamps.get("magnetometer")
        if last is not None and sample.stamp_ns - last < settings.magnetic_interval_s * 1e9:
            return self._in_a_row["magnetometer"] == 0
        self._stamps["magnetometer"] = sample.stamp_ns
        to_sensor = self.T_imu_compass[:3, :3].T @ filter.rotation.T
        if "magnetometer" not in self._rows:
            mean = np.concatenate([to_sensor.T @ sample.field, np.zeros(3), np.eye(3).ravel()])
            sigmas = [settings.field_sigma] * 3 + [settings.hard_iron_sigma] * 3 + [settings.soft_iron_sigma] * 9
            self._rows["magnetometer"] = filter.append(mean, np.array(sigmas))
        at = self._rows["magnetometer"]
        field, hard, soft = np.split(filter.extra[at.start - CORE : at.stop - CORE], [3, 6])
        soft = soft.reshape(3, 3)
        local = to_sensor @ field
        slope = np.zeros((3, len(filter.covariance)))
        slope[:, ATTITUDE] = soft @ to_sensor @ cross(field)
        slope[:, at.start : at.start + 3] = soft @ to_sensor
        slope[:, at.start + 3 : at.start + 6] = np.eye(3)
        slope[:, at.start + 6 : at.stop] = np.kron(np.eye(3), local)
        variance = np.full(3, sample.variance + settings.magnetic_sigma**2)
        return self._update(filter, "magnetometer", sample.field - soft @ local - hard, slope, variance)

    def _update(self, filter: InvariantFilter, kind: str, residual: Array, slope: Array, variances: Array) -> bool:
        """Correct by the rows that are as near to their prediction as their covariance says; whether there were any.

        When all of a sensor is refused time and again it is the filter that is wrong: what the sensor measures is then
        as uncertain as it is off, and the sample counts.
        """
        spread = np.einsum("ki,ij,kj->k", slope, filter.covariance, slope) + variances
        near = residual**2 <= float(chi2.isf(self.settings.gate, 1)) * spread
        if not near.all():
            self.refused[kind] += 1
        self._in_a_row[kind] = 0 if near.any() else self._in_a_row[kind] + 1
        if self._in_a_row[kind] > self.settings.patience:
            rows = WRONG[kind]
            lever = max(float(np.sum(slope[:, rows] ** 2)), 1e-30) / len(residual)
            filter.covariance[rows, rows] += np.eye(3) * float(np.max(residual**2)) / lever
            near[:] = True
        if near.any():
            filter.update(residual[near], slope[near], np.diag(variances[near]))
        return bool(near.any())
