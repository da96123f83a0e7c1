"""What loops do to the path: a dive of a lap and a half, its places recognised by somebody who knows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import synthetic_dive as dive

from oysterbench.geometry import Array, align_yaw, invert
from oysterbench.sequence.types import ImuSample
from oysterbench.trajectory import Trajectory
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import undistort
from oysterbench_baselines.gtsam_vi.merging import Loop, Merger, join
from oysterbench_baselines.gtsam_vi.places import Place, heading_pose, level_pose, project
from oysterbench_baselines.gtsam_vi.settings import Settings

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


def estimate(measured: dive.Dive, loops: bool, false_m: float = 0.0) -> Estimator:
    estimator = Estimator(measured.camera, measured.inertial, Settings(loops=loops))
    if estimator.loops is not None:
        knowing = Knowing(measured, estimator, false_m)
        estimator.loops.viewer = estimator.loops.index = estimator.loops.verifier = knowing  # type: ignore[assignment]
    samples = SampleBuffer()
    for item in measured.stream():
        if isinstance(item, ImuSample):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        estimator.add_frame(stamp, samples.cut(stamp), ids, undistort(pixels, measured.camera))
        estimator.look(GREY)
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
        assert (second.stamp_ns - first.stamp_ns) * 1e-9 >= Settings().loop_min_s


def test_tracks_of_one_picture_are_never_merged(plain):
    keyframes = plain.keyframes
    merger = Merger(keyframes)
    one, other = keyframes[20].view.ids[:2].tolist()
    merger.merge(one, other)
    assert merger.root(one) != merger.root(other)
    late = next(i for i in keyframes[-1].view.ids.tolist() if i not in keyframes[20].view.ids)
    merger.merge(one, late)
    assert merger.root(one) == merger.root(late)
    assert not merger.see(one, keyframes[-1].index)
    assert merger.see(one, -1)
    assert not merger.see(late, -1)


def test_what_does_not_meet_in_a_point_stays_apart(plain):
    keyframes, model = plain.keyframes, plain.model
    first, second = keyframes[20], keyframes[-20]
    ids = first.view.ids[:20]
    place = Place(
        first.index,
        np.eye(4),
        np.zeros(3),
        ids,
        first.view.rays[:20],
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
        first.view.rays[:20],
        np.zeros((20, 3)),
        GREY[:0, :32],
        np.zeros((0, 3)),
        b"",
    )
    # Landmarks of one place said to be where others are in the other.
    rays = second.view.rays[:20]
    loop = Loop(0, 1, np.eye(4), np.eye(4), ids, rays, rays)
    joined = join(keyframes, [place, there], [loop], model, 1.5)
    assert np.isin(joined[second.index].view.ids, ids).sum() <= 1
    assert len(joined[second.index].view.ids) <= len(second.view.ids) + 1
