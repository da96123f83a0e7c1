"""Doppler velocity log: along beam b it measures b . (1 + s) Exp(-m) R_dvl_imu (R^T v + w x r) at the time of its ping.

Scale s and misalignment m of its axes are its calibration, (4,); r is its place in the IMU frame, w the angular rate.
A ping precedes its message by a latency, and by what this message was later than others. The latency is estimated by
the filter alone: it multiplies accelerations, which are not known before it is, and that takes many small steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement
from oysterbench.sequence.types import Uncertainty
from oysterbench_baselines.common.aiding.instants import History, Instants, Record, instants
from oysterbench_baselines.common.aiding.ping_clock import PingClock, PingClockSettings
from oysterbench_baselines.common.aiding.sensor import (
    ROTATION,
    AidingSensor,
    Calibration,
    GateSettings,
    python_factor,
    stated_sigmas,
    symbol,
)
from oysterbench_baselines.common.filter import (
    ACCEL_BIAS,
    ATTITUDE,
    CORE,
    GYRO_BIAS,
    VELOCITY,
    InvariantFilter,
    cross,
    left_jacobian,
    rotation_exp,
)
from oysterbench_baselines.common.inertial import Segment

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

DVL_KEY = symbol("d")
WEAK = 1e-6  # share of the strongest direction's information below which beams say nothing about a direction
BIAS_STEP = 1e-5  # rad/s, step of the difference quotient
LATENCY_STEP_S = 0.025  # likewise: long against a thruster's revolution, whose vibration exceeds the acceleration
REACH_S = 0.6  # by which a message may be late
UNSEEN_ACCEL = 0.3  # m/s^2, 1 sigma: an ROV accelerates and sways


@dataclass(frozen=True)
class DvlSettings:
    """Settings of a DVL that its samples do not give. Scale and misalignment err by these besides what a calibration
    states."""

    scale_sigma: float = 0.01  # of 1: a DVL of the A50 class is sold as good to 1 %, the better model to 0.1 %
    misalignment_sigma_deg: float = 0.5  # per axis: to which a mount is made
    latency_s: float = 0.1  # of messages behind their pings: 50 to 200 ms, or none where stamps are the log's own
    latency_sigma_s: float = 0.1
    latency_walk_s: float = 1e-3  # s/sqrt(s)
    noise_floor: float = 0.001  # m/s, 1 sigma of a beam, whatever the sample says
    noise: float = 0.005  # m/s, likewise, where no sample has stated any
    huber: float = 3.0  # sigmas; beyond, a residual in the graph counts linearly
    clock: PingClockSettings = field(default_factory=PingClockSettings)

    @property
    def sigmas(self) -> Array:
        """1 sigmas (4,) of scale and misalignment (rad)."""
        twist = np.radians(self.misalignment_sigma_deg)
        return np.array([self.scale_sigma, twist, twist, twist])


@dataclass(frozen=True)
class Ping:
    """What the beams measured, and when: time_s after a state of the vehicle (negative: before it), less the latency.
    directions (K, 3), along (K,) m/s, variances (K,): see `beam_rows`."""

    time_s: float
    directions: Array
    along: Array
    variances: Array


@dataclass(frozen=True)
class Interval:
    """Pings between two keyframes, and the inertial measurements around the first of the keyframes."""

    record: Record
    pings: list[Ping]


@dataclass(frozen=True)
class Latency:
    """Delay of messages, s, and its 1 sigma."""

    mean_s: float
    sigma_s: float


class Dvl(AidingSensor):
    """DVL as an aiding sensor. T_imu_dvl (4, 4): its mount. velocity_ns: stamp of the last velocity that was believed.
    latency: the filter's latest estimate."""

    kind = "dvl"
    measures = (DvlMeasurement,)
    suspect = VELOCITY
    unit = np.ones(4)

    def __init__(
        self,
        T_imu_dvl: Array,
        gravity: float,
        settings: DvlSettings,
        gate: GateSettings,
        uncertainty: Uncertainty | None = None,
    ) -> None:
        """uncertainty: of the whole rig, as its calibration states it."""
        super().__init__(gate)
        stated = stated_sigmas(uncertainty, "dvl", ("scale", *ROTATION))
        self._sigmas = np.hypot(settings.sigmas, stated)
        self.latency = Latency(settings.latency_s, settings.latency_sigma_s)
        self._latency = -1  # its row in the filter's error
        self.T_imu_dvl, self.gravity, self.settings = T_imu_dvl, gravity, settings
        self.velocity_ns: int | None = None
        self._clock = PingClock(settings.clock)
        self._history = History(REACH_S)
        self._last_ns: int | None = None
        self._beam_variance = settings.noise**2
        self._pings: list[Ping] = []  # since the last keyframe
        self._intervals: dict[int, Interval] = {}  # by the keyframe that they lead to

    def update(self, filter: InvariantFilter, sample: DvlMeasurement) -> bool:
        """Correct the filter by the beams of a sample; return whether any of it was believed.

        A beam is linear in v, but not in v and the calibration together: the derivatives by the calibration are taken
        at the velocity that the sample leads to. At the one before it, which is zero at a start in motion, or wrong
        after a long silence, the sample would say nothing about the misalignment, the next one would, and from the two
        of them the filter would believe it knows it.
        """
        late_s, jitter_s = self._clock.late(sample.stamp_ns)
        beams = beam_rows(sample, self.settings.noise_floor)
        if beams is None:
            return False
        directions, along, variances = beams
        if len(directions) >= 3:
            self._beam_variance = float(variances.max())
        variances = np.maximum(variances, self._beam_variance)
        if self.rows is None:
            self.rows = filter.append(np.zeros(4), self._sigmas)
            added = filter.append(np.array([self.settings.latency_s]), np.array([self.settings.latency_sigma_s]))
            self._latency = added.start
        row = self._latency
        self._walk(filter, sample.stamp_ns)
        # No message arrives before its ping.
        known = Latency(max(float(filter.extra[row - CORE]), -late_s), float(np.sqrt(filter.covariance[row, row])))
        ping = Ping(-late_s, directions, along, variances)
        record = self._history.about_end()
        residual, slope, by_time, noise = predict(ping, known, record, filter, self.rows, self.T_imu_dvl)
        slope[:, row] = by_time
        residual = residual - (filter.extra[row - CORE] - known.mean_s) * by_time
        noise += jitter_s**2 * np.outer(by_time, by_time)
        believed = self.correct(filter, residual, slope, noise)
        self.latency = Latency(float(filter.extra[row - CORE]), float(np.sqrt(filter.covariance[row, row])))
        if believed:
            self.velocity_ns = sample.stamp_ns
            time_s = ping.time_s + self._history.since_s
            self._pings.append(replace(ping, time_s=time_s, variances=noise.diagonal()))
        return believed

    def _walk(self, filter: InvariantFilter, stamp_ns: int) -> None:
        """Add the latency's random walk since the last sample to its variance."""
        elapsed = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        filter.covariance[self._latency, self._latency] += elapsed * self.settings.latency_walk_s**2
        self._last_ns = stamp_ns

    def found(self, filter: InvariantFilter) -> dict[str, float]:
        if self.rows is None:
            return {}
        return {"dvl_scale": 1.0 + float(filter.extra[self.rows.start - CORE]), "dvl_latency_s": self.latency.mean_s}

    def propagate(self, segment: Segment) -> None:
        self._history.add(segment)

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        self._intervals[keyframe], self._pings = Interval(self._history.about_mark(), self._pings), []
        self._history.mark()

    def forget_intervals(self) -> None:
        self._intervals.clear()

    def calibration(self) -> Calibration:
        return Calibration(DVL_KEY, np.zeros(4), self._sigmas)

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        velocity = sum_velocities(self._intervals[keyframe], self.latency, before, self.gravity, self.T_imu_dvl)
        return [] if velocity is None else [velocity_factor(velocity, keyframe - 1, self.gravity, self.settings.huber)]


