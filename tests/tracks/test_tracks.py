"""The SLAM track: every method gets its record, also the one that fails."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import SequenceError, TrajectoryError
from oysterbench.core.trajectory import ReadOptions, Trajectory, read_trajectory, write_npz, write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.tracks.slam import (
    FRAMES_IN_REPORT,
    TRACK,
    SlamSequence,
    check_truth,
    own_sequences,
    sample_frames,
    score_files,
)
from oysterbench.tracks.slam_truth import true_poses_of, truth_digest
from tests.helpers.dives import survey
from tests.helpers.euroc import FRAMES, Folder
from tests.helpers.track_runs import finished_of, runs_of

METHODS = """
import numpy as np
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.methods import Estimate


class Perfect:
    name, track = "perfect", "slam"

    def __init__(self, place: str = "{place}") -> None:
        self.given = read_trajectory(place)

    def run(self, sequence):
        return Estimate(self.given, {{"guessed": True}})


class Raises(Perfect):
    name = "raises"

    def run(self, sequence):
        raise ValueError("no idea")


class Late(Perfect):
    name = "late"

    def run(self, sequence):
        return Estimate(Trajectory(self.given.stamps_ns + 10**12, self.given.positions, self.given.quaternions))


class Noisy(Perfect):
    name, seed = "noisy", 40

    def run(self, sequence):
        noise = stream(self.seed, b"", "noisy").normal(0, 0.02, self.given.positions.shape)
        return Estimate(Trajectory(self.given.stamps_ns, self.given.positions + noise, self.given.quaternions))
