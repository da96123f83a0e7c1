"""`oysterbench eval --track steering`: what it prints, leaves and refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.evaluate.steering.metrics import PICTURES, ROLLOUTS
from oysterbench.tracks import TRACKS
from tests.helpers.exploring_made import REEF, RIG, SPLIT, label_table, made_explore, write_labelled
from tests.helpers.paths import ROOT

PAGE = ROOT / "oysterbench" / "exploration" / "README.md"
READER = "tests.helpers.exploring_policies:Reader"


@pytest.fixture
def recipe(tmp_path, monkeypatch, home) -> Path:
    """A split in a file; its sequences are made by hand, and dives follow from commands alone."""
    (tmp_path / "rig.toml").write_text(RIG)
    text = SPLIT.replace('rig = "explorer"', 'rig = "rig.toml"')
    path = tmp_path / "made.toml"
    path.write_text(text + "".join(REEF.format(name=name, water="1C") for name in ("one", "two")))
    files = {
        name: write_labelled(tmp_path / f"{name}.mcap", name, label_table(6, seed))
        for seed, name in enumerate(("one", "two"))
    }
    monkeypatch.setattr("oysterbench.cli.render.render_files", lambda split, **options: files)
    monkeypatch.setattr("oysterbench.tracks.steering_rollouts._explore", lambda: made_explore)
    return path


def run(*arguments: object):
    """The command, in this process."""
    return CliRunner().invoke(main, ["eval", "--track", "steering", *map(str, arguments)])


def picture_of(path: Path) -> np.ndarray:
    """A PNG that was left."""
    pixels = cv2.imread(str(path))
    assert pixels is not None
    return pixels


def test_pictures_are_scored_printed_and_drawn(recipe, tmp_path):
    out = tmp_path / "out"
    result = run("--split", recipe, "--method", READER, "--method", "straight", "--out", out)
    assert result.exit_code == 0, result.output
    assert re.search(r"one +reader +1\.000 +0\.00 +100\.0 +1\.000 +0\.0", result.stdout)
    assert "Over all images" in result.stdout
    assert "12 images of 2 sequences" in result.stdout
    left = {path.name for path in out.iterdir()}
    assert left >= {"results.json", "results.csv", "results.tex", "results.md", "report.html"}
    assert left >= {"confusion-reader.png", "confusion-straight.png"}
    own, straight = (picture_of(out / f"confusion-{name}.png") for name in ("reader", "straight"))
    assert own.shape == straight.shape
    assert (own != straight).any()
    assert picture_of(out / "images.png").size
    page = (out / "report.html").read_text()
    assert page.count("<svg xmlns") == 3
    assert "Confusions of reader" in page
    assert "Over all images" in page
    assert "Over all images" in (out / "results.md").read_text()
    for told in (result.stdout, page, (out / "results.md").read_text()):
        assert re.search(
            r"best constant: .* (left|right|up|down) at every image has a skill of \S+, the mean over", told
        )
    methods = {one["method"] for one in json.loads((out / "results.json").read_text())["results"]}
    assert methods == {"reader", "straight"}, "it is a reference, not a result"


@pytest.mark.slow
def test_json_is_all_that_is_printed(recipe, tmp_path):
    out = tmp_path / "out"
    result = run("--split", recipe, "--sequence", "two", "--json", "--out", out)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [(one["sequence"], one["method"]) for one in document["results"]] == [("two", "straight"), ("two", "chance")]
    assert document == json.loads((out / "results.json").read_text())


@pytest.mark.slow
def test_dives_are_made_once_printed_and_drawn(recipe, tmp_path):
    out = tmp_path / "out"
    options = (
        "--split",
        recipe,
        "--closed-loop",
        "--method",
        READER,
        "--workers",
        1,
        "--out",
        out,
    )
    first = run(*options)
    assert first.exit_code == 0, first.output
    assert re.search(r"one +expert +195\.0", first.stdout)
    assert "Place between random and expert" in first.stdout
    assert re.search(r"expert . lawnmower +Oysters \[per min\]", first.stdout)
    assert "8 of 8 rollouts" in first.stderr
    assert len(list((out / "rollouts").iterdir())) == 8
    for name in ("policies", "rollouts-one", "rollouts-two"):
        assert picture_of(out / f"{name}.png").shape[2] == 3
    assert (out / "report.html").read_text().count("<svg xmlns") == 3
    times = {path: path.stat().st_mtime_ns for path in (out / "rollouts").iterdir()}
    assert run(*options).stdout == first.stdout
    assert {path: path.stat().st_mtime_ns for path in (out / "rollouts").iterdir()} == times
    assert run(*options, "--again").exit_code == 0
    assert all(path.stat().st_mtime_ns > time for path, time in times.items())


@pytest.mark.slow
def test_reefs_and_seconds_are_as_many_as_asked_for(recipe, tmp_path):
    result = run("--split", recipe, "--closed-loop", "--reefs", 1, "--seconds", 5, "--json", "--out", tmp_path / "o")
    records = json.loads(result.stdout)["results"]
    assert {one["sequence"] for one in records} == {"one"}
    assert [one["method"] for one in records] == ["expert", "lawnmower", "random"]
    assert {one["metrics"]["rollout_s"] for one in records} == {5}


@pytest.mark.slow
@pytest.mark.parametrize("closed", [(), ("--closed-loop",)])
def test_a_failure_is_said_and_the_others_are_there(recipe, tmp_path, closed):
    methods = ("--method", "tests.helpers.exploring_policies:Broken", "--method", "straight")
    result = run("--split", recipe, *closed, *methods, "--workers", 1, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert re.search(r"[Bb]roken failed on one: .*no such weight", result.stderr)
    assert (result.stdout + result.stderr).count("no such weight") == 2, "once for each of the two dives"
    assert "straight" in result.stdout
    assert (tmp_path / "out" / "report.html").is_file()


def test_all_can_fail(recipe, tmp_path):
    result = run("--split", recipe, "--method", "tests.helpers.exploring_policies:Broken", "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "failed on two" in result.stderr
    assert not list((tmp_path / "out").glob("*.png"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "unet"), "method 'unet' is of the track 'segmentation'; expected a method of 'steering'"),
        (("--method", "dead_reckoning"), "of the track 'slam'"),
        (("--method", "expert"), "add --closed-loop"),
        (("--method", "nobody"), "unknown method 'nobody'"),
        (("--sequence", "nowhere"), "nowhere"),
        (("--closed-loop", "--sequence", "nowhere"), "nowhere"),
        (("--closed-loop", "--seconds", "0"), "--seconds: expected at least 1"),
        (("--closed-loop", "--seconds", "nan"), "--seconds: expected at least 1"),
        (("--closed-loop", "--reefs", "3"), "--reefs: expected at most 2"),
    ],
)
def test_bad_requests_are_refused_in_one_line(recipe, tmp_path, options, message):
    result = run("--split", recipe, "--out", tmp_path / "out", *options)
    assert result.exit_code == 1
    assert result.stdout == ""
    assert re.fullmatch(rf"oysterbench: [^\n]*{re.escape(message)}[^\n]*\n", result.stderr), result.stderr


@pytest.mark.parametrize("closed", [(), ("--closed-loop",)])
def test_a_split_of_another_track_is_refused(home, closed):
    result = run("--split", "slam-mini", *closed)
    assert result.exit_code == 1
    assert (
        "slam-mini is of the track slam, but steering runs on splits of steering, such as steer-mini" in result.stderr
    )


@pytest.mark.parametrize("closed", [(), ("--closed-loop",)])
def test_a_hidden_split_needs_its_salt(home, closed, monkeypatch):
    for name in ("OYSTERBENCH_SALT", "OYSTERBENCH_SALT_FILE"):
        monkeypatch.delenv(name, raising=False)
    result = run("--split", "steer-test", *closed)
    assert result.exit_code == 1
    assert "steer-test is hidden" in result.stderr


def test_a_sequence_without_labels_is_refused(recipe, tmp_path):
    write_labelled(tmp_path / "one.mcap", "one", None)
    result = run("--split", recipe, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert re.fullmatch(r"(?s).*oysterbench: [^\n]*one\.mcap has no ground truth about steering[^\n]*\n", result.stderr)


def message(*arguments: str) -> str:
    result = CliRunner().invoke(main, ["eval", *arguments])
    assert result.exit_code == 2
    return " ".join(result.output.split())


@pytest.mark.parametrize("options", [("--closed-loop",), ("--reefs", "2"), ("--seconds", "3"), ("--again",)])
def test_its_options_are_refused_elsewhere(options):
    assert f"{options[0]}: of the track steering" in message("--track", "slam", *options)
    if options[0] not in ("--closed-loop", "--again"):
        result = CliRunner().invoke(main, ["eval", "steering", *options])
        assert f"{options[0]}: for rollouts only: add --closed-loop" in result.output


@pytest.mark.parametrize("options", [("--threshold", "0.4"), ("--cell", "1"), ("--align", "se3"), ("--max-gap", "2")])
def test_options_of_other_tracks_are_refused_on_it(options):
    assert options[0] in message("--track", "steering", *options)


def test_the_page_names_every_metric_and_option():
    text = PAGE.read_text()
    for key in (*PICTURES, *ROLLOUTS):
        assert f"`{key}`" in text, key
    for option in TRACKS["steering"].options:
        assert f"`{option.name}" in text, option.name
