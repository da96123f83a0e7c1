"""The command `render`: what it is asked for, what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import oysterbench
from oysterbench.cli.main import main
from oysterbench.sequence.cut import cut_to
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

TWO = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0").replace('rig = "tiny"', 'rig = "rig.toml"')
TWO += TWO[TWO.index("[[sequence]]") :].replace("tiny-01", "tiny-02")


@pytest.fixture
def recipe(tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    (tmp_path / "tiny.toml").write_text(TWO)
    return tmp_path / "tiny.toml"


def render(recipe, *args):
    return CliRunner().invoke(main, ["render", str(recipe), "--out", str(recipe.parent / "out"), *args])


def test_one_sequence_of_two_is_rendered(recipe):
    result = render(recipe, "--sequence", "tiny-02", "--workers", "1", "--json")
    assert result.exit_code == 0, result.stderr
    assert list(json.loads(result.stdout)["files"]) == ["tiny-02"]
    assert sorted(path.name for path in (recipe.parent / "out").glob("*.mcap")) == ["tiny-02.mcap"]
    assert "rendering tiny: 0 of 10 frames" in result.stderr
    assert "rendering tiny: 10 of 10 frames" in result.stderr


def test_some_topics_go_to_a_folder_of_their_own_and_are_cut_from_what_is_there(recipe, home):
    options = ["render", str(recipe), "--sequence", "tiny-02", "--workers", "1"]
    first = CliRunner().invoke(main, [*options, "--topics", "/imu"])
    assert first.exit_code == 0, first.stderr
    assert "frames" not in first.stderr, "none is needed"
    (small,) = home.rglob("*.mcap")
    assert Path(first.stdout.strip()) == small
    assert small.parent.name.startswith("topics-")
    assert CliRunner().invoke(main, options).exit_code == 0
    images = CliRunner().invoke(main, [*options, "--topics", "/cam_front/image"])
    assert images.exit_code == 0, images.stderr
    assert "10 of 10" not in images.stderr, "they are cut from the complete file"
    assert oysterbench.open(images.stdout.strip()).contents()[0][::2] == ("/cam_front/image", 10)
    assert sorted(len(oysterbench.open(path).contents()) for path in home.rglob("*.mcap"))[:2] == [1, 1]
    complete = next(path.parent for path in home.rglob("*.mcap") if not path.parent.name.startswith("topics-"))
    among = CliRunner().invoke(main, [*options, "--topics", "/tf_static", "--out", str(complete)])
    assert (among.exit_code, "complete sequences are kept here" in among.stderr) == (1, True)
    (complete / "tiny-02.mcap").unlink()
    cut_to(complete / "tiny-02.mcap", small, ["/imu"])
    wrong = CliRunner().invoke(main, [*options, "--topics", "/tf_static"])
    assert wrong.exit_code == 1
    assert f"{complete / 'tiny-02.mcap'} has 1 topics, expected 10" in wrong.stderr
    preview = CliRunner().invoke(main, [*options, "--topics", "/imu", "--preview"])
    assert (preview.exit_code, "it takes no --topics" in preview.stderr) == (2, True)


def test_an_unknown_sequence_is_named(recipe):
    result = render(recipe, "--sequence", "tiny-03")
    assert result.exit_code == 1
    assert result.stderr == "oysterbench: split tiny has no sequence 'tiny-03'; it has tiny-01, tiny-02\n"


def test_a_sheet_of_one_sequence_is_previewed(recipe):
    result = render(recipe, "--sequence", "tiny-02", "--preview")
    assert result.exit_code == 0, result.stderr
    assert [path.name for path in (recipe.parent / "out").iterdir()] == ["tiny-tiny-02-preview.png"]


def test_workers_and_a_scheduler_exclude_each_other(recipe):
    result = render(recipe, "--workers", "2", "--scheduler", "tcp://127.0.0.1:9")
    assert result.exit_code == 2
    assert "a cluster has its own workers" in result.stderr


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_missing_gpu_is_one_clear_line(recipe, workers):
    import warp

    if warp.is_cuda_available():
        pytest.skip("there is a CUDA device")
    result = render(recipe, "--device", "cuda", "--workers", workers)
    assert result.exit_code == 1
    lines_shown = [line for line in result.stderr.splitlines() if line.startswith("oysterbench: ")]
    assert len(lines_shown) == 1
    assert "--device cuda: there is no such device here; expected one of cpu" in lines_shown[0]
