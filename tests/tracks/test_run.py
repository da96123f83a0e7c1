"""The runner: other programs and classes, contained, measured, resumed; whatever they do is a record and no crash."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.trajectory import Trajectory, read_trajectory, write_tum
from oysterbench.core.trajectory.frames import poses_of_body, scaled
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.methods import runner, sharing
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.interfaces.slam import FORMS, frame_pose, write_input
from oysterbench.methods.sharing import ASSUMED_BYTES, Sharing
from oysterbench.sequence.export.parts import sensor_poses
from oysterbench.sequence.truth import TRUTH_TYPES
from oysterbench.tracks import Request
from oysterbench.tracks.slam import TRACK, SlamSequence, own_sequences
from tests.helpers.programs import command
from tests.helpers.track_runs import finished_of
from tests.tracks.conftest import NAME


@pytest.fixture(scope="module")
def truth(dive_file):
    return oysterbench.open(dive_file).truth()


@pytest.fixture
def answer(tmp_path, truth):
    """The true poses of the vehicle as a TUM file."""
    path = tmp_path / "work" / "answer.tum"  # programs write beside it, and cannot do so beside the results
    path.parent.mkdir()
    write_tum(path, truth)
    return path


def moved(truth: Trajectory, T_base_frame: np.ndarray) -> Trajectory:
    """Poses of another frame of the vehicle."""
    return poses_of_body(truth, np.linalg.inv(T_base_frame))


# What a program is given, and how its answer is read


@pytest.mark.parametrize(
    "form", [form if form in ("mcap", "euroc") else pytest.param(form, marks=pytest.mark.slow) for form in FORMS]
)
def test_a_program_that_answers_in_the_frame_of_its_input_is_right_to_the_digit(
    form, run_apart, truth, dive_file, tmp_path
):
    sequence = oysterbench.open(dive_file)
    frame = {"euroc": "imu", "tum": "cam_left", "kitti": "cam_left", "rosbag": "imu", "mcap": "base"}[form]
    given = moved(truth, frame_pose(sequence, frame, form))
    if form == "kitti":  # stamps as KITTI has them: from the first image
        given = Trajectory(given.stamps_ns - truth.stamps_ns[0], given.positions, given.quaternions)
    write_tum(tmp_path / "given.tum", given)
    (done,) = run_apart(ExternalCommand(command(tmp_path, "copies", tmp_path / "given.tum", form), "copies"))
    record = done.scored.record
    assert record.failure is None
    assert record.metrics["ate_rmse_m"] < 1e-9
    assert record.metrics["ate_rotation_rmse_deg"] < 1e-6
    assert record.metrics["coverage"] == 1.0
    assert not (tmp_path / "out" / "inputs").exists()


def test_poses_of_a_frame_that_was_not_said_are_named_in_the_record(run, truth, dive_file, tmp_path):
    turned = moved(truth, frame_pose(oysterbench.open(dive_file), "cam_left", "euroc"))
    write_tum(tmp_path / "given.tum", turned)
    template = command(tmp_path, "copies", tmp_path / "given.tum", "euroc")
    (wrong,) = run(ExternalCommand(template, "wrong"))
    said = "they were read as poses of a camera or an IMU (--poses-of): are they those of another frame?"
    assert any(note.endswith(said) for note in wrong.scored.record.notes)
    (right,) = run(ExternalCommand(template, "right", poses_of="cam_left"))
    assert right.scored.record.metrics["ate_rmse_m"] < 1e-9


@pytest.mark.parametrize("scale", [0.1, *(pytest.param(scale, marks=pytest.mark.slow) for scale in (0.5, 1.0, 30.0))])
def test_the_exact_path_of_a_camera_without_scale_is_exact_by_sim3_and_so_is_its_file(
    scale, run, truth, dive_file, tmp_path
):
    camera = moved(truth, frame_pose(oysterbench.open(dive_file), "cam_left", "tum"))
    write_tum(tmp_path / "given.tum", scaled(camera, scale))
    program = ExternalCommand(command(tmp_path, "copies", tmp_path / "given.tum", "tum"), "copies")
    (done,) = finished_of(
        TRACK, [SlamSequence(NAME, dive_file)], [program], SlamSettings(align="sim3"), tmp_path / "out", limit_s=60.0
    )
    metrics = done.scored.record.metrics
    assert metrics["ate_rmse_m"] < 1e-8
    assert metrics["score"] == pytest.approx(1)
    kept = score(truth, read_trajectory(tmp_path / "out" / f"{NAME}-copies.tum"), SlamSettings(align="sim3"))
    assert kept.metrics["ate_rmse_m"] < 1e-8


def test_an_online_path_is_kept_beside_the_final_one(run, truth, dive_file, tmp_path):
    given = moved(truth, frame_pose(oysterbench.open(dive_file), "imu", "euroc"))
    write_tum(tmp_path / "imu.tum", given)
    (done,) = run(ExternalCommand(command(tmp_path, "leaves_both", tmp_path / "imu.tum", "euroc", "{online}"), "both"))
    paths = done.scored.record.info["paths"]
    assert paths["scored"] == "final"
    assert paths["alternatives"]["online"]["coverage"] < 0.6 < done.scored.record.metrics["coverage"]
    assert paths["alternatives"]["online"]["ate_rmse_m"] < 1e-6
    assert (tmp_path / "out" / f"{NAME}-both.online.tum").is_file()


def test_an_online_path_that_cannot_be_read_costs_the_scored_one_nothing(run, answer, tmp_path):
    template = command(tmp_path, "leaves_both", answer, "mcap", "{online}", "lost")
    (done,) = run(ExternalCommand(template, "both"))
    assert done.scored.record.metrics["ate_rmse_m"] < 1e-9
    assert "paths" not in done.scored.record.info
    (note,) = done.scored.record.notes
    assert note.startswith("its online path cannot be read and was left out: ")
    assert "\n" not in note


def test_a_frame_that_the_vehicle_lacks_is_refused_with_its_cameras(run, answer, tmp_path):
    with pytest.raises(MethodError, match="expected base, imu, camera or one of its cameras: cam_left, cam_right"):
        run(ExternalCommand(command(tmp_path, "copies", answer), "copies", poses_of="cam_top"))


def test_a_frame_that_some_vehicles_lack_is_a_failure_there(run, answer, tmp_path, monkeypatch):
    """Of two runs, of which the first does not fit: as of two dives by two vehicles."""
    answers = iter([MethodError("no such frame"), None, MethodError("no such frame"), None])

    def check(adapter, sequence):
        if (found := next(answers)) is not None:
            raise found

    monkeypatch.setattr(ExternalCommand, "check", check)
    program = command(tmp_path, "copies", answer)
    first, second = run(ExternalCommand(program, "copies"), runs=2)
    assert "no such frame" in first.failure
    assert second.failure is None


@pytest.mark.parametrize("form", FORMS)
def test_what_a_program_is_given_holds_no_truth(form, dive_file, tmp_path, truth):
    place = tmp_path / "given"
    write_input(dive_file, form, place)
    files = [place] if place.is_file() else [path for path in place.rglob("*") if path.is_file()]
    assert files
    names = " ".join(str(path.relative_to(tmp_path)) for path in files)
    assert not any(word in names for word in ("truth", "state", "depth", "oyster", "poses"))
    # The digits of a true position, in any frame of the vehicle, as any of the formats would write them.
    sequence = oysterbench.open(dive_file)
    digits = set()
    for frame in ("base", "imu", "cam_left"):
        poses = sensor_poses(truth, frame_pose(sequence, frame, form))
        digits |= {f"{abs(value):.6f}"[:7].encode() for value in poses[40:, :2, 3].ravel() if abs(value) > 0.1}
    for path in files:
        if path.suffix in (".csv", ".txt", ".yaml"):
            text = path.read_bytes()
            assert not any(number in text for number in digits), path
    if form == "mcap":
        content = oysterbench.open(place)
        topics = {topic for topic, _, _ in content.contents()}
        assert topics >= {"/imu", "/cam_left/image"}
        assert not topics & {*TRUTH_TYPES, "/cam_left/depth", "/cam_left/instance", "/fls/cloud"}
        assert set(content.attachments) == {"calibration.json"}
        with pytest.raises(SequenceError, match="no ground truth"):
            content.truth()


def test_an_input_is_made_once_for_all_runs(run_apart, answer, tmp_path, monkeypatch):
    """And commands side by side have their share of the cores; the one that makes it has all."""
    made = []
    monkeypatch.setattr(sharing, "default_workers", lambda: 6)
    original = runner.Processes.run

    def spy(self, words, *rest, **options):
        made.append(("oysterbench.methods.interfaces.slam" in words, options.get("cores")))
        return original(self, words, *rest, **options)

    monkeypatch.setattr(runner.Processes, "run", spy)
    run_apart(ExternalCommand(command(tmp_path, "copies", answer), "copies"), runs=3, jobs=2)
    own, commands = ([cores for is_own, cores in made if is_own is asked] for asked in (True, False))
    assert (own, len(commands), commands[:2]) == ([None], 3, [3, 3])


def test_an_euroc_folder_is_run_on_like_a_file(dive_file, answer, tmp_path):
    from oysterbench.sequence.export import export_sequence

    folder, _ = export_sequence(oysterbench.open(dive_file), "euroc", tmp_path / "flight")
    (dive,) = own_sequences([folder])
    write_tum(tmp_path / "imu.tum", dive.truth)
    program = ExternalCommand(command(tmp_path, "copies", tmp_path / "imu.tum", "euroc"), "copies")
    (done,) = finished_of(TRACK, [dive], [program], SlamSettings(), tmp_path / "out")
    assert done.scored.record.metrics["ate_rmse_m"] < 1e-9
    assert done.scored.record.split == ""
    program = ExternalCommand(command(tmp_path, "copies", answer), "m")
    with pytest.raises(MethodError, match=r"\{mcap\} needs a sequence file"):
        finished_of(TRACK, [dive], [program], SlamSettings(), tmp_path / "out")


# What a run costs


def test_cost_command_versions_and_hardware_are_recorded(run, answer, tmp_path):
    template = command(tmp_path, "copies", answer)
    (done,) = run(ExternalCommand(template, "copies"))
    record = done.scored.record
    assert 0 < record.metrics["cpu_s"] < 60
    assert 0 < record.metrics["wall_s"] < 60
    assert record.metrics["cpu_s_per_s"] == pytest.approx(record.metrics["cpu_s"] / 1.98)
    assert record.metrics["peak_memory_mb"] > 5
    assert record.metrics["realtime_factor"] == pytest.approx(1.98 / record.metrics["wall_s"])
    assert record.method_settings == {"command": template, "poses_of": "base"}
    assert record.hardware["cores"] >= 1
    about = record.info["run"]
    assert about["command"][-1].endswith("trajectory.tum")
    digests = {key: value for key, value in about["versions"].items() if key.startswith("sha256 of ")}
    assert {Path(key).name for key in digests} == {Path(sys.executable).name, "answer.tum", "copies.py"}
    assert {len(value) for value in digests.values()} == {64}
    assert about["limit_s"] == 60.0


def test_time_and_memory_of_children_count(run, answer, tmp_path):
    (done,) = run(ExternalCommand(command(tmp_path, "works", answer), "works"))
    assert done.scored.record.metrics["cpu_s"] >= 0.5
    assert 150 < done.scored.record.metrics["peak_memory_mb"] < 250


# What goes wrong with a program


@pytest.mark.parametrize(
    ("program", "failure"),
    [
        ("sleeps", "time limit of 1 s reached: killed; last output: still here"),
        ("crashes", "killed by SIGSEGV"),
        pytest.param("refuses", "exit status 3; last output: no vocabulary | giving up", marks=pytest.mark.slow),
        ("silent", "exited normally, but wrote no trajectory to {out}"),
        ("garbage", "wrote no readable trajectory: "),
        pytest.param("empty", "wrote no readable trajectory: ", marks=pytest.mark.slow),
    ],
)
def test_a_program_that_fails_leaves_a_record_that_says_how(program, failure, run, answer, tmp_path):
    limit_s = 1.0 if program == "sleeps" else 60.0
    (done,) = run(ExternalCommand(command(tmp_path, program, answer), program), limit_s=limit_s)
    record = done.scored.record
    assert record.failure.startswith(f"method {program!r} on hand-made: {failure}")
    assert "\n" not in record.failure
    assert record.metrics["coverage"] == 0.0
    assert record.metrics["score"] == 0.0


def test_the_last_words_of_a_program_are_its_last_ten_lines_whole(run, answer, tmp_path):
    (done,) = run(ExternalCommand(command(tmp_path, "explains", answer), "explains"))
    said = done.failure.partition("last output: ")[2].split(" | ")
    assert [line[:9] for line in said] == [f"frame {k}:" for k in range(20, 30)]


def test_a_program_that_the_machine_killed_is_not_scored_and_runs_again(run, answer, tmp_path):
    mine = ExternalCommand(command(tmp_path, "killed", answer), "mine")
    (done,) = run(mine)
    assert done.scored is None
    assert done.failure == (
        "method 'mine' on hand-made: killed by SIGKILL (by itself or from outside: memory was not short); the run is "
        "not counted, and the same command runs it again"
    )
    (done,) = run(mine)
    assert done.scored.record.failure is None
    assert Path(f"{answer}.log").read_text() == "run\n" * 2


def test_a_shell_tells_that_what_it_ran_was_killed(run, answer, tmp_path):
    (done,) = run(ExternalCommand(command(tmp_path, "killed_in_a_shell", answer), "mine"))
    assert done.scored is None
    assert "exit status 137 (by itself or from outside: memory was not short); the run is not counted" in done.failure


def test_a_full_disk_ends_all_and_is_no_failure_of_the_method(run, answer, tmp_path, monkeypatch):
    says_so = ExternalCommand(command(tmp_path, "full", answer), "mine")  # of a disk that is not that of the results
    said, other = run(says_so, ExternalCommand(command(tmp_path, "copies", answer), "copies"))
    assert said.scored is None
    assert "No space left on device" in said.failure
    assert said.failure.endswith("; the run is not counted, and the same command runs it again")
    assert other.failure is None
    refuses = ExternalCommand(command(tmp_path, "refuses", answer), "other")
    with monkeypatch.context() as patch:
        patch.setattr("oysterbench.methods.processes.free_bytes", lambda folder: 0)
        with pytest.raises(OSError, match="No space left on device"):
            run(refuses)
    (done,) = run(refuses)
    assert done.scored.record.failure is not None


def test_megabytes_of_output_do_no_harm(run, answer, tmp_path):
    (done,) = run(ExternalCommand(command(tmp_path, "talks", answer), "talks"))
    assert done.failure is None
    assert (tmp_path / "out/runs/talks/hand-made/1/stdout.txt").stat().st_size == 60_000 * 80


def test_processes_that_outlive_their_program_are_killed_and_noted(run, answer, tmp_path):
    (done,) = run(ExternalCommand(command(tmp_path, "leaves", answer), "leaves"))
    assert done.scored.record.metrics["coverage"] == 1.0
    assert "1 processes were still running after it ended and were killed" in done.scored.record.notes
    with pytest.raises(ProcessLookupError):
        os.kill(int(Path(f"{answer}.pid").read_text()), 0)


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("true {euroc}", "expected {out}, where the program writes a trajectory, and one of {euroc}"),
        ("true {out}", "and one of {euroc}, {tum}, {kitti}, {rosbag}, {mcap}, which it reads, got {out}"),
        ("true {euroc} {mcap} {out}", "got {euroc}, {mcap}, {out}"),
        ("true {bag} {out}", "unknown placeholder {bag}; known: {euroc}"),
        ("true {euroc} {out} 'awk {'", "write {{ and }} for literal braces"),
        ("true '{euroc} {out}", "No closing quotation"),
        ("no-such-program {euroc} {out}", "no program 'no-such-program' that can be executed"),
    ],
)
def test_a_command_line_of_another_shape_is_refused_before_anything_runs(template, message):
    with pytest.raises(MethodError) as caught:
        ExternalCommand(template)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_braces_of_the_program_itself_are_doubled(tmp_path):
    program = ExternalCommand("printf '{{%s}}' {euroc} {out}", "prints")
    words = program.command(tmp_path / "in", tmp_path, 0)
    assert words[1:] == ["{%s}", str(tmp_path / "in"), str(tmp_path / "trajectory.tum")]


# Many jobs


def test_two_jobs_run_at_a_time(run, answer, tmp_path):
    program = ExternalCommand(command(tmp_path, "meets", answer, "mcap", "2"), "meets")
    assert [done.failure for done in run(program, runs=2, jobs=2)] == [None, None]


def test_jobs_wait_for_memory(run, answer, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "Sharing", lambda *known: Sharing(*known, budget=ASSUMED_BYTES))
    program = ExternalCommand(command(tmp_path, "meets", answer, "mcap", "2"), "meets")
    first, second = run(program, runs=2, jobs=2, limit_s=2.0)
    assert "time limit" in first.failure  # it was alone
    assert second.failure is None  # the first had left its sign


def test_what_is_finished_is_not_run_again_unless_that_is_asked_for(run, answer, tmp_path):
    counts = ExternalCommand(command(tmp_path, "counts", answer, "mcap", "{seed}"), "counts")
    log = Path(f"{answer}.log")
    first = run(counts, runs=2)
    assert [done.scored.record.seed for done in first] == [0, 1]
    assert log.read_text() == "0\n1\n"
    second = run(counts, runs=3)
    assert log.read_text() == "0\n1\n2\n"
    assert [done.scored.record.to_dict() for done in second[:2]] == [done.scored.record.to_dict() for done in first]
    run(counts, runs=1, again=True)
    assert log.read_text() == "0\n1\n2\n0\n"


def test_what_failed_is_run_again_where_that_is_asked_for(run, answer, tmp_path):
    refuses = ExternalCommand(command(tmp_path, "refuses", answer), "refuses")
    (failed,) = run(refuses)
    (kept,) = run(refuses)
    assert kept.failure == failed.failure
    (tmp_path / "refuses.py").write_text("import shutil, sys; shutil.copy(sys.argv[1], sys.argv[3])")
    (mended,) = run(refuses, retry=True)
    assert mended.failure is None


def test_results_of_another_command_are_not_taken_for_its_own(run, answer, tmp_path):
    run(ExternalCommand(command(tmp_path, "copies", answer), "mine"))
    with pytest.raises(MethodError, match=r"holds run 1 of a different mine .*rerun it with --again"):
        run(ExternalCommand(command(tmp_path, "counts", answer), "mine"))


@pytest.mark.parametrize("word", ["{}", "--config={}"])
def test_a_program_that_was_changed_is_another_and_the_file_is_named(word, run, answer, tmp_path):
    config = tmp_path / "rig.yaml"
    config.write_text("fast: 20")
    mine = ExternalCommand(command(tmp_path, "copies", answer, "mcap", word.format(config)), "mine")
    run(mine)
    config.write_text("fast: 8")
    with pytest.raises(MethodError, match=r"holds run 1 of a different mine \(\S+/rig\.yaml changed\); it was left"):
        run(mine)


def test_one_runner_works_in_a_folder_at_a_time(dive_file, answer, tmp_path):
    program = ExternalCommand(command(tmp_path, "copies", answer), "copies")
    dive = SlamSequence(NAME, dive_file)
    running = TRACK.run([dive], [program], SlamSettings(), Request(tmp_path, runs=2, jobs=1))
    next(running)
    with pytest.raises(MethodError, match="another run is using it"):
        finished_of(TRACK, [dive], [program], SlamSettings(), tmp_path)
    running.close()
