"""Online calibration of gtsam_vi: lens, mount, clock as variables; rows that are read late; what pictures share."""

from __future__ import annotations

import dataclasses

import gtsam
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.sensors.uncertainty import moved
from oysterbench.sequence.types import CameraCalibration, ImuMeasurement, Uncertainty
from oysterbench_baselines.common.inertial import SampleBuffer, Segment
from oysterbench_baselines.gtsam_vi import GtsamViSettings
from oysterbench_baselines.gtsam_vi.calibration import CameraUncertainty, Optics
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.clock import clocked, moved_on, moved_on_slopes
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import (
    FeatureTracks,
    FrontEnd,
    Translation,
    agree_with,
    epipolar_inliers,
    undistort,
)
from oysterbench_baselines.gtsam_vi.preintegration import inertial_factor, preintegration_params
from oysterbench_baselines.gtsam_vi.settings import NoiseSettings, RecoverySettings
from oysterbench_baselines.gtsam_vi.states import Rates, State, coast, insert_state, make_state
from tests.baselines.test_gtsam_vi import position_error
from tests.helpers import synthetic_dive as dive

SIGMAS = {
    "focal_x_px": 2.3,
    "principal_x_px": 3.5,
    "principal_y_px": 3.5,
    "k1": 0.01,
    **{f"rotation_{axis}_rad": 0.006 for axis in "xyz"},
    **{f"position_{axis}_m": 0.005 for axis in "xyz"},
}
CLOCK_SIGMA = 0.02


def stated() -> Uncertainty:
    """Of one camera `cam`, both focal lengths erring by the same, and of its clock."""
    names = [*(f"cam.{name}" for name in SIGMAS), "cam.focal_y_px", "cameras.time_offset_s"]
    causes = np.diag([*SIGMAS.values(), 0.0, CLOCK_SIGMA])
    causes[-2, 0] = SIGMAS["focal_x_px"]
    return Uncertainty(tuple(names), causes @ causes.T)


def miscalibrated(camera: CameraCalibration, rng: np.random.Generator) -> CameraCalibration:
    """As it is given where it errs as stated."""
    errors = {name: rng.normal() * sigma for name, sigma in SIGMAS.items()}
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[0, 0] += errors["focal_x_px"]
    matrix[1, 1] += errors["focal_x_px"]
    matrix[:2, 2] += errors["principal_x_px"], errors["principal_y_px"]
    distortion[0] += errors["k1"]
    return dataclasses.replace(
        camera, matrix=matrix, distortion=distortion, T_base_cam=moved(camera.T_base_cam, errors)
    )


def estimate_late(
    measured: dive.Dive,
    camera: CameraCalibration,
    known: CameraUncertainty | None,
    late_s: float,
    settings: GtsamViSettings | None = None,
) -> Estimator:
    """An estimator that is given a calibration, and pictures whose stamps are late."""
    settings = settings or GtsamViSettings()
    estimator, samples = Estimator([camera], measured.inertial, settings, uncertainty=known), SampleBuffer()
    late = round(late_s * 1e9)
    items = [(item.stamp_ns, 0, item) if isinstance(item, ImuMeasurement) else (item[0] + late, 1, item)
             for item in measured.stream()]  # fmt: skip
    for stamp, _, item in sorted(items, key=lambda timed: timed[:2]):
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        _, ids, pixels = item
        estimator.propagate(samples.cut(stamp))
        estimator.step(stamp, FeatureTracks(ids, pixels, undistort(pixels, camera)))
    estimator.finish()
    return estimator


