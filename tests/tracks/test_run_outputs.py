"""What programs leave at {out}: said to be what it is where it is no trajectory, and in words that are for them."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

import oysterbench
from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.trajectory import read_trajectory, write_npz, write_tum
from oysterbench.methods.adapters import ExternalCommand
from oysterbench.methods.interfaces import slam
from oysterbench.methods.interfaces.slam import ESTIMATE, read_estimate
from tests.helpers.programs import PROGRAMS, command

OTHERS = {
    "makes a folder": "os.mkdir(argv[2])",
    "links": "os.symlink(argv[0], argv[2])",
    "fills a folder": "os.mkdir(argv[2]); open(argv[2] + '/poses.txt', 'w').write('1 2 3')",
    "goes back": "open(argv[2], 'w').writelines(reversed(open(argv[0]).readlines()))",
}


@pytest.fixture
def answer(dive_file, tmp_path):
    """The true poses of the vehicle as a TUM file."""
    path = tmp_path / "work" / "answer.tum"
    path.parent.mkdir()
    write_tum(path, oysterbench.open(dive_file).truth())
    return path


@pytest.mark.parametrize(
    ("program", "failure"),
    [
        (
            "makes a folder",
            r"exited .*wrote no trajectory to \{out\}: it is a folder without files; write to \{out\} itself",
        ),
        (
            "links",
            r"exited .* to \{out\}: it is a link, to \S+answer.tum, and links are not followed; write the file itself ",
        ),
        ("fills a folder", r"wrote no readable trajectory: \S+ is a folder; expected a trajectory: TUM"),
        (
            "goes back",
            r"wrote no .*:2: expected increasing .*; sort the poses by time; the program itself has to do so",
        ),
    ],
)
def test_what_is_no_trajectory_is_said_to_be_what_it_is(program, failure, run, answer, tmp_path, monkeypatch):
    monkeypatch.setitem(PROGRAMS, "mine", OTHERS[program])
    (done,) = run(ExternalCommand(command(tmp_path, "mine", answer), "mine"))
    assert re.fullmatch(f"method 'mine' on hand-made: {failure}.*", done.failure), done.failure
    assert "--" not in done.failure


def test_of_a_sequence_without_cameras_it_is_said_whose_poses_were_assumed_and_no_option_is_named_as_given():
    with pytest.raises(MethodError) as caught:
        slam.frame_pose(SimpleNamespace(name="dive", cameras={}), "camera", "tum")
    assert str(caught.value).startswith(
        "sequence dive has no camera, whose poses a program that reads {tum} is taken to write: "
    )


def test_unsorted_poses_of_a_python_method_are_its_own_to_sort(answer, tmp_path):
    found = read_trajectory(answer)
    write_npz(tmp_path / ESTIMATE, replace(found, stamps_ns=found.stamps_ns[::-1]))
    with pytest.raises(MethodError, match=r"sort the poses by time; the method itself has to do so$"):
        read_estimate(tmp_path)


def test_poses_in_millimetres_are_said_to_be_in_them(run, dive_file, answer, tmp_path):
    truth = oysterbench.open(dive_file).truth()
    write_tum(answer, replace(truth, positions=1000 * truth.positions))
    (done,) = run(ExternalCommand(command(tmp_path, "copies", answer), "copies"))
    assert any("is the estimate in millimetres? Metres are expected" in note for note in done.scored.record.notes)


def test_files_of_runs_that_the_results_no_longer_have_are_deleted(run, answer, tmp_path):
    mine, other = (ExternalCommand(command(tmp_path, "copies", answer), name) for name in ("mine", "mine-2"))
    run(mine, runs=3)
    out = next(tmp_path.rglob("hand-made-mine-3.tum")).parent
    (out / "hand-made-mine-3.online.tum").touch()
    for own in ("hand-made-notes.tum", "hand-made-mine.sim3.tum", "hand-made-mine-7.tum"):
        (out / own).touch()
    run(other)
    run(mine)
    assert {path.name for path in out.glob("*.tum")} == {
        "hand-made-mine.tum",
        "hand-made-mine-2.tum",  # of the method named mine-2
        "hand-made-notes.tum",
        "hand-made-mine.sim3.tum",
        "hand-made-mine-7.tum",
        "hand-made-truth.tum",
    }


def test_the_path_of_a_run_that_now_fails_is_deleted(run, answer, tmp_path):
    run(ExternalCommand(command(tmp_path, "copies", answer), "mine"))
    out = next(tmp_path.rglob("hand-made-mine.tum")).parent
    run(ExternalCommand(command(tmp_path, "silent", answer), "mine"), again=True)
    assert not (out / "hand-made-mine.tum").exists()


def test_an_input_that_cannot_be_made_is_no_failure_of_the_method(run, answer, tmp_path, monkeypatch):
    def refuse(path, form, out):
        raise SequenceError("hand-made has no /imu")

    mine = ExternalCommand(command(tmp_path, "copies", answer), "mine")
    with monkeypatch.context() as patch:
        patch.setattr(slam, "write_input", refuse)
        (done,) = run(mine)
    assert done.scored is None
    words = r"on hand-made: its input \{mcap\} could not be made: hand-made has no /imu; the run is not counted"
    assert re.search(words, done.failure)
    (done,) = run(mine)
    assert done.scored.record.failure is None
