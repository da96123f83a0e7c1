"""Error-state Kalman filter of an inertial navigator, its error taken on the group of attitude, velocity and position.

The errors are right-invariant (Barrau & Bonnabel 2017; with biases Hartley et al. 2020, sec. 4): with R, v, p the
attitude, velocity and position of the IMU in odom, and e = (theta, x, y) the error,

    R = Exp(theta) R^,    v = Exp(theta) v^ + x,    p = Exp(theta) p^ + y.

So theta turns about the fixed axes of odom, a body-frame velocity depends on x alone, whatever the estimate is, and
yaw gains no information from measurements that have none. Biases and the states of aiding sensors add as usual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import ImuCalibration
from oysterbench_baselines.common.inertial import Segment

ATTITUDE, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
FLOOR = np.diag([1e-4**2] * 3 + [1e-5**2] * 3)
"""Added to every covariance of a pose, m^2 and rad^2: the first pose is exact by definition, and a singular matrix
cannot be inverted."""
GYRO_WARMING, ACCEL_WARMING = 1e-4, 1e-3
"""Random walks, rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz), that keep up with the biases of an IMU that warms by 0.1 K/s: 1e-4
to 9e-4 rad/s and 0.005 to 0.01 m/s^2 per K in MEMS without compensation. No data sheet counts this as noise."""
UNKNOWN_RATE, UNKNOWN_ACCEL = 0.2, 0.5
"""Rad/s and m/s^2, 1 sigma: motion of a vehicle while no inertial samples arrive."""
CORE = 15
"""Rows of the error: attitude (rad), velocity (m/s), position (m), both biases (rad/s, m/s^2); then aiding states."""
IDENTITY = np.eye(3)
IDENTITY.setflags(write=False)


@dataclass(frozen=True)
class InertialNoise:
    """Continuous white densities of gyro (rad/s/sqrt(Hz)) and accel (m/s^2/sqrt(Hz)), and of their biases' walks."""

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float

    @staticmethod
    def of(imu: ImuCalibration, inflation: float) -> InertialNoise:
        """Noise of an IMU that is warming up, its white part inflated; where a file says zero, a little is assumed."""
        return InertialNoise(
            max(imu.gyro_noise_density, 1e-6) * inflation,
            max(imu.accel_noise_density, 1e-5) * inflation,
            math.hypot(imu.gyro_random_walk, GYRO_WARMING),
            math.hypot(imu.accel_random_walk, ACCEL_WARMING),
        )


