"""What loops do to the path: a dive of a lap and a half, its places recognised by somebody who knows them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from oysterbench.core.geometry import Array, align_yaw, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.types import ImuMeasurement
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, undistort
from oysterbench_baselines.gtsam_vi.merging import LoopClosure, Merger, Ties, join, tie
from oysterbench_baselines.gtsam_vi.places import Place, heading_pose, level_pose, project
from oysterbench_baselines.gtsam_vi.settings import (
    GtsamViSettings,
    LandmarkSettings,
    LoopSettings,
    RecognitionSettings,
    SmoothingSettings,
)
from oysterbench_baselines.gtsam_vi.smoothing import smooth
from tests.helpers import synthetic_dive as dive

GREY = np.zeros((480, 640), dtype=np.uint8)


@dataclass
class Knowing:
    """Stands for the viewer, the index and the verifier: knows by the truth what is seen again, to half a pixel.

    false_m: it also takes every fifth place for one that lies so far beside it.
    """

    measured: dive.Dive
    estimator: Estimator
    false_m: float = 0.0
    resolution: float = 0.01
    count: int = 0
    asked: int = 0

    def describe(self, picture, rays, points, T_level_cam, plane) -> tuple[np.ndarray, Array]:
        return np.zeros((1, 32), dtype=np.uint8), np.zeros((1, 3))

    def add(self, descriptors: np.ndarray) -> None:
        self.count += 1

    def forget(self, place: int) -> None:
        pass

    def votes(self, descriptors: np.ndarray) -> Array:
        return np.linspace(1, 2, self.count)

    def align(self, first: Place, second: Place) -> tuple[Array, int]:
        stamps = np.array([self.estimator.keyframes[p.keyframe].stamp_ns for p in (first, second)])
        a, b = (
            level_pose(pose @ self.measured.inertial.T_base_imu) for pose in self.measured.truth.at(stamps).matrices
        )
        self.asked += 1
        aside = self.false_m if self.asked % 5 == 0 else 0.0
        return invert(a) @ b @ heading_pose(0.0, np.array([aside, 0.0, 0.0])), 100

    def confirm(self, first: Place, second: Place, T: Array, picture: np.ndarray):
        camera = self.measured.camera
        pixels, depth = project(first.points, T @ second.T_level_cam, camera)
        index = np.flatnonzero((depth > 0.3) & (pixels > 5).all(axis=1) & (pixels < [634, 474]).all(axis=1))
        if len(index) < 30:
            return None
        found = pixels[index] + np.random.default_rng(second.keyframe).normal(size=(len(index), 2)) * 0.5
        return T, np.diag([1e-6] + [1e-5] * 3), index, found, undistort(found, camera)


def estimate(
    measured: dive.Dive,
    loops: bool,
    false_m: float = 0.0,
    kept_places: int = 600,
    knowing: type[Knowing] = Knowing,
    **settings: int,
) -> Estimator:
    # The dive's points, unlike corners of relief, are the same from all sides.
    chosen = GtsamViSettings(
        landmarks=LandmarkSettings(max_turn_deg=180.0),
        recognition=RecognitionSettings(kept_places=kept_places),
        loops=LoopSettings(enabled=loops, **settings),
    )
    estimator = Estimator([measured.camera], measured.inertial, chosen)
    if estimator.loops is not None:
        knows = knowing(measured, estimator, false_m)
        estimator.loops.viewer = estimator.loops.index = estimator.loops.verifier = knows  # type: ignore[assignment]
    samples = SampleBuffer()
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        estimator.propagate(samples.cut(stamp))
        estimator.step(stamp, FeatureTracks(ids, pixels, undistort(pixels, measured.camera)), image=GREY)
    estimator.finish()
    return estimator


def position_error(truth: Trajectory, trajectory: Trajectory) -> float:
    """RMSE (m) after alignment in yaw and translation."""
    known = truth.at(trajectory.stamps_ns)
    aligned = align_yaw(known.positions, trajectory.positions).apply(trajectory.positions)
    return float(np.sqrt(np.mean(np.sum((aligned - known.positions) ** 2, axis=1))))


@pytest.fixture(scope="module")
def lap_and_a_half() -> dive.Dive:
    return dive.make_dive(3, duration_s=36.0, pixel_noise=0.8, most=60)


@pytest.fixture(scope="module")
def plain(lap_and_a_half) -> Estimator:
    return estimate(lap_and_a_half, loops=False)


@pytest.fixture(scope="module")
def closed(lap_and_a_half) -> Estimator:
    return estimate(lap_and_a_half, loops=True)


@pytest.mark.slow
def test_loops_can_be_left_out(plain):
    assert plain.loops is None
    assert "loops" not in plain.info
    assert all(frame.correction is None for frame in plain.frames)


def test_loops_lower_the_error_of_both_paths(lap_and_a_half, plain, closed):
    truth = lap_and_a_half.truth
    assert closed.info["loops"] > 10
    # What was given before the first loop stays as it was given.
    assert position_error(truth, closed.online()) < 0.97 * position_error(truth, plain.online())
    assert position_error(truth, closed.smoothed()) < 0.5 * position_error(truth, plain.smoothed())


@pytest.mark.slow
def test_loops_that_contradict_odometry_are_refused(lap_and_a_half, plain):
    estimator = estimate(lap_and_a_half, loops=True, false_m=0.8)
    assert estimator.loops is not None
    truth = lap_and_a_half.truth
    for loop in estimator.loops.loops:
        ends = [estimator.keyframes[estimator.loops.places[n].keyframe].stamp_ns for n in (loop.first, loop.second)]
        a, b = (level_pose(T @ lap_and_a_half.inertial.T_base_imu) for T in truth.at(np.array(ends)).matrices)
        assert np.linalg.norm((invert(invert(a) @ b) @ loop.T_first_second)[:3, 3]) < 0.1
    assert position_error(truth, estimator.smoothed()) < 0.8 * position_error(truth, plain.smoothed())


def test_a_place_is_no_loop_with_itself_a_moment_later(closed):
    estimator = closed
    for loop in estimator.loops.loops:
        first, second = (estimator.keyframes[estimator.loops.places[n].keyframe] for n in (loop.first, loop.second))
        assert (second.stamp_ns - first.stamp_ns) * 1e-9 >= GtsamViSettings().recognition.min_age_s


def test_tracks_of_one_picture_are_never_merged(plain):
    keyframes = plain.keyframes
    merger = Merger(keyframes)
    one, other = keyframes[20].observations.ids[:2].tolist()
    merger.merge(one, other)
    assert merger.root(one) != merger.root(other)
    late = next(i for i in keyframes[-1].observations.ids.tolist() if i not in keyframes[20].observations.ids)
    merger.merge(one, late)
    assert merger.root(one) == merger.root(late)
    assert not merger.see(one, keyframes[-1].index)
    assert merger.see(one, -1)
    assert not merger.see(late, -1)


def test_what_does_not_meet_in_a_point_stays_apart(plain):
    keyframes, model = plain.keyframes, plain.model
    first, second = keyframes[20], keyframes[-20]
    ids = first.observations.ids[:20]
    place = Place(
        first.index,
        np.eye(4),
        np.zeros(3),
        ids,
        first.observations.rays[:20],
        np.zeros((20, 3)),
        GREY[:0, :32],
        np.zeros((0, 3)),
        b"",
    )
    there = Place(
        second.index,
        np.eye(4),
        np.zeros(3),
        ids,
        first.observations.rays[:20],
        np.zeros((20, 3)),
        GREY[:0, :32],
        np.zeros((0, 3)),
        b"",
    )
    # Landmarks of one place said to be where others are in the other.
    rays = second.observations.rays[:20]
    loop = LoopClosure(0, 1, np.eye(4), np.eye(4), ids, rays, rays)
    joined = join(keyframes, [place, there], [loop], model)
    assert np.isin(joined[second.index].observations.ids, ids).sum() <= 1
    assert len(joined[second.index].observations.ids) <= len(second.observations.ids) + 1


@pytest.mark.slow
def test_passes_that_share_no_landmarks_are_tied_by_poses(lap_and_a_half, plain):
    """With no landmark shared it is the ties that close the lap."""
    estimator = estimate(lap_and_a_half, loops=True, merge_keyframes=1)
    joined = estimator.loops.joined(estimator.keyframes)
    for keyframe, before in zip(joined, estimator.keyframes, strict=True):
        np.testing.assert_array_equal(keyframe.observations.ids, before.observations.ids)
    assert 1 < sum(len(keyframe.aiding) for keyframe in joined) <= len(estimator.loops.places) / 4
    assert not any(keyframe.aiding for keyframe in estimator.keyframes)
    truth = lap_and_a_half.truth
    assert position_error(truth, estimator.smoothed()) < 0.7 * position_error(truth, plain.smoothed())


@pytest.mark.slow
def test_pieces_of_a_long_path_share_no_landmark_and_ties_close_the_lap(lap_and_a_half, plain, closed):
    """In pieces it is as good as in one, and none of its pieces is much of it."""
    model, whole = closed.model, closed.model.settings
    model.settings = replace(whole, smoothing=SmoothingSettings(piece_keyframes=20))
    try:
        joined = closed.loops.joined(closed.keyframes)
        smoothed = smooth(model, joined, closed.frames)
        assert sum(len(keyframe.aiding) for keyframe in joined) > 1
        path = smoothed.pieces
        assert path is not None
        assert len(path.parts) > 2
        sizes = [path.graph(p).size() for p in range(len(path.parts))]
        assert max(sizes) < 0.6 * sum(sizes)
        assert max(map(len, path.shared)) < 0.5 * 3 * len(joined)
        truth = lap_and_a_half.truth
        assert position_error(truth, closed.smoothed()) < 0.7 * position_error(truth, plain.smoothed())
    finally:
        model.settings = whole


def test_no_more_places_are_kept_than_wanted_and_none_in_the_end():
    kept = list[int]()

    class Counting(Knowing):
        def votes(self, descriptors: np.ndarray) -> Array:
            assert self.estimator.loops is not None
            kept.append(sum(not place.forgotten for place in self.estimator.loops.places))
            return super().votes(descriptors)

    estimator = estimate(dive.make_dive(3, duration_s=16.0, most=60), True, kept_places=6, knowing=Counting)
    assert len(estimator.loops.places) > 12
    assert min(kept[-4:]) >= 4
    assert max(kept) <= 7  # with the newest, before others are forgotten
    assert all(place.forgotten for place in estimator.loops.places)
    # What a frame has measured since its key frame is held once, by the next key frame.
    for frame in estimator.frames:
        if frame.keyframe + 1 < len(estimator.keyframes) and len(frame.since.dt):
            assert np.shares_memory(frame.since.gyro, estimator.keyframes[frame.keyframe + 1].segment.gyro)


@pytest.mark.slow
def test_no_landmark_is_shared_by_more_than_one_pass_beyond_the_limit(lap_and_a_half, closed):
    def most_seen(estimator: Estimator) -> int:
        assert estimator.loops is not None
        joined = estimator.loops.joined(estimator.keyframes)
        return int(np.unique(np.concatenate([k.observations.ids for k in joined]), return_counts=True)[1].max())

    alone = int(np.unique(np.concatenate([k.observations.ids for k in closed.keyframes]), return_counts=True)[1].max())
    assert most_seen(closed) > alone
    assert most_seen(estimate(lap_and_a_half, loops=True, merge_keyframes=alone)) < alone + most_seen(closed) / 2


def test_ties_are_few_and_go_to_the_same_places_pass_after_pass():
    ties = Ties(4)
    empty = np.empty((0, 2))
    for second in range(100, 1000):
        first = second % 100
        ties.offer(LoopClosure(first, second, np.eye(4), np.eye(4), np.empty(0, dtype=np.int64), empty, empty))
    assert len(ties.loops) == 900 / 4
    assert len({loop.first for loop in ties.loops}) == 100 / 4


def test_a_tie_measures_heading_and_position_in_level_frames(plain):
    first, second = plain.keyframes[20], plain.keyframes[-1]
    levels = [level_pose(keyframe.state.matrix) for keyframe in (first, second)]
    settings = GtsamViSettings(loops=LoopSettings(heading_floor=0.0, position_floor_m=0.0))
    variances = np.array([0.003, 0.01, 0.02, 0.03]) ** 2
    empty = np.empty((0, 2))
    true = invert(levels[0]) @ levels[1]
    loop = LoopClosure(0, 1, true, np.diag(variances), np.empty(0, dtype=np.int64), empty, empty)
    factor = tie(loop, first, second, settings)

    def error(T_odom_second: Array) -> float:
        values = gtsam.Values()
        values.insert(X(first.index), first.state.nav.pose())
        values.insert(X(second.index), gtsam.Pose3(T_odom_second))
        return 2 * factor.error(values)

    at = second.state.matrix
    assert error(at) < 1e-9
    heading = levels[0][:3, :3]
    for axis, variance in enumerate(variances[1:]):
        moved = at.copy()
        moved[:3, 3] += heading[:, axis] * 1e-3
        np.testing.assert_allclose(error(moved), 1e-6 / variance, rtol=0.01)
    turned = at.copy()
    turned[:3, :3] = heading_pose(1e-3, np.zeros(3))[:3, :3] @ at[:3, :3]
    np.testing.assert_allclose(error(turned), 1e-6 / variances[0], rtol=0.05)