def truth_at(stamps_ns: NDArray[np.int64]) -> Trajectory:
    poses = dive.survey_pose(np.asarray(stamps_ns - dive.START_NS, dtype=float) * 1e-9)
    return Trajectory(stamps_ns, poses[:, :3, 3].copy(), Rotation.from_matrix(poses[:, :3, :3]).as_quat())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_calibration_that_errs_as_it_states_is_mended_on_the_way(seed):
    measured, late_s = dive.make_dive(seed), 0.015
    camera = miscalibrated(measured.camera, np.random.default_rng(seed + 50))
    known = CameraUncertainty.of(stated(), ["cam"], [camera])
    blind, mending = (estimate_late(measured, camera, what, late_s) for what in (None, known))
    errors = {}
    for name, estimator in (("blind", blind), ("mending", mending)):
        for path in ("online", "smoothed"):
            trajectory = getattr(estimator, path)()
            errors[name, path] = position_error(truth_at(trajectory.stamps_ns), trajectory)
    assert errors["mending", "smoothed"] < 0.5 * errors["blind", "smoothed"]
    assert errors["mending", "smoothed"] < 0.002 * measured.truth.path_length
    assert errors["mending", "online"] < errors["blind", "online"]
    assert mending.model.rig.clock_s == pytest.approx(late_s, abs=0.002)
    found = mending.model.rig.T_imu_cam @ invert(invert(measured.inertial.T_base_imu) @ measured.camera.T_base_cam)
    given = blind.model.rig.T_imu_cam @ invert(invert(measured.inertial.T_base_imu) @ measured.camera.T_base_cam)
    assert Rotation.from_matrix(found[:3, :3]).magnitude() < 0.7 * Rotation.from_matrix(given[:3, :3]).magnitude()


def test_the_prior_is_the_covariance_of_what_is_true_about_what_is_given():
    camera, rng = dive.camera_calibration(), np.random.default_rng(0)
    T_imu_base = invert(dive.imu_calibration().T_base_imu)
    known = CameraUncertainty.of(stated(), ["cam"], [camera])
    assert known is not None
    assert known.clock_sigma == CLOCK_SIGMA
    true = Optics.of(camera, T_imu_base)
    draws = []
    for _ in range(4000):
        given = Optics.of(miscalibrated(camera, rng), T_imu_base)
        draws.append(np.concatenate([given.mount.localCoordinates(true.mount), true.lens - given.lens]))
    sigma = np.sqrt(np.diag(known.covariance))
    scale = np.outer(sigma, sigma)
    stated_size = sigma > 1e-3
    found = (np.cov(np.array(draws).T) / scale)[np.ix_(stated_size, stated_size)]
    np.testing.assert_allclose(found, (known.covariance / scale)[np.ix_(stated_size, stated_size)], atol=0.08)
    # Of a true camera drawn so, the prior's error is that of white noise.
    given = Optics.of(miscalibrated(camera, rng), T_imu_base)
    values = gtsam.Values()
    true.insert(values, 0)
    (prior, clock) = known.prior([given])
    assert prior.error(values) < 0.5 * 40
    values.insert(clock.keys()[0], np.array([2 * CLOCK_SIGMA]))
    assert clock.error(values) == pytest.approx(2.0)


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_views_of_a_camera_that_is_a_variable_say_what_those_of_a_fixed_one_say(model):
    """And its rays change with the lens as the pixels would have it."""
    camera = dataclasses.replace(
        dive.camera_calibration(), distortion_model=model, distortion=np.array([0.1, -0.05, 1e-3, 5e-4])
    )
    imu, rng = dive.imu_calibration(), np.random.default_rng(1)
    names = [f"cam.{name}" for name in SIGMAS]
    known = CameraUncertainty.of(Uncertainty(tuple(names), np.diag(list(SIGMAS.values())) ** 2), ["cam"], [camera])
    fixed, free = CameraRig([camera], imu), CameraRig([camera], imu, known)
    assert free.clock_s == 0.0
    points = np.column_stack([rng.uniform(1.5, 3.0, 40), rng.uniform(-1, 1, 40), rng.uniform(-1.8, -0.8, 40)])
    rays = np.array([(invert(fixed.T_imu_cam) @ [*point, 1])[:3] for point in points])
    rays = rays[:, :2] / rays[:, 2:] + rng.normal(0, 1e-3, (40, 2))
    views = [0] * 40, range(40), rays, np.zeros(40, dtype=np.intp)
    values = gtsam.Values()
    values.insert(gtsam.symbol("x", 0), gtsam.Pose3())
    for n, point in enumerate(points):
        values.insert(gtsam.symbol("l", n), point)
    free.insert(values)
    noise = NoiseSettings()
    pairs = zip(
        fixed.projection_factors(*views, [fixed.pixel_noise(noise)] * 40),
        free.projection_factors(*views, [free.pixel_noise(noise)] * 40),
        strict=True,
    )
    for of_ray, of_pixel in pairs:  # a pixel is a little more or less than a focal length's share away from the axis
        assert np.linalg.norm(of_pixel.unwhitenedError(values)) == pytest.approx(
            fixed.focal * np.linalg.norm(of_ray.unwhitenedError(values)), rel=0.4
        )
    errors = free.errors_px(np.eye(4), points, rays)
    np.testing.assert_allclose(errors, fixed.errors_px(np.eye(4), points, rays))
    changed = gtsam.Values()
    dataclasses.replace(free._optics[0], lens=free._optics[0].lens + 5.0 * np.eye(9)[3]).insert(changed, 0)
    free.read(changed)
    seen = cv_rays(rays, camera, free)
    np.testing.assert_allclose(free._now(rays, 0), seen, atol=1e-9)
    assert np.median(np.abs(seen - rays)[:, 0]) == pytest.approx(5.0 / fixed.focal, rel=0.3)