def predict(
    ping: Ping, latency: Latency, record: Record, filter: InvariantFilter, at: slice, T_imu_dvl: Array
) -> tuple[Array, Array, Array, Array]:
    """Residuals (K,), measured minus predicted, of the beams of a ping; their derivatives by the filter's error
    (K, 15 + M), except the latency, and by the latency (K,), m/s^2; and the noise (K, K). at: rows of the log's
    calibration.

    Latency and acceleration multiply, and both may be unknown at first: their second-order effect counts as noise with
    the product of their variances (Bar-Shalom, Li, Kirubarajan 2001, sec. 10.3.2). Without it a bias of the
    accelerometer is taken for latency.
    """
    calibration = filter.extra[at.start - CORE : at.stop - CORE]
    rotation, lever = T_imu_dvl[:3, :3], T_imu_dvl[:3, 3]
    turn = (1.0 + calibration[0]) * rotation_exp(-calibration[1:]) @ rotation.T
    to_body = filter.rotation.T
    start, down = to_body @ filter.velocity, to_body @ filter.down
    time = ping.time_s - latency.mean_s
    times = time + LATENCY_STEP_S * np.array([0.0, -1.0, 1.0])

    def moving(gyro_bias: Array) -> tuple[Array, Instants]:
        """Velocities (3, 3) m/s of the log at the ping, and a step before and after it, in the IMU frame."""
        found = instants(record, times, gyro_bias, filter.accel_bias)
        return found.velocities(start, down) + np.cross(found.rate, lever), found

    (now, before, after), then = moving(filter.gyro_bias)
    missed = max(0.0, -time - record.before_s)  # s, from before the first inertial measurements
    variances = ping.variances + (UNSEEN_ACCEL * missed) ** 2
    back = turn @ then.rotation[0].T
    slope = np.zeros((3, len(filter.covariance)))
    slope[:, VELOCITY] = back @ to_body
    slope[:, ATTITUDE] = then.time[0] * back @ to_body @ cross(filter.down)
    slope[:, ACCEL_BIAS] = back @ then.accel[0]
    for axis in range(3):
        moved = moving(filter.gyro_bias + BIAS_STEP * np.eye(3)[axis])[0][0]
        slope[:, GYRO_BIAS.start + axis] = turn @ (moved - now) / BIAS_STEP
    by_velocity = ping.directions @ slope[:, VELOCITY]
    residual = ping.along - ping.directions @ turn @ now
    gain = filter.covariance[VELOCITY, VELOCITY] @ by_velocity.T
    change = gain @ np.linalg.solve(by_velocity @ gain + np.diag(variances), residual)
    seen = turn @ now + slope[:, VELOCITY] @ change
    slope[:, at.start] = seen / (1.0 + calibration[0])
    slope[:, at.start + 1 : at.stop] = cross(seen) @ left_jacobian(-calibration[1:])
    by_time = ping.directions @ turn @ (before - after) / max(then.time[2] - then.time[1], LATENCY_STEP_S)
    by_accel = np.zeros((3, len(filter.covariance)))
    by_accel[:, ATTITUDE], by_accel[:, ACCEL_BIAS] = back @ to_body @ cross(filter.down), -back
    by_accel = ping.directions @ by_accel
    both = latency.sigma_s**2 * by_accel @ filter.covariance @ by_accel.T
    return residual, ping.directions @ slope, by_time, np.diag(variances) + both


