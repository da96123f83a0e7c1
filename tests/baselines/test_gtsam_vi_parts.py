"""The parts of the visual-inertial baseline, each against what is known of it."""

from __future__ import annotations

import dataclasses

import cv2
import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import invert
from oysterbench.methods import seed_of
from oysterbench.sequence.types import ImuMeasurement
from oysterbench_baselines.common.inertial import SampleBuffer, Segment, integrate
from oysterbench_baselines.gtsam_vi import GtsamVi, GtsamViStereo
from oysterbench_baselines.gtsam_vi.closed_form import closed_form_start, level_rotation
from oysterbench_baselines.gtsam_vi.covariance import discounted, filter_slopes, joint_covariance
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import (
    FrontEnd,
    Observations,
    epipolar_inliers,
    find_corners,
    undistort,
)
from oysterbench_baselines.gtsam_vi.graph import nested_dissection
from oysterbench_baselines.gtsam_vi.marginals import marginal_covariances
from oysterbench_baselines.gtsam_vi.pictures import even_contrast, without_veil
from oysterbench_baselines.gtsam_vi.preintegration import (
    preintegrate,
    preintegration_params,
)
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings, NoiseSettings
from oysterbench_baselines.gtsam_vi.states import insert_state, make_state, read_state
from tests.baselines.test_gtsam_vi import estimate
from tests.helpers import synthetic_dive as dive


