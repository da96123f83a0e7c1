"""Inertial unit: the angular rate and specific force of the path, and the errors that a real unit adds."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.signal import lfilter

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import ImuRecipe
from oysterbench.scene.path import Motion, Path
from oysterbench.scene.rig import GRAVITY, imu_pose
from oysterbench.sensors.vibration import vibrate


@dataclass(frozen=True, kw_only=True)
class Triad:
    """Errors of three axes, gyroscopes or accelerometers, as `ImuRecipe` states them; u is rad/s or m/s^2."""

    noise_density: float  # u/sqrt(Hz)
    random_walk: float = 0.0  # u/s/sqrt(Hz)
    turn_on: float = 0.0  # u, 1 sigma
    bias_instability: float = 0.0  # u, stationary sigma
    bias_tau_s: float = 100.0
    scale: float = 0.0  # 1 sigma
    misalignment_deg: float = 0.0  # 1 sigma
    range: float | None = None  # u
    step: float = 0.0  # u

    @classmethod
    def of(cls, recipe: ImuRecipe, which: str) -> Triad:
        """That of a recipe: "gyro" or "accel"."""
        return cls(**{key.name: getattr(recipe, f"{which}_{key.name}") for key in fields(cls)})


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
    """What the unit reports at times (N,) = k / rate_hz s: gyro (N, 3) rad/s and accel (N, 3) m/s^2, in the IMU frame.

    Vibration moves the unit like its path does; then come the errors of its axes, each from a stream of its own.
    """
    gyro, accel = ideal_imu(path.at(times_s), imu_pose(recipe))
    return read_out(gyro, recipe, "gyro", streams.at("imu")), read_out(accel, recipe, "accel", streams.at("imu"))


def read_out(truth: Array, recipe: ImuRecipe, which: str, streams: Streams) -> Array:
    """What the "gyro" or "accel" triad of a unit makes of its truth (N, 3), in the truth's unit."""
    n, triad = len(truth), Triad.of(recipe, which)
    for index, vibration in enumerate(recipe.vibration):
        if vibration.on == which:
            truth = truth + vibrate(n, recipe.rate_hz, vibration, streams.at("vibration", index))
    if triad.scale or triad.misalignment_deg:
        truth = truth @ sensitivity(triad, streams.at(which)).T
    return digitise(truth + errors(n, 1.0 / recipe.rate_hz, triad, streams.at(which)), triad)


def sensitivity(triad: Triad, streams: Streams) -> Array:
    """(3, 3) matrix from truth to reading: errors of scale on the diagonal, of each axis' direction beside it."""
    matrix = np.radians(triad.misalignment_deg) * streams.generator("misalignment").standard_normal((3, 3))
    np.fill_diagonal(matrix, 1.0 + triad.scale * streams.generator("scale").standard_normal(3))
    return matrix


def errors(n: int, dt: float, triad: Triad, streams: Streams) -> Array:
    """(n, 3) bias and noise of samples dt apart: turn-on bias, walk and instability of the bias, and white noise.

    White noise of the continuous density has sigma = density / sqrt(dt) per sample (IEEE 952-1997, annex C).
    """
    total = np.tile(triad.turn_on * streams.generator("turn_on").standard_normal(3), (n, 1))
    if triad.random_walk:
        total += random_walk(n, dt, triad.random_walk, streams.generator("walk"))
    if triad.bias_instability:
        total += gauss_markov(n, dt, triad.bias_instability, triad.bias_tau_s, streams.generator("instability"))
    if triad.noise_density:
        total += triad.noise_density / np.sqrt(dt) * streams.generator("white").standard_normal((n, 3))
    return total


def random_walk(n: int, dt: float, density: float, rng: np.random.Generator) -> Array:
    """(n, 3) walks from zero, in steps of density * sqrt(dt) (IEEE 952-1997, annex C)."""
    steps = density * np.sqrt(dt) * rng.standard_normal((n, 3))
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)


def gauss_markov(n: int, dt: float, sigma: float, tau_s: float, rng: np.random.Generator) -> Array:
    """(n, 3) first-order Gauss-Markov processes of standard deviation sigma from their first sample on.

    b_k = phi b_(k-1) + sigma sqrt(1 - phi^2) w_k with phi = exp(-dt / tau): the exponentially correlated noise of
    IEEE 952-1997, annex C, exact at any dt.
    """
    drive = sigma * rng.standard_normal((n, 3))
    drive[1:] *= np.sqrt(-np.expm1(-2 * dt / tau_s))
    return np.asarray(lfilter([1.0], [1.0, -np.exp(-dt / tau_s)], drive, axis=0))


def digitise(values: Array, triad: Triad) -> Array:
    """Readings (N, 3) as they leave the unit: they stop at its range, and come in its steps."""
    if triad.range is not None:
        values = np.clip(values, -triad.range, triad.range)
    return np.rint(values / triad.step) * triad.step if triad.step else values
