"""What `oysterbench submit` finds in the output of `oysterbench run`."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import replace

import pytest
from click.testing import CliRunner

import oysterbench
from oysterbench.cli.main import main
from oysterbench.core.errors import ResultError
from oysterbench.core.trajectory import write_tum
from oysterbench.methods.outcomes import Outcome
from oysterbench.results.records import ResultRecord, read_results, write_results
from oysterbench.sequence.cut import cut_public
from oysterbench_leaderboard.submissions.sending.package import find_package

NAMES = ["dive-1", "dive-2"]


def left(folder, *names: str, runs: dict[str, int] | None = None, failed: tuple[int, ...] = ()) -> None:
    """Write files of a run, which hold their names, and results of the method mine by their number on a sequence."""
    for name in names:
        (folder / f"{name}.tum").write_text(name)
    records = [
        ResultRecord(
            track="slam", split="s", sequence=one, method="mine", run=run, failure="lost" if run + 1 in failed else None
        )
        for one, number in (runs or {}).items()
        for run in range(number)
    ]
    write_results(folder / "results.json", records)


def sent(folder, **options) -> list[str]:
    return [path.read_text() for path in find_package(folder, NAMES, **options).files.values()]


def test_what_run_leaves_of_a_sequence_without_ground_truth_is_sent(dive_file, home, tmp_path, inputs_here):
    (tmp_path / "hidden").mkdir()
    with open(tmp_path / "hidden" / "hand-made.mcap", "wb") as file:
        cut_public(dive_file, file)
    write_tum(tmp_path / "answer.tum", oysterbench.open(dive_file).truth())
    out = tmp_path / "mine"
    command = f"test -e {{mcap}} && cp {tmp_path}/answer.tum {{out}}"
    words = ["run", "my_slam", "--command", f"sh -c '{command}'", "--on", str(tmp_path / "hidden"), "--out", str(out)]
    done = CliRunner().invoke(main, [*words, "--runs", "2"])
    assert done.exit_code == 0, done.output
    assert read_results(out / "results.json") == []
    found = find_package(out, ["hand-made"], run=2)
    assert found.files == {"hand-made.tum": out / "hand-made-my_slam-2.tum"}
    assert (found.runs, found.failed, found.others) == ((1, 2), (), ())
    with pytest.raises(ResultError, match="no estimates of run 7"):
        find_package(out, ["hand-made"], run=7)


def test_without_results_methods_are_told_apart_by_the_runs(tmp_path):
    left(tmp_path, "dive-1-mine", "dive-2-mine", "dive-1-mine-2", "dive-2-mine-2")
    with pytest.raises(ResultError, match=r"found none; name the files SEQUENCE.tum, or the .* \(--of NAME\)"):
        find_package(tmp_path, NAMES)
    with pytest.raises(ResultError, match=re.escape("dive-1-mine.tum and dive-1-mine-2.tum are of different commands")):
        find_package(tmp_path, NAMES, "mine")
    for method in ("mine", "mine-2"):
        (tmp_path / "runs" / method / "dive-3").mkdir(parents=True)
    with pytest.raises(ResultError, match="has results of mine, mine-2; say whose"):
        find_package(tmp_path, NAMES)
    assert sent(tmp_path, method="mine") == ["dive-1-mine", "dive-2-mine"]
    assert sent(tmp_path, method="mine-2") == ["dive-1-mine-2", "dive-2-mine-2"]


def test_the_file_of_the_run_that_is_named_is_sent_and_no_other(tmp_path):
    files = ("dive-1-mine", "dive-1-mine-1", "dive-1-mine-2", "dive-1-mine-4", "dive-2-mine")
    left(tmp_path, *files, runs={"dive-1": 3, "dive-2": 1}, failed=(3,))
    assert sent(tmp_path, run=1) == ["dive-1-mine-1", "dive-2-mine"]
    assert sent(tmp_path, run=2) == ["dive-1-mine-2"]
    found = find_package(tmp_path, NAMES)
    assert (found.runs, found.failed) == ((1, 2), (3,))
    for run in (3, 4):
        with pytest.raises(ResultError, match=rf"no estimates of run {run}: it failed, .*; expected one of 1, 2 \(--"):
            find_package(tmp_path, NAMES, run=run)


@pytest.mark.parametrize("truth", [True, False], ids=["with results", "without ground truth"])
def test_a_path_of_an_earlier_run_is_not_sent_where_the_last_one_failed(tmp_path, truth):
    left(tmp_path, "dive-1-mine", "dive-2-mine")
    for name, failure in (("dive-1", None), ("dive-2", "exit status 3")):
        folder = tmp_path / "runs" / "mine" / name / "1"
        folder.mkdir(parents=True)
        outcome = Outcome({}, failure, 0.0, 0.0, {}, [], 0.0, {}, {}, "", "")
        outcome.write(folder)
    if truth:
        shutil.rmtree(tmp_path / "runs")
        rows = [ResultRecord(track="slam", split="s", sequence=name, method="mine") for name in NAMES]
        write_results(tmp_path / "results.json", [rows[0], replace(rows[1], failure="exit status 3")])
    assert sent(tmp_path, method="mine") == ["dive-1-mine"]


def test_a_path_of_an_earlier_run_is_not_sent_where_the_last_one_was_interrupted(tmp_path):
    left(tmp_path, "dive-1-mine", "dive-2-mine")
    (tmp_path / "runs" / "mine" / "dive-2" / "1").mkdir(parents=True)
    assert sent(tmp_path, method="mine") == ["dive-1-mine"]


@pytest.mark.parametrize("name", ["dive-2.tum", "dive-2", "dive-2-mine.tum"], ids=["file", "images", "run"])
@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda path: path.symlink_to("/nowhere/x.tum"), "a broken link, to /nowhere/x.tum"),
        (os.mkfifo, "something that is no file"),
    ],
)
def test_what_is_there_and_no_file_is_no_sequence_that_failed(tmp_path, name, make, what):
    if name == "dive-2-mine.tum":
        left(tmp_path, "dive-1-mine", runs={"dive-1": 1, "dive-2": 1})
    else:
        (tmp_path / "dive-1.tum").write_text("mine")
    make(tmp_path / name)
    with pytest.raises(ResultError, match=f"{name}: expected estimates, got {what}; mend it, or remove it"):
        find_package(tmp_path, NAMES)


def test_a_folder_named_as_a_file_of_a_sequence_is_no_sequence_that_failed(tmp_path):
    (tmp_path / "dive-1.tum").write_text("mine")
    (tmp_path / "dive-2.tum").mkdir()
    with pytest.raises(ResultError, match=r"dive-2.tum: expected estimates, got a folder; mend it, or remove it to"):
        find_package(tmp_path, NAMES)


def test_a_run_is_asked_for_where_there_are_runs(tmp_path):
    left(tmp_path, "dive-1-mine", runs={"dive-1": 1})
    with pytest.raises(ResultError, match=r"no estimates of run 7: it failed, or was not made; expected 1 \(--run\)"):
        find_package(tmp_path, NAMES, run=7)
    (tmp_path / "dive-1.tum").write_text("mine")
    with pytest.raises(
        ResultError, match="--run 7 chooses from what `oysterbench run` leaves; these files are of no run"
    ):
        find_package(tmp_path, NAMES, run=7)