def texture(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(480, 640)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 + cv2.GaussianBlur(noise, (0, 0), 5) * 5
    return np.clip(110 + 40 * smooth, 0, 255).astype(np.uint8)


def test_tracks_follow_a_picture_that_a_rotation_warps():
    calibration = dive.camera_calibration()
    front_end = FrontEnd(calibration, GtsamViSettings().frontend)
    picture = texture()
    before = front_end.track(picture, np.eye(3))
    turn = Rotation.from_euler("xyz", [0.01, -0.015, 0.02]).as_matrix()  # R_before_now
    homography = calibration.matrix @ turn.T @ np.linalg.inv(calibration.matrix)
    after = front_end.track(cv2.warpPerspective(picture, homography, (640, 480)), turn)
    _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
    expected = homogeneous(before.pixels[a]) @ homography.T
    error = np.linalg.norm(expected[:, :2] / expected[:, 2:] - after.pixels[b], axis=1)
    assert len(a) > 0.8 * len(before.ids)
    assert np.median(error) < 0.1
    assert error.max() < 1.5


def test_a_large_rotation_is_followed_when_the_gyroscope_has_seen_it():
    calibration = dive.camera_calibration()
    turn = Rotation.from_euler("y", 0.2).as_matrix()  # 95 px
    homography = calibration.matrix @ turn.T @ np.linalg.inv(calibration.matrix)
    picture = texture()
    front_end = FrontEnd(calibration, GtsamViSettings().frontend)
    before = front_end.track(picture, np.eye(3))
    after = front_end.track(cv2.warpPerspective(picture, homography, (640, 480)), turn)
    assert len(np.intersect1d(before.ids, after.ids)) > 0.5 * len(before.ids)


def test_a_picture_without_texture_gives_no_tracks():
    front_end = FrontEnd(dive.camera_calibration(), GtsamViSettings().frontend)
    grey = np.full((480, 640, 3), 90, dtype=np.uint8)
    for _ in range(3):
        assert len(front_end.track(grey, np.eye(3)).ids) == 0


def equalise(picture: np.ndarray) -> np.ndarray:
    settings = GtsamViSettings().frontend
    return even_contrast(without_veil(picture.astype(np.uint8), settings), settings)


def test_a_veil_of_scattered_light_and_a_lamps_cone_are_taken_away():
    """The same texture with a tenth of its contrast, under a veil that brightens across the picture, looks the same."""
    picture = texture().astype(float)
    veil = 60 + 80 * np.linspace(0, 1, 640)[None, :]
    clear = equalise(np.clip(picture, 0, 255)).astype(float)
    murky = equalise(np.clip(0.3 * (picture - 110) + veil, 0, 255)).astype(float)
    inner = (slice(60, -60), slice(60, -60))
    assert np.corrcoef(clear[inner].ravel(), murky[inner].ravel())[0, 1] > 0.98
    assert 0.7 < murky[inner].std() / clear[inner].std() < 1.05


def test_noise_of_the_sensor_is_not_lifted_to_texture():
    noise = np.random.default_rng(0).normal(size=(480, 640))
    dark = np.clip(20 + noise, 0, 255).astype(np.uint8)
    assert equalise(dark).std() < 0.4 * equalise(texture()).std()


def test_the_seed_is_that_of_the_random_samples():
    first, same, other = (FrontEnd(dive.camera_calibration(), GtsamViSettings().frontend, seed) for seed in (1, 1, 2))
    draws = [front_end._generator.integers(0, 1 << 30, 4).tolist() for front_end in (first, same, other)]
    assert draws[0] == draws[1] != draws[2]
    assert seed_of(GtsamVi(seed=7)) == seed_of(GtsamViStereo(seed=7)) == 7


def test_covariances_of_inertial_factors_are_those_of_many_draws():
    """GTSAM's covariance of rotation, position and velocity against the scatter of noisy integrations of one motion."""
    calibration, settings = dive.imu_calibration(), NoiseSettings(imu_inflation=1.0, integration_sigma=1e-6)
    samples = dive.inertial_samples(dive.survey_pose, calibration, 0.5, None)
    buffer = SampleBuffer()
    for sample in samples:
        buffer.add(sample)
    segment = buffer.cut(samples[-1].stamp_ns)
    params, bias = preintegration_params(calibration, settings), gtsam.imuBias.ConstantBias()
    clean = preintegrate(segment, bias, params)
    generator, errors = np.random.default_rng(1), []
    for _ in range(400):
        root = np.sqrt(segment.dt)[:, None]
        gyro = segment.gyro + generator.normal(size=segment.gyro.shape) * calibration.gyro_noise_density / root
        accel = segment.accel + generator.normal(size=segment.accel.shape) * calibration.accel_noise_density / root
        noisy = preintegrate(Segment(segment.dt, gyro, accel), bias, params)
        turn = gtsam.Rot3.Logmap(clean.deltaRij().between(noisy.deltaRij()))
        errors.append(np.concatenate([turn, noisy.deltaPij() - clean.deltaPij(), noisy.deltaVij() - clean.deltaVij()]))
    told = np.sqrt(np.diag(clean.preintMeasCov())[:9])
    np.testing.assert_allclose(np.std(errors, axis=0), told, rtol=0.15)


def test_the_filters_slopes_are_the_numerical_ones():
    """By moving GTSAM's variables along their tangents, and reading the right-invariant error that this makes."""
    generator = np.random.default_rng(2)
    rotation = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix()
    state = make_state(rotation, np.array([4.0, -2, 1]), np.array([0.3, 0.1, -0.2]), np.zeros(3), np.zeros(3))
    slopes = filter_slopes(state, 5)
    values = gtsam.Values()
    insert_state(values, 5, state)
    for key, slope in slopes.items():
        step = generator.normal(size=slope.shape[1]) * 1e-6
        delta = gtsam.VectorValues()
        for other, columns in slopes.items():
            delta.insert(other, step if other == key else np.zeros(columns.shape[1]))
        moved = read_state(values.retract(delta), 5)
        turned = moved.nav.attitude().matrix() @ rotation.T
        error = np.concatenate([
            Rotation.from_matrix(turned).as_rotvec(),
            moved.nav.velocity() - turned @ state.nav.velocity(),
            moved.nav.position() - turned @ state.nav.position(),
            moved.bias.gyroscope(),
            moved.bias.accelerometer(),
        ])  # fmt: skip
        np.testing.assert_allclose(slope @ step, error, atol=1e-10)


def test_a_joint_covariance_holds_the_marginals():
    generator = np.random.default_rng(3)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(4):
        values.insert(k, generator.normal(size=3))
        noise = gtsam.noiseModel.Diagonal.Sigmas(generator.uniform(0.5, 2, 3))
        graph.push_back(gtsam.PriorFactorVector(k, np.zeros(3), noise))
    pose = gtsam.Pose3()
    values.insert(10, pose)
    values.insert(11, pose)
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(generator.uniform(0.1, 1, 6))
    graph.push_back(gtsam.PriorFactorPose3(10, pose, sigmas))
    graph.push_back(gtsam.BetweenFactorPose3(10, 11, pose, sigmas))
    joint = joint_covariance(graph, values, [11, 2])
    marginals = gtsam.Marginals(graph, values)
    np.testing.assert_allclose(joint[:6, :6], marginals.marginalCovariance(11), atol=1e-9)
    np.testing.assert_allclose(joint[6:, 6:], marginals.marginalCovariance(2), atol=1e-9)
    np.testing.assert_allclose(joint[:6, 6:], 0, atol=1e-12)


def test_marginal_covariances_are_those_of_gtsam():
    """Poses in a chain that comes back to its beginning, and points that four of them see, each pass anew."""
    generator = np.random.default_rng(5)
    graph, values, steps = gtsam.NonlinearFactorGraph(), gtsam.Values(), 24
    poses = []
    for k in range(steps):
        poses.append(gtsam.Pose3(gtsam.Rot3.RzRyRx(*generator.normal(size=3) * 0.1), np.array([k % 12, 0.0, 0.0])))
        values.insert(X(k), poses[k])
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.02] * 3 + [0.1] * 3))
    graph.push_back(gtsam.PriorFactorPose3(X(0), poses[0], noise))
    for one, other in [*((k, k + 1) for k in range(steps - 1)), (2, 14), (7, 19)]:
        graph.push_back(gtsam.BetweenFactorPose3(X(one), X(other), poses[one].between(poses[other]), noise))
    views = gtsam.noiseModel.Isotropic.Sigma(2, 0.01)
    for j in range(60):
        first = int(generator.integers(0, steps - 3))
        across, up = generator.normal(size=2)
        point = np.array([first % 12 + 1.5, across, 4.0 + up])
        values.insert(L(j), point)
        for k in range(first, first + 4):
            local = poses[k].transformTo(point)
            factor = gtsam.GenericProjectionFactorCal3_S2(local[:2] / local[2], views, X(k), L(j), gtsam.Cal3_S2())
            graph.push_back(factor)
    keys = [X(k) for k in range(steps)] + [L(3)]
    ours, theirs = marginal_covariances(graph, values, keys), gtsam.Marginals(graph, values)
    assert set(ours) == set(keys)
    for key in keys:
        sigma = np.sqrt(np.diag(theirs.marginalCovariance(key)))
        scale = np.outer(sigma, sigma)
        np.testing.assert_array_equal(ours[key], ours[key].T)
        np.testing.assert_allclose(ours[key] / scale, theirs.marginalCovariance(key) / scale, atol=1e-8)