"""


@pytest.fixture
def evaluate(tiny_split, tiny_file, truth, tmp_path, monkeypatch):
    """Run classes of METHODS, which know the truth from elsewhere."""
    folder = tmp_path / "methods"
    folder.mkdir()
    write_npz(folder / "given.npz", truth)
    (folder / "given_methods.py").write_text(METHODS.format(place=folder / "given.npz"))
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))

    def call(*names, **options):
        sequence = SlamSequence("tiny-01", tiny_file, tiny_split)
        references = [f"given_methods:{name}" for name in names]
        return runs_of(TRACK, [sequence], references, SlamSettings(), tmp_path / "out", **options)

    return call


@pytest.fixture(scope="module")
def truth(tiny_file):
    return oysterbench.open(tiny_file).truth()


def test_a_perfect_estimate_has_no_error_and_a_failing_method_a_record_that_says_so(evaluate, truth, tmp_path):
    runs = evaluate("Perfect", "Raises", "Late")
    perfect, raises, too_late = (run.record for run in runs)
    assert perfect.metrics["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert perfect.metrics["coverage"] == 1.0
    assert perfect.metrics["realtime_factor"] > 1
    assert perfect.info["guessed"] is True
    assert raises.failure == "method 'raises' failed on tiny-01: ValueError: no idea"
    assert raises.metrics["coverage"] == 0.0
    assert "time" in too_late.failure
    assert np.allclose(read_trajectory(tmp_path / "out" / "tiny-01-perfect.tum").positions, truth.positions, atol=1e-9)
    assert (tmp_path / "out" / "tiny-01-truth.tum").exists()


@pytest.mark.slow
def test_several_runs_are_recorded_each_with_its_seed(evaluate, tmp_path):
    runs = evaluate("Noisy", "Perfect", runs=2)
    records = [run.record for run in runs]
    assert [(record.method, record.run, record.seed) for record in records] == [
        ("noisy", 0, 40),
        ("noisy", 1, 41),
        ("perfect", 0, None),
        ("perfect", 1, None),
    ]
    assert len({record.metrics["ate_rmse_m"] for record in records[:2]}) == 2
    assert (tmp_path / "out" / "tiny-01-noisy-2.tum").exists()
    again = evaluate("Noisy", runs=2, again=True)
    assert [run.record.metrics["ate_rmse_m"] for run in again] == [r.metrics["ate_rmse_m"] for r in records[:2]]


def test_conditions_and_the_digest_of_the_truth_are_kept(evaluate, truth):
    for run in evaluate("Perfect", "Raises"):
        assert run.record.conditions["water_type"] == "1C"
        assert run.record.truth_digest == truth_digest(truth)


def test_frames_of_the_report_are_spread_over_the_sequence(tiny_file):
    frames = sample_frames(oysterbench.open(tiny_file))
    assert len(frames) == FRAMES_IN_REPORT
    stamps = [stamp for stamp, _ in frames]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] == 2_400_000_000
    assert all(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) is not None for _, jpeg in frames)


@pytest.mark.parametrize("broken", range(len(FRAMES)))
def test_a_frame_that_cannot_be_read_costs_a_picture_of_the_report_and_no_result(broken, tmp_path):
    folder = Folder(tmp_path / "dive")
    (folder.root / "cam0" / "data" / f"{FRAMES[broken]}.png").write_bytes(b"cut short")
    frames = sample_frames(oysterbench.open(folder.path))
    assert [stamp for stamp, _ in frames] == FRAMES[:broken]


def test_a_ground_truth_that_cannot_be_read_is_refused_before_anything_runs(tmp_path):
    folder = Folder(tmp_path / "dive")
    folder.write("state_groundtruth_estimate0/data.csv", "0,0\n")
    with pytest.raises(TrajectoryError, match=r"state_groundtruth_estimate0/data\.csv:1: expected 8 numbers"):
        own_sequences([folder.path])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda truth: replace(truth, positions=0.0 * truth.positions), "does not move horizontally"),
        (lambda truth: replace(truth, positions=truth.positions * [0.0, 0.0, 1.0]), "does not move horizontally"),
        (lambda truth: truth.select(slice(0, 4)), "the ground truth has 4 poses, expected at least 5"),
    ],
)
def test_a_ground_truth_against_which_nothing_can_be_scored_is_refused_before_anything_runs(
    change, message, truth, tmp_path
):
    sequence = SlamSequence("dive", tmp_path / "absent")
    sequence.truth = change(truth)
    with pytest.raises(TrajectoryError, match=f"^dive: no method can be scored against its ground truth: .*{message}"):
        finished_of(TRACK, [sequence], ["dead_reckoning"], SlamSettings(), tmp_path)
    check_truth(sequence, [])
    for align in ("none", "sim3") if len(sequence.truth) > 4 else ():  # to one of these, it may mean something
        check_truth(sequence, [SlamSettings(), SlamSettings(align=align)])
    sequence.truth = None
    check_truth(sequence, [SlamSettings()])


def test_files_are_scored_under_their_names(truth, tmp_path):
    write_tum(tmp_path / "truth.tum", truth)
    moved = Trajectory(truth.stamps_ns, truth.positions + np.array([1.0, 2.0, 3.0]), truth.quaternions)
    write_tum(tmp_path / "moved.tum", moved)
    run = score_files(tmp_path / "truth.tum", tmp_path / "moved.tum", SlamSettings(align="none"))
    assert run.record.method == "moved.tum"
    assert run.record.metrics["ate_rmse_m"] == pytest.approx(np.sqrt(14.0), abs=1e-6)


def test_a_split_of_which_a_ground_truth_cannot_be_read_is_refused_before_anything_runs(tiny_split, tmp_path):
    (tmp_path / "tiny-01.mcap").write_bytes(b"cut")
    damaged = SlamSequence("tiny-01", tmp_path / "tiny-01.mcap", tiny_split)
    with pytest.raises(SequenceError, match=r"tiny-01\.mcap"):
        finished_of(TRACK, [damaged], ["dead_reckoning"], SlamSettings(), tmp_path / "out", split=tiny_split)
    assert not (tmp_path / "out" / "runs").exists()


@pytest.fixture
def marked(tmp_path):
    """A folder whose true poses are those of a marker apart from the body, and mine.tum, the body's, beside it."""
    folder = Folder(tmp_path / "dive")
    truth = survey(duration_s=20)
    measured = truth.positions + Rotation.from_quat(truth.quaternions).apply([0.3, 0.0, 0.1])
    write_tum(tmp_path / "mine.tum", truth)
    order = [3, 0, 1, 2]
    rows = zip(truth.stamps_ns.tolist(), measured.tolist(), truth.quaternions[:, order].tolist(), strict=True)
    folder.write(
        "state_groundtruth_estimate0/data.csv",
        "".join(f"{stamp},{','.join(map(str, [*position, *attitude]))}\n" for stamp, position, attitude in rows),
    )
    lever = "T_BS: [1, 0, 0, 0.3, 0, 1, 0, 0, 0, 0, 1, 0.1, 0, 0, 0, 1]"
    folder.write("state_groundtruth_estimate0/sensor.yaml", lever)
    return folder


