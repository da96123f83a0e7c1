"""What methods make of inertial data with faults: wrong units and clocks, outliers, gaps, or no motion to start."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Health
from oysterbench.sequence.types import ImuMeasurement
from oysterbench_baselines.common.alignment import StartSettings, align, first_moments
from oysterbench_baselines.common.checks import check_inertial, on_imu_clock
from oysterbench_baselines.common.filter import ATTITUDE, InertialNoise, InvariantFilter
from oysterbench_baselines.common.inertial import SampleBuffer, Segment
from oysterbench_baselines.gtsam_vi import GtsamVi, GtsamViSettings, recovery
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import NO_TRACKS, FeatureTracks, undistort
from oysterbench_baselines.gtsam_vi.recovery import Recovery
from oysterbench_baselines.gtsam_vi.states import NOTHING, Keyframe, State, coast, make_state, time_missing
from tests.baselines.test_gtsam_vi import FlatBottom, position_error
from tests.helpers import synthetic_dive as dive


def sample(stamp_s: float, gyro: float = 0.0, force: float = 9.8) -> ImuMeasurement:
    return ImuMeasurement(round(stamp_s * 1e9), np.array([gyro, 0.0, 0.0]), np.array([0.0, 0.0, force]))


# What is checked before a run.


def dive_with(change: Callable[[ImuMeasurement], ImuMeasurement], count: int = 400) -> SimpleNamespace:
    rng = np.random.default_rng(0)
    samples = [
        change(ImuMeasurement(5_000_000 * n, rng.normal(0, 0.2, 3), rng.normal([0, 0, 9.8], 0.3))) for n in range(count)
    ]
    return SimpleNamespace(name="theirs", imu=lambda: iter(samples), imu_calibration=dive.imu_calibration())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: replace(s, accel=s.accel / 9.8), r"in m/s\^2, of 9.81 mostly, got a median of 1; are they in g\?"),
        (lambda s: replace(s, accel=s.accel / 9.8e-3), r"are they in milli-g\?"),
        (lambda s: replace(s, accel=0.0 * s.accel), r"got a median of 0; are the columns"),
        (lambda s: replace(s, accel=s.gyro, gyro=s.accel), r"are the columns of the inertial samples in order"),
        (lambda s: replace(s, gyro=np.degrees(s.gyro)), r"angular rates in rad/s, got .*in deg/s\?"),
        (lambda s: replace(s, stamp_ns=s.stamp_ns // 1000), r"in ns, 200 Hz by the calibration, got 200000 Hz"),
    ],
)
def test_samples_that_no_vehicle_can_have_measured_are_refused(change, words):
    check_inertial("mine", dive_with(lambda s: s))
    with pytest.raises(MethodError, match=f"^mine: theirs: expected .*{words}"):
        check_inertial("mine", dive_with(change))


@pytest.mark.parametrize(
    "stamp_ns",
    [
        lambda n: n // 8 * 40_000_000 + n % 8,  # in bursts of eight, stamped on arrival
        lambda n: n * 5_000_000 + (n > 0) * 10**12,  # a single one long before all others
        lambda n: n * 200_000,  # 5 kHz, where 200 Hz are assumed
        lambda n: n * 100_000_000,
    ],
)
def test_stamps_of_other_units_are_told_from_bursts_gaps_and_other_rates(stamp_ns):
    check_inertial("mine", dive_with(lambda s: replace(s, stamp_ns=stamp_ns(s.stamp_ns // 5_000_000))))


def test_a_sequence_without_samples_is_refused():
    with pytest.raises(MethodError, match=r"^mine: expected inertial samples in sequence theirs, got 0$"):
        check_inertial("mine", dive_with(lambda s: s, count=0))


class Late(FlatBottom):
    """A short dive over a flat bottom whose images are stamped by a clock that is late."""

    def __init__(self, late_s: float, stated_s: float) -> None:
        super().__init__(4.5)
        self.cameras = {"cam": replace(self.cameras["cam"], rate_hz=10.0, time_offset_s=stated_s)}
        self._late_ns = round(late_s * 1e9)

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        for image in super().images(camera, start_ns, end_ns):
            yield replace(image, stamp_ns=image.stamp_ns + self._late_ns)


def test_a_stated_clock_offset_is_taken_into_account():
    settings = GtsamViSettings()
    on_time, late = (GtsamVi(settings=settings).run(Late(s, s)).trajectory for s in (0.0, 0.03))
    assert list(late.stamps_ns) == list(on_time.stamps_ns)
    np.testing.assert_array_equal(late.positions, on_time.positions)


@pytest.mark.parametrize("late_s", [0.03, -0.03])
def test_images_are_put_in_order_by_when_they_were_taken(late_s):
    late_ns = round(late_s * 1e9)
    camera = replace(dive.camera_calibration(), time_offset_s=late_s)
    images = [Image(50_000_000 * n + late_ns, "cam", np.zeros((1, 1, 3), dtype=np.uint8)) for n in range(1, 5)]
    stream = sorted([*images, *(sample(0.005 * n) for n in range(60))], key=lambda item: item.stamp_ns)
    found = list(on_imu_clock(iter(stream), {"cam": camera}))
    assert len(found) == 64
    stamps = [item.stamp_ns for item in found]
    assert stamps == sorted(stamps)
    taken = [n for n, item in enumerate(found) if isinstance(item, Image)]
    assert [found[n].stamp_ns for n in taken] == [50_000_000 * n for n in range(1, 5)]
    assert all(isinstance(found[n - 1], ImuMeasurement) and found[n - 1].stamp_ns == found[n].stamp_ns for n in taken)


def test_clocks_without_a_common_time_are_refused():
    with pytest.raises(MethodError, match=r"expected images of cam in sequence flat while .*by the same clock\?$"):
        GtsamVi().run(Late(1e6, 0.0))


def test_a_lens_of_five_coefficients_is_used_as_it_is():
    camera = replace(dive.camera_calibration(), distortion=np.array([0.1, 0.02, 0.001, 0.002, -0.03]))
    rig = CameraRig([camera], dive.imu_calibration())
    assert rig.keys() == []
    ahead = rig.T_imu_cam @ [0.0, 0.0, 2.0, 1.0]
    np.testing.assert_allclose(rig.errors_px(np.eye(4), ahead[None, :3], np.zeros((1, 2))), [0.0], atol=1e-9)


# Samples.


def test_a_wild_sample_is_left_out():
    buffer, spoilt = SampleBuffer(), SampleBuffer()
    for n in range(20):
        buffer.add(sample(0.005 * n))
        spoilt.add(sample(0.005 * n, force=1e6 if n == 7 else 9.8, gyro=30.0 if n == 12 else 0.0))
    assert (buffer.refused, spoilt.refused) == (0, 2)
    right, found = buffer.cut(100_000_000), spoilt.cut(100_000_000)
    assert found.duration == pytest.approx(right.duration)
    np.testing.assert_allclose(found.accel, np.tile([0.0, 0.0, 9.8], (len(found.dt), 1)))
    assert not found.gyro.any()


@pytest.mark.parametrize("force", [300.0, np.nan])
def test_a_wild_sample_in_the_first_second_does_not_tilt_the_vehicle(force):
    right = dive.inertial_samples(dive.survey_pose, dive.imu_calibration(), 1.5, np.random.default_rng(0))
    spoilt = list(right)
    spoilt[60] = replace(right[60], accel=np.array([force, 0.0, 0.0]))
    rotations = []
    for samples in (right, spoilt):
        first = first_moments("mine", "theirs", iter(samples), StartSettings())
        assert len(first.items) == 202, "of 200 Hz, and one after the second"
        rotations.append(align(first.stamps_ns, first.gyro, first.accel, dive.imu_calibration(), StartSettings())[0])
    np.testing.assert_allclose(rotations[1], rotations[0], atol=2e-3)


@pytest.mark.parametrize("early_s", [0.9, 1.5])
def test_the_vehicle_is_levelled_by_a_second_of_samples_whatever_begins_before_them(early_s):
    pictures = [Image(round(-1e9 * early_s) + 50_000_000 * n, "cam", np.zeros((1, 1, 3), np.uint8)) for n in range(80)]
    samples = [sample(0.005 * n) for n in range(400)]
    stream = sorted([*pictures, *samples], key=lambda item: item.stamp_ns)
    first = first_moments("mine", "theirs", iter(stream), StartSettings())
    assert first.stamps_ns[0] == 0
    assert first.stamps_ns[-1] == 1_005_000_000, "the first one after it"
    assert first.items == [item for item in stream if -1_000_000_000 <= item.stamp_ns <= 1_005_000_000]
    with pytest.raises(MethodError, match=r"^mine: expected inertial samples in the first 1 s .* theirs, .* got 0$"):
        first_moments("mine", "theirs", iter(pictures), StartSettings())


def test_a_gap_is_measured_from_sample_to_sample_wherever_it_is_cut():
    buffer, cuts = SampleBuffer(), []
    for n in range(1, 20):
        stamp_s = 0.05 * n
        for k in range(10):
            if not 0.2 < (at := stamp_s - 0.045 + 0.005 * k) < 0.62:
                buffer.add(sample(at))
        cuts.append(buffer.cut(round(stamp_s * 1e9)))
    gaps = [cut.gap_s for cut in cuts]
    assert gaps[:4] == pytest.approx([0.005] * 4)
    assert gaps[4:12] == pytest.approx([0.05 * n for n in range(1, 9)])  # so far
    assert gaps[12] == pytest.approx(0.42)
    assert gaps[14:] == pytest.approx([0.005] * 5)
    assert Segment.join(cuts).gap_s == pytest.approx(0.42)
    assert [cut.has_gap for cut in cuts[:8]] == [False] * 6 + [True] * 2


def test_a_filter_knows_nothing_of_a_gap_however_it_is_cut():
    noise, sigmas = InertialNoise(1e-4, 1e-3, 1e-5, 1e-4), []
    for pieces in (1, 20):
        filter = InvariantFilter(np.eye(3), noise, 9.8)
        for n in range(pieces):
            time = 1.0 / pieces
            level = np.array([[0.0, 0.0, 9.8]])
            filter.propagate_all(Segment(np.array([time]), np.zeros((1, 3)), level, 0.2 + time * (n + 1)))
        sigmas.append(np.sqrt(np.diag(filter.covariance[ATTITUDE, ATTITUDE])))
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=0.05)
    assert 0.2 < sigmas[0][0] < 0.3


def test_a_gap_counts_as_long_as_it_is_however_it_is_cut():
    def piece(duration: float, gap_s: float) -> Segment:
        return Segment(np.array([duration]), np.zeros((1, 3)), np.zeros((1, 3)), gap_s)

    cut = [piece(0.2, 0.2 * (n + 1)) for n in range(20)]
    assert time_missing([piece(4.0, 4.0)]) == pytest.approx(4.0)
    assert time_missing(cut) == pytest.approx(4.0)
    assert np.sqrt(sum(time_missing([one]) ** 2 for one in cut)) == pytest.approx(4.0), "as variances add up"
    assert time_missing([piece(3.0, 3.0), piece(1.0, 0.01), piece(4.0, 4.0)]) == pytest.approx(5.0)
    assert time_missing([piece(1.0, 0.05)] * 9) == 0.0


def test_rest_says_nothing_about_the_usual_speed():
    model = Estimator([dive.camera_calibration()], dive.imu_calibration(), GtsamViSettings()).model
    still = make_state(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3))
    keyframe = Keyframe(0, dive.START_NS, NOTHING, Segment.join([]), stationary=True, state=still)
    for _ in range(100):
        Recovery(model).accept(keyframe)
    assert model.usual_speed == model.settings.recovery.unknown_speed


# Whole dives.


def estimated(
    measured: dive.Dive, lost: Callable[[float], bool], sees: bool = True, end_s: float = np.inf
) -> Estimator:
    """An estimator run on a dive, up to a time, without the samples of some times, or without tracks."""
    settings = GtsamViSettings()
    estimator, samples = Estimator([measured.camera], measured.inertial, settings), SampleBuffer()
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            if not lost((item.stamp_ns - dive.START_NS) * 1e-9):
                samples.add(item)
            continue
        stamp, ids, pixels = item
        if stamp > dive.START_NS + end_s * 1e9:
            break
        estimator.propagate(samples.cut(stamp))
        tracks = FeatureTracks(ids, pixels, undistort(pixels, measured.camera)) if sees else NO_TRACKS
        estimator.step(stamp, tracks)
    estimator.finish()
    return estimator


def sigmas_off(truth: Trajectory, trajectory: Trajectory) -> Array:
    """Distance (N,) from the truth, both from the first pose on, in standard deviations and 2 cm."""
    known, covariances = truth.at(trajectory.stamps_ns).matrices, trajectory.covariances
    assert covariances is not None
    found = (known[0] @ np.linalg.inv(trajectory.matrices[0]) @ trajectory.matrices)[:, :3, 3]
    off = np.linalg.norm(found - known[:, :3, 3], axis=1)
    return off / np.hypot(np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2)), 0.02)


def test_it_says_what_it_does_not_know_after_a_gap_and_finds_its_place_again():
    measured = dive.make_dive(3, duration_s=12.0)
    estimator = estimated(measured, lambda seconds: 6.0 < seconds < 6.8)
    assert estimator.info["imu_gaps"] > 0
    assert estimator.window is not None
    for trajectory in (estimator.online(), estimator.smoothed()):
        assert sigmas_off(measured.truth, trajectory).max() < 3.0
    seconds = (np.array([frame.stamp_ns for frame in estimator.frames]) - dive.START_NS) * 1e-9
    assert (estimator.health()[(seconds > 6.5) & (seconds < 6.8)] == Health.COASTING).all()


def test_the_online_path_of_a_dive_with_a_loss_is_that_of_the_dive_so_far():
    """No later start changes what was given, or fills in what was not known."""
    measured = dive.make_dive(3, duration_s=12.0)
    whole, begun = (estimated(measured, lambda seconds: 6.0 < seconds < 6.8, end_s=end) for end in (12.0, 8.0))
    assert whole.window is not None
    assert begun.window is None
    known, path = begun.online(), whole.online()
    now = path.select(path.stamps_ns <= known.stamps_ns[-1])
    np.testing.assert_array_equal(now.positions, known.positions)
    np.testing.assert_array_equal(now.covariances, known.covariances)
    np.testing.assert_array_equal(whole.health("online")[: len(known)], begun.health("online"))
    assert (begun.health("online")[-10:] == Health.COASTING).all()


def test_what_is_not_known_of_a_turn_grows_with_the_gap(monkeypatch):
    measured, coasted = dive.make_dive(3, duration_s=11.0), list[Segment]()

    def counted(state: State, segment: Segment, memory_s: float) -> State:
        coasted.append(segment)
        return coast(state, segment, memory_s)

    monkeypatch.setattr(recovery, "coast", counted)
    estimator = estimated(measured, lambda seconds: 6.0 < seconds < 9.0)
    most = 0.75 * len(estimator.frames)
    assert 0 < len(coasted) < most, "each frame of the gap when it comes and at the next loss, not at every loss again"
    online = estimator.online()
    assert online.covariances is not None
    seconds = (online.stamps_ns - dive.START_NS) * 1e-9
    sigmas = np.sqrt(online.covariances[:, 5, 5])  # of the heading
    rate = estimator.model.settings.recovery.unknown_rate
    inside = (seconds > 6.5) & (seconds < 8.95)
    np.testing.assert_allclose(sigmas[inside], rate * (seconds[inside] - 6.0), rtol=0.1)
    assert (np.diff(sigmas[inside]) > 0).all()


def test_what_was_before_a_gap_before_the_start_is_tied_to_the_rest_as_loosely_as_it_is_known():
    measured = dive.make_dive(3, duration_s=6.0)
    estimator = estimated(measured, lambda seconds: 0.6 < seconds < 1.4)
    assert estimator.info["imu_gaps"] > 0
    assert estimator.window is not None
    assert sigmas_off(measured.truth, estimator.smoothed()).max() < 3.0
    covariances = estimator.online().covariances
    assert covariances is not None
    assert np.sqrt(covariances[0, 0, 0]) > 0.1 > np.sqrt(covariances[-1, 0, 0])  # odom is that of the start


def test_samples_that_end_early_leave_a_path_that_says_so():
    measured = dive.make_dive(3, duration_s=9.0)
    estimator = estimated(measured, lambda seconds: seconds > 6.0)
    assert estimator.info["initialised"] == 1  # whatever happened afterwards
    online = estimator.online()
    assert len(online) == len(measured.stamps_ns)
    assert sigmas_off(measured.truth, online).max() < 3.0
    assert online.covariances is not None
    assert np.sqrt(online.covariances[-1, 0, 0]) > 0.3


def test_without_a_start_the_path_is_that_of_a_filter_with_its_covariance():
    measured = dive.make_dive(4, duration_s=8.0, pose=dive.resting_start_pose)
    estimator = estimated(measured, lambda seconds: False, sees=False)
    assert estimator.info["initialised"] == 0
    path = estimator.smoothed()
    assert sigmas_off(measured.truth, path).max() < 3.0
    assert position_error(measured.truth, path) < 1.0