def cv_rays(rays: Array, camera: CameraCalibration, rig: CameraRig) -> Array:
    from oysterbench_baselines.gtsam_vi.frontend import distort

    return undistort(distort(rays, camera), rig._lenses[0])


def test_what_is_not_stated_or_cannot_be_modelled_is_left_alone():
    camera = dive.camera_calibration()
    assert CameraUncertainty.of(None, ["cam"], [camera]) is None
    assert CameraUncertainty.of(stated(), ["other"], [camera]).clock_sigma == CLOCK_SIGMA
    assert CameraUncertainty.of(Uncertainty(("dvl.scale",), np.eye(1)), ["cam"], [camera]) is None
    third = dataclasses.replace(camera, distortion=np.zeros(5))
    assert CameraUncertainty.of(stated(), ["cam"], [third]) is None


def some_state(rng: np.random.Generator) -> State:
    rotation = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    return make_state(rotation, *rng.normal(size=(2, 3)), *rng.normal(0, 0.01, (2, 3)))


def test_slopes_of_a_state_moved_on_are_the_numerical_ones():
    rng, step = np.random.default_rng(0), 1e-6
    state, rates, time = some_state(rng), Rates(rng.normal(size=3), rng.normal([0, 0, 9.8], 3)), 0.02
    after, slope, by_time = moved_on_slopes(state, time, rates, 9.8)

    def off(other: State) -> Array:
        pose = after.nav.pose().localCoordinates(other.nav.pose())
        return np.concatenate([pose, other.nav.velocity() - after.nav.velocity()]) / step

    for column in range(9):
        nudge = np.zeros(9)
        nudge[column] = step
        nudged = State(
            gtsam.NavState(state.nav.pose().retract(nudge[:6]), state.nav.velocity() + nudge[6:]), state.bias
        )
        np.testing.assert_allclose(slope[:, column], off(moved_on(nudged, time, rates, 9.8)), atol=1e-3)
    later = off(moved_on(state, time + step, rates, 9.8))
    np.testing.assert_allclose(by_time, later, atol=0.2 * time * 10)  # turn and force change a little on the way


def test_a_clocked_factor_at_no_delay_is_the_inertial_one():
    rng = np.random.default_rng(2)
    segment = Segment(np.full(40, 5e-3), rng.normal(0, 0.2, (40, 3)), rng.normal([0, 0, 9.8], 0.5, (40, 3)))
    state = some_state(rng)
    plain = inertial_factor(0, 1, segment, state.bias, preintegration_params(dive.imu_calibration(), NoiseSettings()))
    key = gtsam.symbol("t", 0)
    rates = Rates(segment.gyro[-1], segment.accel[-1])
    factor, values = clocked(plain, key, (rates, rates), 9.80665), gtsam.Values()
    insert_state(values, 0, state)
    insert_state(values, 1, some_state(rng))
    values.insert(key, np.zeros(1))
    assert factor.error(values) == pytest.approx(plain.error(values))
    ours, theirs = factor.linearize(values).jacobian(), plain.linearize(values).jacobian()
    np.testing.assert_allclose(ours[0][:, :30], theirs[0], rtol=1e-6, atol=1e-6 * np.abs(theirs[0]).max())
    np.testing.assert_allclose(ours[1], theirs[1])