@pytest.mark.parametrize("lone", [1, 4])
@pytest.mark.parametrize("steps", [2, 3, 50, 500])
def test_every_variable_is_ordered_once_those_too_that_share_no_factor(lone, steps):
    graph, one = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    for k in range(steps - 1):
        graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), gtsam.Pose3(), one))
    for k in range(lone):
        graph.push_back(gtsam.PriorFactorPose3(gtsam.symbol("a", k), gtsam.Pose3(), one))
    ordering = nested_dissection(graph)
    keys = [ordering.at(n) for n in range(ordering.size())]
    assert sorted(keys) == sorted([X(k) for k in range(steps)] + [gtsam.symbol("a", k) for k in range(lone)])


def test_marginal_covariances_of_what_is_undetermined_are_refused():
    graph, values, one = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    for k in range(3):
        values.insert(X(k), gtsam.Pose3())
    for k in range(2):
        graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), gtsam.Pose3(), one))
    with pytest.raises(RuntimeError):
        marginal_covariances(graph, values, [X(0)])


def test_views_discounted_say_as_much_less_and_other_factors_as_much_as_before():
    """A camera between points that are known: its pose by their views, times four in variance at twice the sigma."""
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    camera, body = gtsam.Cal3_S2(), gtsam.Pose3()
    values.insert(0, body)
    loss = gtsam.noiseModel.mEstimator.Huber.Create(1.3)
    noise = gtsam.noiseModel.Robust.Create(loss, gtsam.noiseModel.Isotropic.Sigma(2, 1e-3))
    known = gtsam.noiseModel.Isotropic.Sigma(3, 1e-9)
    for k, (x, y) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1), (0.2, 0.1)], start=1):
        point = np.array([x, y, 3.0 + 0.1 * k])
        values.insert(k, point)
        graph.push_back(gtsam.PriorFactorPoint3(k, point, known))
        ray = point[:2] / point[2]
        graph.push_back(gtsam.GenericProjectionFactorCal3_S2(ray, noise, 0, k, camera, False, False, gtsam.Pose3()))
    full, less = (gtsam.Marginals(discounted(graph, times, 1.3), values) for times in (1.0, 2.0))
    np.testing.assert_allclose(less.marginalCovariance(0), 4 * full.marginalCovariance(0), rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(less.marginalCovariance(1), full.marginalCovariance(1), rtol=1e-4, atol=1e-24)


@pytest.mark.slow
def test_what_is_reported_of_errors_does_not_change_the_estimate():
    measured = dive.make_dive(0, duration_s=8.0)
    sure, unsure = (
        estimate(measured, GtsamViSettings(noise=NoiseSettings(correlation=times))).smoothed() for times in (1.0, 3.0)
    )
    assert sure.positions.tobytes() == unsure.positions.tobytes()
    ratio = np.sqrt(unsure.covariances[-1].diagonal() / sure.covariances[-1].diagonal())
    assert (ratio[:3] > 1.3).all()
    assert (ratio < 3.01).all()


def test_corners_are_spread_over_the_picture():
    picture = texture()
    picture[:, 320:] = (picture[:, 320:].astype(int) - 110) // 4 + 110  # the right half with a quarter of the contrast
    corners = find_corners(picture, np.empty((0, 2)), GtsamViSettings().frontend)
    right = int(np.sum(corners[:, 0] >= 320))
    assert 0.4 * len(corners) < right < 0.6 * len(corners)


def test_distortion_is_taken_out_of_the_rays():
    calibration = dataclasses.replace(dive.camera_calibration(), distortion=np.array([-0.2, 0.05, 1e-3, -5e-4]))
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, size=(50, 2))
    pixels, _ = cv2.projectPoints(
        homogeneous(rays).reshape(-1, 1, 3), np.zeros(3), np.zeros(3), calibration.matrix, calibration.distortion
    )
    np.testing.assert_allclose(undistort(pixels.reshape(-1, 2), calibration), rays, atol=1e-5)


