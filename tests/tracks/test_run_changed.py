"""Runs on the user's own folders: files that change between two calls, and folders without ground truth."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.methods import runner
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.outcomes import OUTCOME, differing
from oysterbench.tracks import Request
from oysterbench.tracks.slam import TRACK, SlamSequence, own_sequences
from tests.helpers.command import run as run_here
from tests.helpers.euroc import FRAMES, SAMPLES, Folder
from tests.helpers.programs import PROGRAMS, command
from tests.helpers.track_runs import finished_of

pytestmark = pytest.mark.usefixtures("inputs_here", "home")

READS = '''
import numpy as np

from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Estimate


class Reads:
    """Reads everything, and stays where it is."""

    name, track = "reads", "slam"

    def run(self, sequence):
        stamps = np.unique([item.stamp_ns for item in sequence.stream()])
        path = Trajectory(stamps, np.zeros((len(stamps), 3)), np.tile([0.0, 0, 0, 1], (len(stamps), 1)))
        return Estimate(path, {"initialised": 0}, health=np.zeros(len(stamps), dtype=np.uint8))
'''


TRUTH = "".join(f"{stamp},{k},0,0,1,0,0,0\n" for k, stamp in enumerate(SAMPLES))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder without ground truth, and a method `reading:Reads` that reads it."""
    (tmp_path / "reading.py").write_text(READS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    return Folder(tmp_path / "dive")


def run(folder, tmp_path, *methods, **options):
    return finished_of(TRACK, own_sequences([folder.path]), methods, SlamSettings(), tmp_path / "out", **options)


CHANGES = {
    "cam0/sensor.yaml": lambda folder: folder.change("cam0/sensor.yaml", "[25.0, ", "[26.0, "),
    "cam0/data.csv": lambda folder: folder.change("cam0/data.csv", "filename", "name"),
    "cam0/data/": lambda folder: os.utime(next((folder.root / "cam0" / "data").iterdir()), (1, 1)),
    "imu0/sensor.yaml": lambda folder: folder.change("imu0/sensor.yaml", "rate_hz: 200", "rate_hz: 201"),
    "cam1/sensor.yaml": lambda folder: folder.add_camera("cam1"),
}


@pytest.mark.parametrize("file", CHANGES)
def test_a_folder_is_known_by_every_file_that_methods_read(file, folder):
    before = origin(folder)
    folder.write("state_groundtruth_estimate0/data.csv", TRUTH)  # which no method reads
    assert origin(folder) == before
    CHANGES[file](folder)
    differ = {line.partition(" ")[2] for line in origin(folder) ^ before}
    assert file in differ
    assert all(name.startswith(file[:5]) for name in differ)


def origin(folder) -> set[str]:
    (sequence,) = own_sequences([folder.path])
    return set(sequence.origin.splitlines())


def test_a_result_is_not_that_of_a_folder_whose_files_changed_since(folder, tmp_path):
    write_answer(tmp_path)
    mine = ExternalCommand(command(tmp_path, "copies", tmp_path / "answer.tum", "euroc"), "mine")
    first, second = run(folder, tmp_path, mine) + run(folder, tmp_path, mine)
    assert (first.failure, second.failure) == (None, None)
    assert (first.outcome.earlier, second.outcome.earlier) == (False, True)
    CHANGES["cam0/sensor.yaml"](folder)
    with pytest.raises(
        MethodError, match=r"holds run 1 of a different mine \(cam0/sensor.yaml changed\); .* with --again"
    ):
        run(folder, tmp_path, mine)


def test_a_program_in_a_shell_that_changed_is_refused_and_one_that_did_not_is_told_to_be_of_an_earlier_run(
    folder, tmp_path, monkeypatch
):
    write_answer(tmp_path)
    copies = command(tmp_path, "copies", tmp_path / "answer.tum", "euroc")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    program = Path("my_slam")
    program.write_text(f"#!/bin/sh\n{copies.format(euroc='$1', out='$2')}\n")
    program.chmod(0o755)
    line = f"sh -c 'HERE={tmp_path}/work; ./my_slam \"{{euroc}}\" {{out}}'"
    said: list[str] = []
    for k in range(2):
        (done,) = run(folder, tmp_path, ExternalCommand(line, "mine"), announce=said.append)
        assert (done.failure, done.outcome.earlier) == (None, bool(k))
    (told,) = (text for text in said if "earlier" in text)
    assert "out: kept 1 of 1 runs from an earlier command, the last of 20" in told
    assert "and did not run them again; `oysterbench run` with --again reruns them" in told
    program.write_text("#!/bin/sh\nexit 5\n")
    with pytest.raises(MethodError, match=r"holds run 1 of a different mine \(my_slam changed\)"):
        run(folder, tmp_path, ExternalCommand(line, "mine"))


def test_what_differs_from_the_run_that_a_folder_holds_is_named(folder, tmp_path):
    write_answer(tmp_path)
    copies = command(tmp_path, "copies", tmp_path / "answer.tum", "euroc")
    run(folder, tmp_path, ExternalCommand(copies, "mine"))
    before = (tmp_path / "answer.tum").read_text()
    for line, poses_of, change, what in (
        (copies, "base", "", "poses_of differs"),
        (f"{copies} -v", "", "", "command differs"),
        (f"{copies} -v", "base", "", "command, poses_of differ"),
        (f"{copies} {{seed}}", "", "", "command, seed differ"),
        (f"{copies} -v", "", "# another\n", r"command differs; \S+/answer.tum changed"),
    ):
        (tmp_path / "answer.tum").write_text(before + change)
        with pytest.raises(MethodError, match=rf"holds run 1 of a different mine \({what}\); it was left"):
            run(folder, tmp_path, ExternalCommand(line, "mine", poses_of=poses_of))


def test_what_differs_in_a_sequence_of_a_split_is_named():
    method = {"method": "mine"}
    before = {"method": method, "origin": "slam-mini 12ab mini-01", "seed": None}
    for origin, what in (
        ("slam-mini 12ab mini-01 /imu", ["topics"]),
        ("slam-mini 34cd mini-01", ["recipe"]),
        ("/home/me/my own sea dives/mini-01.mcap\n12ab mini-01.mcap", ["sequence"]),
    ):
        assert differing(before, {**before, "origin": origin}) == what


def write_answer(tmp_path: Path) -> None:
    (tmp_path / "answer.tum").write_text("".join(f"{s * 1e-9:.9f} {k} 0 0 0 0 0 1\n" for k, s in enumerate(SAMPLES)))


def test_a_program_is_given_the_files_as_they_are_now(folder, tmp_path, monkeypatch):
    shows = "import pathlib, shutil; print(pathlib.Path(argv[1], 'mav0/cam0/sensor.yaml').read_text())\n"
    monkeypatch.setitem(PROGRAMS, "shows", f"{shows}shutil.copy(argv[0], argv[2])")
    write_answer(tmp_path)
    shows = ExternalCommand(command(tmp_path, "shows", tmp_path / "answer.tum", "euroc"), "shows")
    options = {"exports": tmp_path / "exports", "again": True}
    run(folder, tmp_path, shows, **options)
    folder.change("cam0/sensor.yaml", "[25.0, ", "[26.0, ")
    (done,) = run(folder, tmp_path, shows, **options)
    assert "intrinsics: [26" in (done.job.folder(tmp_path / "out") / "stdout.txt").read_text()


def test_a_failure_names_the_users_own_file_and_is_gone_when_that_is_mended(folder, tmp_path):
    picture = min((folder.root / "cam0" / "data").iterdir())
    good = picture.read_bytes()
    picture.write_bytes(b"no picture")
    (done,) = run(folder, tmp_path, "reading:Reads")
    assert str(picture) in done.failure
    assert "oysterbench-run-" not in done.failure
    picture.write_bytes(good)
    (done,) = run(folder, tmp_path, "reading:Reads")
    assert done.failure is None


def test_a_failure_of_an_earlier_run_is_told_as_one(folder, tmp_path):
    folder.change("imu0/data.csv", ",0,0,", ",x,0,")
    words = ("run", "reading:Reads", "--on", folder.path, "--out", tmp_path / "out")
    first, second = run_here(*words), run_here(*words)
    assert "--retry" not in first.stderr
    assert "; this is the result of an earlier run: --retry repeats it\n" in second.stderr


def test_a_run_that_could_not_be_scored_is_one_that_failed_and_is_retried(folder, tmp_path, monkeypatch):
    folder.write("state_groundtruth_estimate0/data.csv", TRUTH)
    work = tmp_path / "work"  # programs write there, and cannot do so beside the results
    work.mkdir()
    answer, log = work / "answer.tum", work / "log"
    notes = "open(argv[0] + '/log', 'a').write('run\\n'); import shutil; shutil.copy(argv[0] + '/answer.tum', argv[2])"
    monkeypatch.setitem(PROGRAMS, "notes", notes)
    notes = ExternalCommand(command(tmp_path, "notes", work, "euroc"), "notes")

    def tried(**options):
        """Failure of a run, and how often it was run so far."""
        (found,) = run(folder, tmp_path, notes, **options)
        return found.failure, len(log.read_text().splitlines())

    answer.write_text("".join(f"{stamp * 1e-9:.9f} 0 0 0 0 0 0 1\n" for stamp in SAMPLES[:2]))
    failure, count = tried()
    assert "expected at least 5" in failure
    assert tried() == (failure, count)
    assert tried(retry=True) == (failure, count + 1)
    write_answer(work)
    assert tried(retry=True) == (None, count + 2)
    assert tried(retry=True) == (None, count + 2)


def test_without_ground_truth_a_method_that_never_initialised_is_told_of_and_leaves_its_health(folder, tmp_path):
    done = run_here("run", "reading:Reads", "--on", folder.path, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "dive has no ground truth to score against; the predictions: " in done.stderr
    assert "reads on dive: never initialised: nothing that it saw is in its path" in done.stderr
    health = (tmp_path / "out" / "dive-reads.health.csv").read_text().splitlines()
    assert len(health) == 1 + len({*SAMPLES, *FRAMES})
    assert (tmp_path / "out" / "dive-reads.tum").is_file()


def test_a_ground_truth_that_cannot_be_read_is_refused_before_anything_runs(folder, tmp_path):
    folder.write("state_groundtruth_estimate0/data.csv", TRUTH)
    folder.write("state_groundtruth_estimate0/sensor.yaml", "T_BS: [0, 1]")
    done = run_here("run", "reading:Reads", "--on", folder.path, "--out", tmp_path / "out")
    assert (done.returncode, "running reads" in done.stderr) == (1, False)
    assert "state_groundtruth_estimate0/sensor.yaml: T_BS, data: expected 16 finite numbers, got 2" in done.stderr


def test_folders_whose_names_are_not_utf_8_are_run_on_and_written_to(folder, tmp_path):
    odd = os.fsdecode(b"l\xe4t")
    folder.write("state_groundtruth_estimate0/data.csv", TRUTH)
    place, out = tmp_path / odd / os.fsdecode(b"\xe4"), tmp_path / odd / "out"
    place.parent.mkdir()
    folder.path.rename(place)
    write_answer(tmp_path / odd)
    line = command(tmp_path / odd, "copies", tmp_path / odd / "answer.tum", "euroc")
    done = run_here("run", "mine", "--command", line, "--on", place, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "l?t" in (out / "report.html").read_text(encoding="utf-8")
    compared = run_here("compare", out)
    assert compared.returncode == 0, compared.stderr


def test_runs_that_were_to_be_repeated_go_on_after_an_interruption(dive_file, tmp_path):
    answer = tmp_path / "work" / "answer.tum"
    answer.parent.mkdir()
    write_tum(answer, oysterbench.open(dive_file).truth())
    counts = ExternalCommand(command(tmp_path, "counts", answer, "mcap", "{seed}"), "counts")
    log, sequences = Path(f"{answer}.log"), [SlamSequence("hand-made", dive_file)]
    finished_of(TRACK, sequences, [counts], SlamSettings(), tmp_path / "out", runs=3)
    again = Request(tmp_path / "out", jobs=1, runs=3, again=True)
    begun = TRACK.run(sequences, [counts], SlamSettings(), again)
    next(begun)
    begun.close()  # as by Ctrl-C
    assert log.read_text() == "0\n1\n2\n0\n"
    resumed = list(TRACK.run(sequences, [counts], SlamSettings(), again))
    assert [done.outcome.earlier for done in resumed] == [True, False, False]
    assert log.read_text() == "0\n1\n2\n0\n1\n2\n"
    list(TRACK.run(sequences, [counts], SlamSettings(), again))
    assert log.read_text() == "0\n1\n2\n" * 3


def test_what_the_machine_ended_in_a_repetition_is_all_that_the_same_command_runs_again(dive_file, tmp_path):
    answers = [tmp_path / "work" / f"{name}.tum" for name in ("fine", "lost")]
    answers[0].parent.mkdir()
    for answer in answers:
        write_tum(answer, oysterbench.open(dive_file).truth())
    fine = ExternalCommand(command(tmp_path, "counts", answers[0], "mcap", "{seed}"), "fine")
    lost = ExternalCommand(command(tmp_path, "killed", answers[1]), "lost")
    logs = [Path(f"{answer}.log") for answer in answers]
    again = Request(tmp_path / "out", jobs=1, again=True)

    def repeated() -> list[int]:
        list(TRACK.run([SlamSequence("hand-made", dive_file)], [fine, lost], SlamSettings(), again))
        return [len(log.read_text().splitlines()) for log in logs]

    assert repeated() == [1, 1]
    assert repeated() == [1, 2]
    assert repeated() == [2, 3]


def test_a_repetition_that_was_interrupted_is_gone_on_with_for_a_day_and_says_so(folder, tmp_path):
    work, out, said = tmp_path / "work", tmp_path / "out", list[str]()
    work.mkdir()
    write_answer(work)
    counts = ExternalCommand(command(tmp_path, "counts", work / "answer.tum", "euroc", "{seed}"), "counts")

    def repeated(finished):
        """Seeds of the runs so far, after as many of two were finished once more."""
        request = Request(out, runs=2, jobs=1, again=True, announce=said.append)
        found = TRACK.run(own_sequences([folder.path]), [counts], SlamSettings(), request)
        for _ in range(finished):
            next(found)
        found.close()
        return (work / "answer.tum.log").read_text().split()

    assert repeated(1) == ["0"]
    assert repeated(2) == ["0", "1"]
    (told,) = (text for text in said if "repetition" in text)
    begun = "going on with the repetition begun 20.*Z, of which 1 of 2 runs are there"
    assert re.fullmatch(rf"{out}: {begun}; to begin anew, delete {out}/again", told)
    before = time.time() - 1.1 * runner.REPETITION_S
    for path in (out / runner.AGAIN, *out.rglob(OUTCOME)):
        os.utime(path, (before, before))
    assert repeated(1) == ["0", "1", "0"]


def test_eval_does_not_go_on_with_an_evaluation_that_was_interrupted(tmp_path, monkeypatch):
    (tmp_path / runner.AGAIN).write_text("of these jobs")
    begun: list[bool] = []
    monkeypatch.setattr("oysterbench.cli.eval.evaluate", lambda track, request, outputs: begun.append(request.again))
    assert run_here("eval", "slam", "--split", "slam-mini", "--out", tmp_path).returncode == 0
    assert begun == [True]
    assert not (tmp_path / runner.AGAIN).exists()
