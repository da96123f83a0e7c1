"""The SLAM track: every method gets its record, also the one that fails."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory, read_trajectory, write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods import Estimate
from oysterbench.tracks.slam import FRAMES_IN_REPORT, evaluate_slam, sample_frames, score_files, truth_digest


class Given:
    """Answers with a trajectory that it was given."""

    track = "slam"

    def __init__(self, name, trajectory):
        self.name = name
        self.trajectory = trajectory

    def run(self, sequence):
        if self.trajectory is None:
            raise ValueError("no idea")
        return Estimate(self.trajectory, {"guessed": True})


@pytest.fixture(scope="module")
def truth(tiny_file):
    return oysterbench.open(tiny_file).truth()


def test_a_perfect_estimate_has_no_error_and_a_failing_method_a_record_that_says_so(
    tiny_split, tiny_file, truth, tmp_path
):
    late = Trajectory(truth.stamps_ns + 10**12, truth.positions, truth.quaternions)
    methods = [Given("perfect", truth), Given("raises", None), Given("late", late)]
    runs = evaluate_slam(tiny_split, {"tiny-01": tiny_file}, methods, SlamSettings(), folder=tmp_path)
    perfect, raises, too_late = (run.record for run in runs)
    assert perfect.metrics["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert perfect.metrics["coverage"] == 1.0
    assert perfect.metrics["realtime_factor"] > 1
    assert perfect.info == {"guessed": True}
    assert raises.failure == "method 'raises' failed on sequence tiny-01: ValueError: no idea"
    assert raises.metrics["coverage"] == 0.0
    assert "time" in too_late.failure
    assert np.allclose(read_trajectory(tmp_path / "tiny-01-perfect.tum").positions, truth.positions, atol=1e-9)
    assert (tmp_path / "tiny-01-truth.tum").exists()


class Noisy(Given):
    """Answers with the trajectory, shaken by a stream of its seed."""

    seed = 40

    def run(self, sequence):
        noise = stream(self.seed, b"", "noisy").normal(0, 0.02, self.trajectory.positions.shape)
        given = self.trajectory
        return Estimate(Trajectory(given.stamps_ns, given.positions + noise, given.quaternions))


def test_several_runs_are_recorded_each_with_its_seed(tiny_split, tiny_file, truth, tmp_path):
    methods = [Noisy("noisy", truth), Given("fixed", truth)]
    runs = evaluate_slam(tiny_split, {"tiny-01": tiny_file}, methods, SlamSettings(), folder=tmp_path, times=3)
    records = [run.record for run in runs]
    assert [(record.method, record.run, record.seed) for record in records] == [
        ("noisy", 0, 40),
        ("noisy", 1, 41),
        ("noisy", 2, 42),
        ("fixed", 0, None),
        ("fixed", 1, None),
        ("fixed", 2, None),
    ]
    assert len({record.metrics["ate_rmse_m"] for record in records[:3]}) == 3
    assert methods[0].seed == 40
    assert (tmp_path / "tiny-01-noisy-3.tum").exists()
    again = evaluate_slam(tiny_split, {"tiny-01": tiny_file}, methods[:1], SlamSettings(), times=3)
    assert [run.record.metrics["ate_rmse_m"] for run in again] == [r.metrics["ate_rmse_m"] for r in records[:3]]


def test_conditions_and_the_digest_of_the_truth_are_kept(tiny_split, tiny_file, truth):
    methods = [Given("perfect", truth), Given("raises", None)]
    for run in evaluate_slam(tiny_split, {"tiny-01": tiny_file}, methods, SlamSettings()):
        assert run.record.conditions["water_type"] == "1C"
        assert run.record.truth_digest == truth_digest(truth)


def test_frames_of_the_report_are_spread_over_the_sequence(tiny_file):
    frames = sample_frames(oysterbench.open(tiny_file))
    assert len(frames) == FRAMES_IN_REPORT
    stamps = [stamp for stamp, _ in frames]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] == 2_400_000_000
    assert all(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) is not None for _, jpeg in frames)


def test_files_are_scored_under_their_names(truth, tmp_path):
    write_tum(tmp_path / "truth.tum", truth)
    moved = Trajectory(truth.stamps_ns, truth.positions + np.array([1.0, 2.0, 3.0]), truth.quaternions)
    write_tum(tmp_path / "moved.tum", moved)
    run = score_files(tmp_path / "truth.tum", tmp_path / "moved.tum", SlamSettings(align="none"))
    assert run.record.method == "moved.tum"
    assert run.record.metrics["ate_rmse_m"] == pytest.approx(np.sqrt(14.0), abs=1e-6)