def beam_rows(sample: DvlMeasurement, floor: float) -> tuple[Array, Array, Array] | None:
    """Directions (K, 3) in the DVL's frame, velocities (K,) m/s along them, and their variances (K,).

    Valid beams count individually: fewer than three, which give no velocity, still say something. The noise of a beam
    follows from the covariance of the velocity, sigma^2 (B^T B)^-1, or is the floor. Without valid beams, the velocity
    itself is taken; None where there is neither.
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


@dataclass(frozen=True)
class Velocity:
    """What a DVL says about the velocity at the first of two keyframes, from the interval between them.

    With u = R^T v there, g gravity, a and b the changes of accelerometer and gyro bias, c the DVL's calibration:
    axes (u + down R^T g + accel a + gyro b + calibration c - measured) is white with `sigmas`.

    axes (K, 3) unit rows, K <= 3; sigmas (K,) m/s; down (3, 3) s: the samples' mean time after the keyframe, and how
    the turns in between mix the axes; accel, gyro (3, 3), calibration (3, 4); measured (3,); bias: of the IMU, about
    which it was linearised.
    """

    axes: Array
    sigmas: Array
    down: Array
    accel: Array
    gyro: Array
    calibration: Array
    measured: Array
    bias: gtsam.imuBias.ConstantBias


def sum_velocities(
    interval: Interval, latency: Latency, state: State, gravity: float, T_imu_dvl: Array
) -> Velocity | None:
    """Combine all pings of an interval, carried to its start by the inertial measurements, into one; None without any.

    state: roughly, at its start. The uncertainty of the latency shifts all pings together.

    A beam d of the DVL at time t measures
    d . (1 + s) Exp(-m) R_dvl_imu (dR^T (u + t R^T g + dv) + w x r), with dR, dv the preintegrated rotation and velocity
    (Forster et al. 2017, eq. 33). The rows of all beams are linear in u: their least-squares solution for it is the
    measurement, stored with its dependence on the rest.
    """
    if not interval.pings:
        return None
    to_dvl, lever = T_imu_dvl[:3, :3].T, T_imu_dvl[:3, 3]
    bias, pings = state.bias, interval.pings
    to_body = state.nav.attitude().matrix().T
    start, down = to_body @ state.nav.velocity(), to_body @ np.array([0.0, 0.0, -gravity])
    at = np.array([ping.time_s for ping in pings]) - latency.mean_s
    times = np.concatenate([at, at - LATENCY_STEP_S, at + LATENCY_STEP_S])
    directions = np.concatenate([ping.directions for ping in pings]) @ to_dvl
    of = np.repeat(np.arange(len(pings)), [len(ping.directions) for ping in pings])  # by row, its ping

    def moving(gyro_bias: Array) -> tuple[Array, Instants]:
        """Velocities (3 n, 3) m/s of the log at the pings, and a step before and after them, in the IMU frame."""
        found = instants(interval.record, times, gyro_bias, bias.accelerometer())
        return found.velocities(start, down) + np.cross(found.rate, lever), found

    seen, then = moving(bias.gyroscope())
    slope = np.einsum("kj,klj->kl", directions, then.rotation[of])
    along = np.einsum("kj,kj->k", directions, seen[of])
    gyro_slope = np.empty((len(of), 3))
    for axis in range(3):
        moved, _ = moving(bias.gyroscope() + BIAS_STEP * np.eye(3)[axis])
        gyro_slope[:, axis] = np.einsum("kj,kj->k", directions, moved[of] - seen[of]) / BIAS_STEP
    # The velocity in the DVL's frame, which its calibration multiplies.
    turned = np.cross(np.concatenate([ping.directions for ping in pings]), (seen @ to_dvl.T)[of])
    calibration_slope = np.column_stack([along, turned])
    _, before, after = np.split(seen, 3)
    by_time = np.einsum("kj,kj->k", directions, ((before - after) / (2 * LATENCY_STEP_S))[of])
    noise = np.diag(np.concatenate([ping.variances for ping in pings]))
    noise += latency.sigma_s**2 * np.outer(by_time, by_time)
    if not np.isfinite(noise).all():
        return None
    weight = np.linalg.inv(noise)
    information = slope.T @ weight @ slope
    values, vectors = np.linalg.eigh(information)
    known = values > WEAK * values[-1]
    axes = vectors[:, known].T
    solve = (vectors[:, known] / values[known]) @ axes @ slope.T @ weight  # (3, M): the least-squares solution
    measured = np.concatenate([ping.along for ping in pings])
    return Velocity(
        axes,
        1.0 / np.sqrt(values[known]),
        solve @ (slope * then.time[of][:, None]),
        solve @ np.einsum("kj,kjl->kl", slope, then.accel[of]),
        solve @ gyro_slope,
        solve @ calibration_slope,
        solve @ (measured - along + slope @ start + then.time[of] * (slope @ down)),
        bias,
    )


def velocity_error(
    velocity: Velocity,
    gravity: float,
    pose: gtsam.Pose3,
    v: Array,
    bias: gtsam.imuBias.ConstantBias,
    calibration: Array,
) -> tuple[Array, list[Array]]:
    """Error (K,) of a `Velocity`; its derivatives by pose (K, 6), velocity (K, 3), bias (K, 6), calibration (K, 4)."""
    to_body = pose.rotation().matrix().T
    start, down = to_body @ v, to_body @ np.array([0.0, 0.0, -gravity])
    accel = bias.accelerometer() - velocity.bias.accelerometer()
    gyro = bias.gyroscope() - velocity.bias.gyroscope()
    error = start + velocity.down @ down + velocity.accel @ accel + velocity.gyro @ gyro
    error = error + velocity.calibration @ calibration - velocity.measured
    turn = cross(start) + velocity.down @ cross(down)
    slopes = [
        np.hstack([turn, np.zeros((3, 3))]),
        to_body,
        np.hstack([velocity.accel, velocity.gyro]),
        velocity.calibration,
    ]
    return velocity.axes @ error, [velocity.axes @ slope for slope in slopes]


def velocity_factor(velocity: Velocity, keyframe: int, gravity: float, huber: float) -> gtsam.NonlinearFactor:
    """Factor of a `Velocity` on pose, velocity and bias of a keyframe, and the DVL's calibration."""
    keys = [symbol("x", keyframe), symbol("v", keyframe), symbol("b", keyframe), DVL_KEY]
    evaluate: Callable[..., Any] = lambda *at: velocity_error(velocity, gravity, *at)  # noqa: E731
    return python_factor(keys, velocity.sigmas, len(velocity.sigmas), evaluate, huber=huber)