def test_a_folder_is_scored_against_by_its_true_poses_alone_and_by_their_file(marked, tmp_path):
    """Whatever its inertial columns are called; and where a marker was measured, by the poses of the body."""
    marked.change("imu0/data.csv", "w_x,w_y,w_z", "w_x [deg s^-1],w_y,w_z")
    file = marked.root / "state_groundtruth_estimate0" / "data.csv"
    for place in (marked.path, file):
        run = score_files(place, tmp_path / "mine.tum", SlamSettings())
        assert run.record.metrics["ate_rmse_m"] < 1e-6
    assert any("taken to the body" in note for note in run.record.notes)
    marked.write("state_groundtruth_estimate0/sensor.yaml", "T_BS: [0]")
    for place in (marked.path, file):
        with pytest.raises(SequenceError, match=r"state_groundtruth_estimate0/sensor\.yaml: T_BS, data: expected 16"):
            true_poses_of(place, None)
    file.unlink()
    with pytest.raises(SequenceError, match="has no ground truth: "):
        true_poses_of(marked.path, None)


@pytest.mark.parametrize(
    ("cwd", "place"),
    [
        ("", "link.csv"),
        ("dive", "."),
        ("dive/mav0", "state_groundtruth_estimate0/data.csv"),
        ("dive/mav0/state_groundtruth_estimate0", "data.csv"),
        ("dive/mav0/imu0", "../state_groundtruth_estimate0/data.csv"),
    ],
)
def test_true_poses_are_taken_to_the_body_from_wherever_they_are_given(marked, tmp_path, monkeypatch, cwd, place):
    (tmp_path / "link.csv").symlink_to(marked.root / "state_groundtruth_estimate0" / "data.csv")
    monkeypatch.chdir(tmp_path / cwd)
    run = score_files(Path(place), tmp_path / "mine.tum", SlamSettings())
    assert any(re.match("dive: .* taken to the body", note) for note in run.record.notes)
    for found in (run.record, oysterbench.score(place, tmp_path / "mine.tum")):
        assert found.metrics["ate_rmse_m"] < 1e-6


def test_true_poses_are_taken_to_the_body_however_their_file_is_read_or_stored(marked, tmp_path):
    file, mine = marked.root / "state_groundtruth_estimate0" / "data.csv", tmp_path / "mine.tum"
    for said in (ReadOptions(format="euroc"), ReadOptions(time_unit="ns")):
        assert score_files(file, mine, SlamSettings(), said).record.metrics["ate_rmse_m"] < 1e-6
    stored = tmp_path / "stored.csv"
    file.rename(stored)
    file.symlink_to(stored)
    assert score_files(file, mine, SlamSettings()).record.metrics["ate_rmse_m"] < 1e-6
    assert true_poses_of(stored, None) == stored, "no folder has a file of that name"
    assert oysterbench.score(file, mine, truth_frame="body").metrics["ate_rmse_m"] > 0.01, "as it is said to be"