def texture(size: tuple[int, int] = (600, 1200), seed: int = 0) -> Array:
    import cv2

    noise = np.random.default_rng(seed).normal(size=size).astype(np.float32)
    fine = cv2.GaussianBlur(noise, (0, 0), 3)
    return 110 + 25 * fine / fine.std()


def test_rows_that_are_read_late_are_taken_back_to_the_stamp():
    """A bottom that passes from right to left: its lower rows have gone farther when they are read."""
    camera = dataclasses.replace(dive.camera_calibration(), readout_s=0.03)
    picture, front_end, speed = texture(), FrontEnd(camera, GtsamViSettings().frontend), 60.0  # px/s
    tracks = None
    for frame in range(4):
        begin = round(speed * 0.1 * frame)
        now = picture[:480, begin : begin + 640].astype(np.uint8)
        tracks = front_end.track(now, np.eye(3), 0.1 if frame else 0.0)
    assert tracks is not None
    assert tracks.rolled is not None
    late = (tracks.pixels[:, 1] / 479 - 0.5) * 0.03
    np.testing.assert_allclose(tracks.rolled[:, 0] * camera.matrix[0, 0], -speed * late, atol=0.1)
    np.testing.assert_allclose(tracks.rolled[:, 1] * camera.matrix[1, 1], 0.0, atol=0.1)
    np.testing.assert_allclose(tracks.at_stamp, tracks.rays - tracks.rolled)


def test_hot_pixels_and_spots_on_the_port_get_no_corners_once_they_are_known():
    import cv2

    picture, rng = texture((600, 3000), 1), np.random.default_rng(3)
    spots = rng.uniform([40, 40], [600, 440], (25, 2))
    dirt = np.zeros((480, 640), dtype=np.float32)
    for x, y in spots:
        cv2.circle(dirt, (round(x), round(y)), 4, 1.0, -1)
    dirt = cv2.GaussianBlur(dirt, (0, 0), 1.5)
    front_end, tracks = FrontEnd(dive.camera_calibration(), GtsamViSettings().frontend), None

    def on_spots() -> float:
        apart = np.linalg.norm(tracks.pixels[:, None] - spots[None], axis=2).min(axis=1)
        return float((apart < 6).mean())

    shares = []
    for frame in range(70):
        begin = 20 * frame
        seen = 0.15 * (picture[:480, begin : begin + 640] - 110) + 110  # a bottom that is fainter than the dirt
        tracks = front_end.track(np.clip(seen - 60 * dirt, 0, 255).astype(np.uint8), np.eye(3), 0.1)
        shares.append(on_spots())
    assert np.mean(shares[5:15]) > 0.1
    assert np.mean(shares[-10:]) < 0.3 * np.mean(shares[5:15])


def test_what_drifts_with_the_water_is_told_from_the_bottom_by_how_the_vehicle_moves():
    """Three of four tracks are of silt that a current carries: a consensus of tracks takes it for the bottom."""
    rng = np.random.default_rng(5)
    bottom = np.column_stack([rng.uniform(-0.6, 0.6, (50, 2)), rng.uniform(0.8, 1.6, 50)])
    silt = np.column_stack([rng.uniform(-0.3, 0.3, (150, 2)), rng.uniform(0.4, 0.8, 150)])
    moved, drift = np.array([0.03, 0.0, 0.02]), np.array([0.0, 0.015, 0.0])
    turn = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()  # R_after_before
    points = np.concatenate([bottom, silt])
    later = (points + np.concatenate([np.zeros((50, 3)), np.tile(drift, (150, 1))]) - moved) @ turn.T
    before, after = points[:, :2] / points[:, 2:], later[:, :2] / later[:, 2:]
    after = after + rng.normal(0, 5e-4, after.shape)
    kept = agree_with(Translation(moved, 0.0005), before, after, turn, 3e-3, 3.0)
    assert kept[:50].mean() > 0.95
    assert kept[50:].mean() < 0.1
    of_consensus = epipolar_inliers(before, after, turn, 3e-3, 64, rng)
    assert of_consensus[50:].mean() > 0.8
    # Of a vehicle that hardly moves, or nobody knows how, it says nothing; nor of one that goes back against its track.
    assert agree_with(Translation(moved, 0.05), before, after, turn, 3e-3, 3.0).all()
    assert not agree_with(Translation(-moved, 0.0005), before, after, turn, 3e-3, 3.0)[:50].any()


