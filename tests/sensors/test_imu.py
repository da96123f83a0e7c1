"""The inertial unit, held against its own physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.recipe import ImuRecipe, load_split
from oysterbench.scene.path import build_path
from oysterbench.scene.rig import GRAVITY, imu_pose
from oysterbench.sensors.imu import errors, ideal_imu, measure
from oysterbench.streams import Streams


def hills(x, y):
    return -4.0 + 0.2 * np.sin(x) * np.cos(0.7 * y)


@pytest.fixture(scope="module")
def path():
    recipe = load_split("slam-mini").sequence[0]
    return build_path(recipe, hills, hills, Streams(7, b"", ("test",)))


def unit(**changes):
    quiet = {"gyro_noise_density": 0, "gyro_random_walk": 0, "accel_noise_density": 0, "accel_random_walk": 0}
    values = {"rate_hz": 200.0, "position_m": (0.3, -0.2, 0.1), "rpy_deg": (10.0, -20.0, 130.0)}
    return ImuRecipe(**{**quiet, **values, **changes})


def integrate(gyro, accel, dt, position, velocity, rotation):
    """Strapdown integration of samples at 0, dt, 2 dt, ... by the trapezoidal rule; yields position and rotation."""
    gravity = np.array([0.0, 0.0, -GRAVITY])
    yield position, rotation
    for k in range(len(gyro) - 1):
        turned = rotation * Rotation.from_rotvec(0.5 * (gyro[k] + gyro[k + 1]) * dt)
        acceleration = 0.5 * (rotation.apply(accel[k]) + turned.apply(accel[k + 1])) + gravity
        position = position + velocity * dt + 0.5 * acceleration * dt**2
        velocity = velocity + acceleration * dt
        rotation = turned
        yield position, rotation


def test_integrating_the_ideal_unit_gives_the_path_back_within_a_centimetre(path):
    recipe = unit()
    times = np.arange(0.0, 20.0, 1 / recipe.rate_hz)
    gyro, accel = measure(path, recipe, times, Streams(1))
    motion, pose = path.at(times), imu_pose(recipe)
    start = motion.rotation[0]
    velocity = motion.velocity[0] + start @ np.cross(motion.rate[0], pose[:3, 3])
    states = integrate(
        gyro,
        accel,
        1 / recipe.rate_hz,
        motion.position[0] + start @ pose[:3, 3],
        velocity,
        Rotation.from_matrix(start @ pose[:3, :3]),
    )
    worst = 0.0
    for k, (position, rotation) in enumerate(states):
        body = rotation.as_matrix() @ pose[:3, :3].T
        worst = max(worst, float(np.linalg.norm(position - body @ pose[:3, 3] - motion.position[k])))
    assert worst < 0.01


def test_a_unit_at_rest_feels_gravity_upwards():
    recipe = unit(position_m=(0.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 0.0))
    still = load_split("slam-mini").sequence[0]
    motion = build_path(still, hills, hills, Streams(3)).at(np.zeros(1))
    gyro, accel = ideal_imu(motion, imu_pose(recipe))
    assert np.allclose(gyro, 0.0, atol=1e-3)
    assert np.allclose(motion.rotation[0] @ accel[0], [0.0, 0.0, GRAVITY], atol=1e-2)


def test_white_noise_has_the_density_asked_for():
    samples = errors(40_000, 1 / 200, noise_density=1e-3, random_walk=0.0, turn_on=0.0, streams=Streams(5))
    assert samples.std() == pytest.approx(1e-3 * np.sqrt(200), rel=0.01)
    assert np.corrcoef(samples[:-1, 0], samples[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.02)


def test_bias_starts_at_its_turn_on_value_and_walks_with_the_root_of_time():
    walks = np.stack([errors(2001, 0.01, 0.0, 2e-3, 0.0, Streams(seed))[:, 0] for seed in range(400)])
    assert np.all(walks[:, 0] == 0.0)
    assert walks[:, 500].std() == pytest.approx(2e-3 * np.sqrt(5.0), rel=0.12)
    assert walks[:, 2000].std() == pytest.approx(2e-3 * np.sqrt(20.0), rel=0.12)
    biases = np.concatenate([errors(2, 0.01, 0.0, 0.0, 0.3, Streams(seed))[0] for seed in range(400)])
    assert biases.std() == pytest.approx(0.3, rel=0.1)


def test_noise_of_the_gyro_does_not_depend_on_the_accelerometer(path):
    times = np.arange(0.0, 1.0, 0.005)
    quiet = measure(path, unit(gyro_noise_density=1e-3), times, Streams(9))[0]
    loud = measure(path, unit(gyro_noise_density=1e-3, accel_noise_density=1.0), times, Streams(9))[0]
    assert np.array_equal(quiet, loud)
