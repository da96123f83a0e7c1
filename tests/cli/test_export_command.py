"""`oysterbench export` and `view`: what they take, what they write, and one line for what they cannot."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from oysterbench.annotations.export import SET_FORMATS
from oysterbench.cli import progress
from oysterbench.cli.main import main


def run(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result


def refused(result, *said):
    assert result.exit_code in (1, 2)
    assert result.stdout == ""
    assert all(words in result.stderr for words in said), result.stderr


def test_the_help_names_every_format_of_labelled_pictures():
    text = run("export", "--help").stdout
    assert all(re.search(rf"^ +{form} +\w", text, re.M) for form in SET_FORMATS)


@pytest.mark.parametrize("form", ["yolo", "webdataset"])
def test_labelled_pictures_of_a_file_are_exported(dive_file, tmp_path, form):
    result = run("export", dive_file, "--format", form, "--out", tmp_path / "out")
    assert (result.exit_code, result.stdout) == (0, f"{tmp_path / 'out'}\n"), result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_does_not_go_together_is_one_line(dive_file, tmp_path):
    out = ("--out", tmp_path / "out")
    refused(run("export", dive_file, dive_file, "--format", "tum", *out), "takes one sequence, got 2")
    refused(run("export", "seg-mini", "--format", "euroc", *out), "is a split", "oysterbench download seg-mini")
    refused(
        run("export", dive_file, "--format", "yolo", "--no-truth", *out),
        "--no-truth",
        "which are ground truth",
    )
    refused(run("export", dive_file, "--format", "yollo", *out), "did you mean yolo")
    refused(run("view", dive_file, "--foxglove", tmp_path / "a.json", "--rerun"), "--foxglove")
    refused(run("view", dive_file, "--align", "se3"), "--align")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_ground_truth_is_exported_with_the_option_that_the_refusal_names(dive_file, tmp_path):
    assert run("export", dive_file, "--format", "euroc", "--out", tmp_path / "in", "--no-truth").exit_code == 0
    words = ("export", tmp_path / "in", "--format", "tum", "--out", tmp_path / "out")
    refused(run(*words), "has no ground truth: ", "data.csv is absent; --no-truth exports it without\n")
    assert run(*words, "--no-truth").exit_code == 0


def test_a_layout_for_foxglove_is_written_alone(dive_file, tmp_path):
    result = run("view", dive_file, "--foxglove", tmp_path / "layout.json")
    assert (result.exit_code, result.stdout) == (0, f"{tmp_path / 'layout.json'}\n"), result.stderr
    assert "3D!scene" in json.loads((tmp_path / "layout.json").read_text())["configById"]


def test_progress_is_shown_of_what_takes_long_and_of_nothing_else(dive_file, tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "LATE_S", 1e9)  # whatever else the machine does meanwhile
    assert "images" not in run("view", dive_file, "--out", tmp_path / "a.html").stderr
    monkeypatch.setattr(progress, "LATE_S", 0.0)
    assert "of 160 images" in run("view", dive_file, "--out", tmp_path / "b.html").stderr
    assert "of 40 images" in run("export", dive_file, "--format", "euroc", "--out", tmp_path / "c").stderr
