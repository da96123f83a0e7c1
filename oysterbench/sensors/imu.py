"""Inertial unit: the angular rate and specific force of the path, and the noise that a real unit adds."""

from __future__ import annotations

import numpy as np

from oysterbench.geometry import Array
from oysterbench.recipe import ImuRecipe
from oysterbench.scene.path import Motion, Path
from oysterbench.scene.rig import GRAVITY, imu_pose
from oysterbench.streams import Streams


def ideal_imu(motion: Motion, T_base_imu: Array) -> tuple[Array, Array]:
    """Angular rate (N, 3) rad/s and specific force (N, 3) m/s^2, in the IMU frame, of a unit without errors.

    The unit sits at a lever arm r from the body's origin and feels
    f = R^T (a - g) + w' x r + w x (w x r) (Savage 1998, sec. 2), turned into its own axes.
    """
    lever = T_base_imu[:3, 3]
    gravity = np.array([0.0, 0.0, -GRAVITY])
    force = np.einsum("nji,nj->ni", motion.rotation, motion.acceleration - gravity)
    force = force + np.cross(motion.rate_dot, lever) + np.cross(motion.rate, np.cross(motion.rate, lever))
    return motion.rate @ T_base_imu[:3, :3], force @ T_base_imu[:3, :3]


def measure(path: Path, recipe: ImuRecipe, times_s: Array, streams: Streams) -> tuple[Array, Array]:
    """What the unit reports at times (N,) s: gyro (N, 3) rad/s and accel (N, 3) m/s^2, in the IMU frame.

    Truth + turn-on bias + random walk of the bias + white noise, each from a stream of its own.
    """
    gyro, accel = ideal_imu(path.at(times_s), imu_pose(recipe))
    dt = 1.0 / recipe.rate_hz
    gyro = gyro + errors(
        len(times_s),
        dt,
        recipe.gyro_noise_density,
        recipe.gyro_random_walk,
        recipe.gyro_turn_on,
        streams.at("imu", "gyro"),
    )
    accel = accel + errors(
        len(times_s),
        dt,
        recipe.accel_noise_density,
        recipe.accel_random_walk,
        recipe.accel_turn_on,
        streams.at("imu", "accel"),
    )
    return gyro, accel


def errors(n: int, dt: float, noise_density: float, random_walk: float, turn_on: float, streams: Streams) -> Array:
    """(n, 3) errors: turn-on bias, random walk, and white noise of the continuous density sampled at dt.

    White noise has sigma = density / sqrt(dt) per sample, the walk a step of random_walk * sqrt(dt)
    (IEEE 952-1997, annex C).
    """
    bias = turn_on * streams.generator("turn_on").standard_normal(3)
    steps = random_walk * np.sqrt(dt) * streams.generator("walk").standard_normal((n, 3))
    steps[0] = 0.0
    white = noise_density / np.sqrt(dt) * streams.generator("white").standard_normal((n, 3))
    return bias + np.cumsum(steps, axis=0) + white