class InvariantFilter:
    """State of the IMU in odom, biases, and further states of aiding sensors, with their joint covariance.

    rotation (3, 3) R_odom_imu, velocity, position (3,), gyro_bias, accel_bias (3,), extra (M,): means.
    covariance (15 + M, 15 + M): of the error above. down (3,): gravity in odom, m/s^2.
    """

    def __init__(self, rotation: Array, noise: InertialNoise, gravity: float) -> None:
        self.rotation = np.array(rotation)
        self.velocity, self.position = np.zeros(3), np.zeros(3)
        self.gyro_bias, self.accel_bias = np.zeros(3), np.zeros(3)
        self.extra = np.empty(0)
        self.covariance = np.zeros((CORE, CORE))
        self.rate = np.zeros(3)  # latest angular rate, rad/s, in the IMU frame, bias removed
        self.noise = noise
        self.down = np.array([0.0, 0.0, -gravity])

    @property
    def pose(self) -> Array:
        """T_odom_imu (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix

    def append(self, mean: Array, sigmas: Array) -> slice:
        """Add states with means (K,) and independent 1 sigmas (K,); return their rows in the error."""
        n, k = len(self.covariance), len(mean)
        covariance = np.zeros((n + k, n + k))
        covariance[:n, :n] = self.covariance
        covariance[n:, n:] = np.diag(np.asarray(sigmas, dtype=float) ** 2)
        self.extra, self.covariance = np.concatenate([self.extra, mean]), covariance
        return slice(n, n + k)

    def propagate(self, dt: float, gyro: Array, accel: Array) -> None:
        """Propagate by dt (s) at mean rate (3,) rad/s and specific force (3,) m/s^2, as `propagate_all` does."""
        self.propagate_all(Segment(np.array([dt]), gyro[None], accel[None]))

    def propagate_all(self, segment: Segment) -> None:
        """Propagate by a segment of inertial measurements: each force acts in the attitude half-way through its
        interval, and the transitions are exact to second order in dt. Where samples are missing, nothing is known."""
        if len(segment.dt) == 0:
            return
        rates, forces = segment.gyro - self.gyro_bias, segment.accel - self.accel_bias
        turns = rates * segment.dt[:, None]
        steps, halves = rotation_exp(turns), rotation_exp(0.5 * turns)
        middles, velocities, positions = np.empty_like(steps), np.empty_like(rates), np.empty_like(rates)
        for k, dt in enumerate(segment.dt.tolist()):
            middle = self.rotation @ halves[k]
            middles[k], velocities[k], positions[k] = middle, self.velocity, self.position
            acceleration = middle @ forces[k] + self.down
            self.position = self.position + dt * (self.velocity + 0.5 * dt * acceleration)
            self.velocity = self.velocity + dt * acceleration
            self.rotation = self.rotation @ steps[k]
        self.rate = rates[-1]
        self.forget(segment)
        self._propagate_covariance(segment.dt[:, None, None], middles, cross(velocities), cross(positions))

    def forget(self, segment: Segment) -> None:
        """Grow the covariance by what vehicles do in the part of a segment in which samples are missing, if so."""
        if segment.has_gap:
            since, before = segment.gap_s, max(segment.gap_s - segment.duration, 0.0)  # a gap has been cut at frames
            rate, accel = UNKNOWN_RATE**2 * (since**2 - before**2), UNKNOWN_ACCEL**2 * (since**2 - before**2)
            place = (0.5 * UNKNOWN_ACCEL) ** 2 * (since**4 - before**4)
            self.covariance[:9, :9] += np.diag(np.repeat([rate, accel, place], 3))

    def _propagate_covariance(self, dt: Array, middles: Array, v: Array, p: Array) -> None:
        """Propagate the covariance by N intervals: dt (N, 1, 1) s, attitudes half-way (N, 3, 3), cross-product matrices
        (N, 3, 3) of velocities and positions at their beginnings."""
        noise, eye, g = self.noise, IDENTITY, cross(self.down)
        steps = np.tile(np.eye(CORE), (len(dt), 1, 1))
        turned = dt * middles
        steps[:, ATTITUDE, GYRO_BIAS] = -turned
        steps[:, VELOCITY, ATTITUDE] = dt * g
        steps[:, VELOCITY, GYRO_BIAS] = -(v + 0.5 * dt * g) @ turned
        steps[:, VELOCITY, ACCEL_BIAS] = -turned
        steps[:, POSITION, ATTITUDE] = 0.5 * dt**2 * g
        steps[:, POSITION, VELOCITY] = dt * eye
        steps[:, POSITION, GYRO_BIAS] = -(p + 0.5 * dt * v) @ turned
        steps[:, POSITION, ACCEL_BIAS] = -0.5 * dt * turned
        # White noise of the rate turns everything about odom's origin: the group's adjoint.
        lever = np.concatenate([np.broadcast_to(eye, v.shape), v, p], axis=1)
        added = np.zeros_like(steps)
        added[:, :9, :9] = dt * noise.gyro**2 * (lever @ lever.transpose(0, 2, 1))
        added[:, VELOCITY, VELOCITY] += dt * noise.accel**2 * eye
        added[:, GYRO_BIAS, GYRO_BIAS] = dt * noise.gyro_walk**2 * eye
        added[:, ACCEL_BIAS, ACCEL_BIAS] = dt * noise.accel_walk**2 * eye
        whole = self.covariance
        core, shared = whole[:CORE, :CORE].copy(), whole[:CORE, CORE:]
        for step, more in zip(steps, added, strict=True):
            core = step @ core @ step.T + more
            core = 0.5 * (core + core.T)
            shared = step @ shared
        whole[:CORE, :CORE] = core
        whole[:CORE, CORE:], whole[CORE:, :CORE] = shared, shared.T

    def update(self, residual: Array, slope: Array, noise: Array) -> None:
        """Correct by measured minus predicted (K,), with its derivative (K, 15 + M) by the error and its covariance
        (K, K); in Joseph form, which keeps the covariance positive."""
        gain = np.linalg.solve(slope @ self.covariance @ slope.T + noise, slope @ self.covariance).T
        change = gain @ residual
        left = np.eye(len(self.covariance)) - gain @ slope
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        self.covariance = 0.5 * (covariance + covariance.T)
        turn = change[ATTITUDE]
        rotation, jacobian = rotation_exp(turn), left_jacobian(turn)
        self.rotation = orthonormal(rotation @ self.rotation)
        self.velocity = rotation @ self.velocity + jacobian @ change[VELOCITY]
        self.position = rotation @ self.position + jacobian @ change[POSITION]
        self.gyro_bias = self.gyro_bias + change[GYRO_BIAS]
        self.accel_bias = self.accel_bias + change[ACCEL_BIAS]
        self.extra = self.extra + change[CORE:]

    def pose_covariance(self, position: Array) -> Array:
        """Covariance (6, 6) of the pose of a frame fixed to the IMU whose origin is at `position` (3,) in odom.

        x y z (m) and rotations (rad), all about odom's axes: dp = y + theta x p, so that the lever arm is included.
        """
        change = np.zeros((6, 9))
        change[:3, POSITION] = change[3:, ATTITUDE] = np.eye(3)
        change[:3, ATTITUDE] = -cross(position)
        return change @ self.covariance[:9, :9] @ change.T


def cross(vectors: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3) on its left."""
    if vectors.ndim == 1:
        x, y, z = vectors.tolist()  # an array is built twice as fast from Python's own numbers
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    x, y, z = np.moveaxis(vectors, -1, 0)
    matrices = np.zeros((*vectors.shape, 3))
    matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2] = -z, y, -x
    matrices[..., 1, 0], matrices[..., 2, 0], matrices[..., 2, 1] = z, -y, x
    return matrices


def rotation_exp(turns: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) rad (Rodrigues)."""
    angle = np.sqrt((turns * turns).sum(axis=-1))[..., None, None]
    small = angle < 1e-4  # the next terms are below 1e-9 of it
    safe = np.where(small, 1.0, angle)
    matrices = cross(turns)
    first = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(IDENTITY + first * matrices + second * (matrices @ matrices), dtype=float)


def left_jacobian(turn: Array) -> Array:
    """Left Jacobian (3, 3) of SO(3) at a rotation vector (3,) (Sola et al. 2018, eq. 145)."""
    angle = math.sqrt(turn @ turn)
    matrix = cross(turn)
    if angle < 1e-4:
        return IDENTITY + 0.5 * matrix + matrix @ matrix / 6
    share = (angle - float(np.sin(angle))) / angle**3
    return IDENTITY + (1 - float(np.cos(angle))) / angle**2 * matrix + share * (matrix @ matrix)


def orthonormal(rotation: Array) -> Array:
    """Orthonormalise a nearly orthonormal matrix (3, 3): one step of Newton's iteration for the polar decomposition."""
    return 0.5 * rotation @ (3 * np.eye(3) - rotation.T @ rotation)
