"""The inertial unit, held against its own physics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import GRAVITY
from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.scene.path import build_path
from oysterbench.sensors.imu import (
    IMU_GRADES,
    ImuRecipe,
    Triad,
    digitise,
    errors,
    gauss_markov,
    ideal_imu,
    imu_pose,
    measure,
    random_walk,
    read_out,
    with_grade,
)
from oysterbench.sensors.vibration import VibrationRecipe


def hills(x, y):
    return -4.0 + 0.2 * np.sin(x) * np.cos(0.7 * y)


@pytest.fixture(scope="module")
def path():
    recipe = dataclasses.replace(load_split("slam-mini").sequence[0], duration_s=60.0)
    return build_path(recipe, hills, hills, Streams(7, b"", ("test",)))


def unit(**changes):
    quiet = {"gyro_noise_density": 0, "gyro_random_walk": 0, "accel_noise_density": 0, "accel_random_walk": 0}
    values = {"rate_hz": 200.0, "position_m": (0.3, -0.2, 0.1), "rpy_deg": (10.0, -20.0, 130.0)}
    return ImuRecipe(**{**quiet, **values, **changes})


def graded(grade, rate_hz):
    return ImuRecipe(**with_grade({"grade": grade, "rate_hz": rate_hz}))


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


def test_integrating_the_ideal_unit_for_a_minute_gives_the_path_back_within_a_centimetre(path):
    recipe = unit()
    times = np.arange(0.0, 60.0, 1 / recipe.rate_hz)
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
    assert np.ptp(motion.position, axis=0)[:2].min() > 1.0  # a path worth the name


def test_a_unit_at_rest_feels_gravity_upwards():
    recipe = unit(position_m=(0.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 0.0))
    still = load_split("slam-mini").sequence[0]
    motion = build_path(still, hills, hills, Streams(3)).at(np.zeros(1))
    gyro, accel = ideal_imu(motion, imu_pose(recipe))
    assert np.allclose(gyro, 0.0, atol=1e-3)
    assert np.allclose(motion.rotation[0] @ accel[0], [0.0, 0.0, GRAVITY], atol=1e-2)


def allan_variance(samples, spans):
    """Overlapping Allan variance (len(spans), K) of samples (N, K), over spans counted in samples."""
    sums = np.concatenate([np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0)])
    means = [(sums[span:] - sums[:-span]) / span for span in spans]
    return np.array(
        [np.mean((mean[span:] - mean[:-span]) ** 2, axis=0) / 2 for mean, span in zip(means, spans, strict=True)]
    )


def fit_allan(spans_s, variance, tau_s):
    """Density of the white noise and sigma of the Gauss-Markov process whose Allan variances add up to this one.

    IEEE 952-1997, annex C: N^2 / T, and 2 sigma^2 tau / T (1 - tau / 2T (3 - 4 exp(-T / tau) + exp(-2 T / tau))).
    Weighted least squares: the share by which a variance scatters grows with the root of its span.
    """
    t = tau_s / spans_s
    markov = 2 * t * (1 - t / 2 * (3 - 4 * np.exp(-1 / t) + np.exp(-2 / t)))
    weight = 1 / (variance * np.sqrt(spans_s))
    squares = np.linalg.lstsq(np.column_stack([1 / spans_s, markov]) * weight[:, None], variance * weight)[0]
    return np.sqrt(squares)


def hours_of(recipe, which, hours):
    """Allan variances (10, 3 * hours) of so many hours of a resting unit, over 1 to 512 s."""
    spans = 2 ** np.arange(10)
    per_second, found = int(recipe.rate_hz), []
    for seed in range(hours):
        samples = read_out(np.zeros((3600 * per_second, 3)), recipe, which, Streams(seed).at("imu"))
        found.append(allan_variance(samples.reshape(3600, per_second, 3).mean(axis=1), spans))
    return spans, np.concatenate(found, axis=1)


@pytest.mark.parametrize("which", ["gyro", "accel"])
@pytest.mark.parametrize(
    ("grade", "rate_hz", "hours"),
    [
        ("low", 20, 60),
        *(
            pytest.param(*grade, marks=pytest.mark.slow)
            for grade in (("mid", 20, 60), ("high", 20, 60), ("mems", 200, 12))
        ),
    ],
)
def test_allan_deviation_gives_the_grade_back_within_a_tenth(grade, rate_hz, hours, which):
    """Fitted to the mean over records of one hour, because an hour holds 18 correlation times of the bias.

    One axis of one record scatters by 1 to 3 % (1 sigma) in the white noise; in the instability by 4 to 11 % for high,
    9 to 17 % for low, mems and mid's gyroscopes, and 30 to 40 % for mid's accelerometers, whose noise hides it. The
    mean over all scatters by at most 3 %. mems is read with its 16 bits, at a rate where its noise hides their steps.
    """
    recipe = graded(grade, float(rate_hz))
    triad = Triad.of(recipe, which)
    spans, variance = hours_of(recipe, which, hours)
    white, instability = fit_allan(spans.astype(float), variance.mean(axis=1), triad.bias_tau_s)
    assert white == pytest.approx(triad.noise_density, rel=0.1)
    assert instability == pytest.approx(triad.bias_instability, rel=0.1)


def test_one_hour_of_one_unit_gives_its_white_noise_back():
    for grade in IMU_GRADES:
        recipe = graded(grade, 200.0)
        spans, variance = hours_of(recipe, "gyro", 1)
        white, _ = fit_allan(spans.astype(float), variance.mean(axis=1), recipe.gyro_bias_tau_s)
        assert white == pytest.approx(recipe.gyro_noise_density, rel=0.1)


def test_white_noise_has_the_density_asked_for():
    samples = errors(40_000, 1 / 200, Triad(noise_density=1e-3), Streams(5))
    assert samples.std() == pytest.approx(1e-3 * np.sqrt(200), rel=0.01)
    assert np.corrcoef(samples[:-1, 0], samples[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.02)


def test_bias_starts_at_its_turn_on_value_and_walks_with_the_root_of_time():
    walks = np.stack([random_walk(2001, 0.01, 2e-3, Streams(seed).generator("walk"))[:, 0] for seed in range(400)])
    assert np.all(walks[:, 0] == 0.0)
    assert walks[:, 500].std() == pytest.approx(2e-3 * np.sqrt(5.0), rel=0.12)
    assert walks[:, 2000].std() == pytest.approx(2e-3 * np.sqrt(20.0), rel=0.12)
    turned_on = Triad(noise_density=0.0, turn_on=0.3, random_walk=1e-3)
    biases = np.concatenate([errors(2, 0.01, turned_on, Streams(seed))[0] for seed in range(400)])
    assert biases.std() == pytest.approx(0.3, rel=0.1)


def test_instability_of_the_bias_is_stationary_from_its_first_sample_and_forgets_within_its_time():
    records = np.concatenate(
        [gauss_markov(401, 1.0, 2e-4, 100.0, Streams(seed).generator("b")) for seed in range(1000)], axis=1
    )
    for k in (0, 1, 100, 400):
        assert records[k].std() == pytest.approx(2e-4, rel=0.05)
    for lag in (50, 100, 200):
        assert np.corrcoef(records[0], records[lag])[0, 1] == pytest.approx(np.exp(-lag / 100), abs=0.05)


def test_a_sample_does_not_depend_on_how_long_the_sequence_goes_on():
    recipe = graded("mems", 200.0)
    long, short = (read_out(np.zeros((n, 3)), recipe, "gyro", Streams(4)) for n in (5000, 1200))
    assert np.array_equal(long[:1200], short)


def test_noise_of_the_gyro_does_not_depend_on_the_accelerometer(path):
    times = np.arange(0.0, 1.0, 0.005)
    quiet = measure(path, unit(gyro_noise_density=1e-3), times, Streams(9))[0]
    loud = measure(path, unit(gyro_noise_density=1e-3, accel_noise_density=1.0), times, Streams(9))[0]
    assert np.array_equal(quiet, loud)


def test_switching_one_error_on_adds_it_and_changes_no_other():
    still = np.zeros((500, 3))
    shake = VibrationRecipe(on="gyro", kind="white", level=(0.1, 0.2, 0.3))
    terms = (
        {"gyro_noise_density": 1e-3},
        {"gyro_random_walk": 1e-3},
        {"gyro_turn_on": 0.1},
        {"gyro_bias_instability": 0.05},
        {"vibration": (shake,)},
    )
    alone = [read_out(still, unit(**term), "gyro", Streams(2)) for term in terms]
    together = read_out(still, unit(**{k: v for term in terms for k, v in term.items()}), "gyro", Streams(2))
    assert all(np.any(readings != 0) for readings in alone)
    assert together == pytest.approx(sum(alone), abs=1e-12)


def test_no_two_errors_draw_the_same_numbers():
    still, white = np.zeros((20_000, 3)), {"kind": "white", "level": (1.0, 1.0, 1.0)}
    shakes = tuple(VibrationRecipe(on=on, **white) for on in ("gyro", "gyro", "accel"))
    noises = [read_out(still, unit(gyro_noise_density=1.0), "gyro", Streams(2))]
    noises.append(read_out(still, unit(accel_noise_density=1.0), "accel", Streams(2)))
    noises.append(np.diff(read_out(still, unit(gyro_random_walk=1.0), "gyro", Streams(2)), axis=0, append=0.0))
    noises.append(read_out(still, unit(vibration=shakes[:1]), "gyro", Streams(2)))
    noises.append(read_out(still, unit(vibration=shakes[:2]), "gyro", Streams(2)) - noises[-1])
    noises.append(read_out(still, unit(vibration=shakes), "accel", Streams(2)))
    columns = np.column_stack([noise[:-1] for noise in noises])
    assert np.corrcoef(columns.T) == pytest.approx(np.eye(columns.shape[1]), abs=0.04)


def test_scale_and_misalignment_are_linear_in_the_truth_and_as_large_as_asked_for():
    recipe = unit(accel_scale=0.01, accel_misalignment_deg=0.5)
    gains = np.stack([read_out(np.eye(3), recipe, "accel", Streams(seed)).T for seed in range(300)])
    diagonal = np.eye(3, dtype=bool)
    assert gains[:, diagonal].mean() == pytest.approx(1.0, abs=2e-3)
    assert gains[:, diagonal].std() == pytest.approx(0.01, rel=0.1)
    assert gains[:, ~diagonal].std() == pytest.approx(np.radians(0.5), rel=0.1)
    truth = np.array([[1.0, -2.0, 3.0], [-9.8, 0.1, 0.0]])
    assert read_out(truth, recipe, "accel", Streams(5)) == pytest.approx(truth @ gains[5].T)


def test_readings_stop_at_the_range_and_come_in_steps():
    triad = Triad(noise_density=0.0, range=2.0, step=0.25)
    truth = np.array([[-7.0, -2.1, -1.99], [0.12, 0.13, 1.0], [1.87, 1.9, 50.0]])
    assert np.array_equal(digitise(truth, triad), [[-2.0, -2.0, -2.0], [0.0, 0.25, 1.0], [1.75, 2.0, 2.0]])
    ramp = np.linspace(-1.9, 1.9, 30_001)[:, None]
    assert np.sqrt(np.mean((digitise(ramp, triad) - ramp) ** 2)) == pytest.approx(0.25 / np.sqrt(12), rel=0.01)


def test_a_mems_unit_saturates_and_counts_as_its_words_do():
    recipe = graded("mems", 200.0)
    spin = read_out(np.full((10, 3), np.radians(2500.0)), recipe, "gyro", Streams(1))
    assert np.degrees(spin) == pytest.approx(2000.0)
    counts = read_out(np.full((500, 3), 3.0), recipe, "accel", Streams(1)) / (GRAVITY / 2048)
    assert counts == pytest.approx(np.rint(counts), abs=1e-6)
    assert len(np.unique(np.rint(counts))) > 5