def turning(duration_s: float, rate: float) -> Segment:
    """Inertial measurements at a rate (rad/s) about z, with forces that are not to be believed."""
    count = round(duration_s / 0.01)
    return Segment(np.full(count, 0.01), np.tile([0.0, 0.0, rate], (count, 1)), np.full((count, 3), 7.0))


def test_a_state_of_which_nothing_is_known_but_its_turns_slows_down():
    rotation = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    bias = np.array([0.0, 0.0, 0.01])
    state = make_state(rotation, np.array([1.0, 2.0, -3.0]), np.array([0.4, 0.0, 0.1]), bias, np.zeros(3))
    soon, later = coast(state, turning(0.1, 0.01), 2.0), coast(state, turning(60.0, 0.06), 2.0)
    np.testing.assert_allclose(soon.nav.position(), [1.04, 2.0, -2.99], atol=0.002)
    np.testing.assert_allclose(soon.nav.attitude().matrix(), rotation, atol=1e-12)
    np.testing.assert_allclose(later.nav.position(), [1.8, 2.0, -2.8], atol=1e-6)  # as far as in 2 s at full speed
    assert np.linalg.norm(later.nav.velocity()) < 1e-6
    turned = Rotation.from_matrix(rotation.T @ later.nav.attitude().matrix()).as_rotvec()
    np.testing.assert_allclose(turned, [0.0, 0.0, 60.0 * 0.05], atol=1e-9)


def test_what_is_not_measured_is_no_faster_than_what_was():
    model = Estimator([dive.camera_calibration()], dive.imu_calibration(), GtsamViSettings()).model
    unknown = model.usual_speed
    assert unknown == model.settings.recovery.unknown_speed
    for _ in range(20):
        model.note_speed(0.2)
    assert model.usual_speed == pytest.approx(0.2)
    for _ in range(20):
        model.note_speed(1.4)
    assert model.usual_speed == pytest.approx(1.0)


@pytest.mark.slow
def test_it_does_not_run_away_while_there_is_nothing_to_see():
    """Half a minute by a unit whose biases have moved: it ends within reach of where it is, not at sea."""
    measured = dive.make_dive(3, duration_s=40.0, blind=(10.0, 38.0))
    moved_bias = np.array([0.03, -0.02, 0.0])
    for k, sample in enumerate(measured.samples):
        if sample.stamp_ns > dive.START_NS + 10_000_000_000:
            measured.samples[k] = ImuMeasurement(sample.stamp_ns, sample.gyro, sample.accel + moved_bias)
    estimator = estimate_late(measured, measured.camera, None, 0.0)
    path = estimator.online()
    assert any(keyframe.blind for keyframe in estimator.keyframes)
    assert "restarts" not in estimator.info  # by the unit alone it is faster than any vehicle after 20 s, and given up
    assert np.linalg.norm(path.positions - path.positions[0], axis=1).max() < 8.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_what_is_seen_again_and_fits_no_point_ends_the_blindness(seed):
    """After 12 s by a unit whose biases have moved, triangulation fits nothing until the velocity is found anew."""
    measured = dive.make_dive(seed, duration_s=30.0, blind=(8.0, 20.0))
    moved_bias = np.array([0.12, -0.09, 0.0])
    for k, sample in enumerate(measured.samples):
        if sample.stamp_ns > dive.START_NS + 8_000_000_000:
            measured.samples[k] = ImuMeasurement(sample.stamp_ns, sample.gyro, sample.accel + moved_bias)

    def seen_again_s(**recovery):
        settings = GtsamViSettings(recovery=RecoverySettings(**recovery))
        estimator = estimate_late(measured, measured.camera, None, 0.0, settings)
        times_s = [(k.stamp_ns - dive.START_NS) * 1e-9 for k in estimator.keyframes if not k.blind]
        return min((time for time in times_s if time > 20.0), default=np.inf)

    found = seen_again_s()
    assert found < 24.0
    assert found < seen_again_s(max_misfits=10**6) - 1.0