def test_the_epipolar_check_finds_what_slides_over_a_flat_scene():
    generator = np.random.default_rng(0)
    points = np.column_stack([generator.uniform(-1, 1, (100, 2)), np.full(100, 2.0)])
    turn = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()
    moved = points @ turn.T + np.array([0.1, 0.05, 0.02])
    before, after = points[:, :2] / points[:, 2:], moved[:, :2] / moved[:, 2:]
    after = after + generator.normal(size=after.shape) * 3e-4
    after[:30] += np.array([-0.03, 0.06])
    inliers = epipolar_inliers(before, after, turn, 3e-3, 64, generator)
    assert inliers[30:].all()
    assert inliers[:30].sum() <= 2


def test_the_inertial_measurements_between_two_stamps_are_cut_where_the_stamps_lie():
    samples = SampleBuffer()
    for k in range(5):  # a rate that grows by 1 rad/s in 1 s
        samples.add(ImuMeasurement(k * 10_000_000, np.full(3, k * 0.01), np.zeros(3)))
    first, second = samples.cut(15_000_000), samples.cut(40_000_000)
    assert first.duration == pytest.approx(0.015)
    assert second.duration == pytest.approx(0.025)
    assert (first.gyro[:, 0] @ first.dt) == pytest.approx(0.5 * 0.015**2)
    assert (second.gyro[:, 0] @ second.dt) == pytest.approx(0.5 * (0.04**2 - 0.015**2))


def test_our_integrals_agree_with_those_of_gtsam():
    calibration = dive.imu_calibration()
    samples = dive.inertial_samples(dive.survey_pose, calibration, 1.0, None)
    buffer = SampleBuffer()
    for sample in samples:
        buffer.add(sample)
    segment = buffer.cut(samples[-1].stamp_ns)
    ours = integrate([segment], np.zeros(3))
    params = preintegration_params(calibration, NoiseSettings())
    theirs = preintegrate(segment, gtsam.imuBias.ConstantBias(), params)
    np.testing.assert_allclose(ours.rotation[-1], theirs.deltaRij().matrix(), atol=1e-6)
    np.testing.assert_allclose(ours.velocity[-1], theirs.deltaVij(), atol=1e-5)
    np.testing.assert_allclose(ours.position[-1], theirs.deltaPij(), atol=1e-5)


def test_the_closed_form_start_finds_scale_gravity_and_gyro_bias():
    measured = dive.make_dive(0, duration_s=3.0, pixel_noise=0.0, noisy_imu=False, outliers=0.0)
    samples, views, segments, pending, stamps = SampleBuffer(), [], [], [], []
    frame = 0
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        pending.append(samples.cut(stamp))
        if frame % 3 == 0:
            views.append(Observations(ids, undistort(pixels, measured.camera)))
            segments.append(Segment.join(pending))
            stamps.append(stamp)
            pending = []
        frame += 1
    T_imu_cam = invert(measured.inertial.T_base_imu) @ measured.camera.T_base_cam
    start = closed_form_start(
        views, segments[1:], T_imu_cam[None], dive.GRAVITY, 5e-3, 5e-2, 1e-3, gtsam.imuBias.ConstantBias()
    )
    truth = measured.truth.at(np.array(stamps)).matrices @ measured.inertial.T_base_imu
    moved = np.linalg.norm(truth[-1, :3, 3] - truth[0, :3, 3])
    assert np.linalg.norm(start.positions[-1]) == pytest.approx(moved, rel=0.05)
    assert np.abs(start.gyro_bias).max() < 1e-3
    # Up in the first IMU frame, by the start and by the truth.
    assert start.rotations[0][2] @ truth[0, 2, :3] > np.cos(np.radians(0.5))


def test_level_rotation_turns_up_to_z_and_keeps_the_heading():
    up = np.array([0.3, -0.2, 0.9])
    rotation = level_rotation(up)
    np.testing.assert_allclose(rotation @ up / np.linalg.norm(up), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert rotation[1, 0] == pytest.approx(0.0)
    assert rotation[0, 0] > 0
