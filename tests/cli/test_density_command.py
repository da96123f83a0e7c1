"""The commands that make and score maps: options that do not belong together are refused before anything is read."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from oysterbench.annotations.forms import FORMS
from oysterbench.cli.main import STATES, main
from oysterbench.cli.map import KINDS, _settings
from oysterbench.core.errors import OptionError
from oysterbench.core.trajectory import write_tum
from oysterbench.mapping import MapSettings
from oysterbench.scene.oyster import STATES as scene_states
from oysterbench.sequence import open_sequence


def error_of(*arguments: str) -> str:
    """What a command that is refused says."""
    result = CliRunner().invoke(main, list(arguments))
    assert result.exit_code != 0
    return result.output


def test_a_map_and_a_cloud_have_options_of_their_own(tmp_path):
    common = ("map", "x.mcap", "--trajectory", "p.tum")
    assert "--cell, " not in error_of(*common, "--out", "x.ply", "--cell", "0.5")
    assert "--cell: only for a map: give --masks" in error_of(*common, "--out", "x.ply", "--cell", "0.5")
    assert "--voxel: only for a cloud" in error_of(*common, "--out", "m", "--masks", "truth", "--voxel", "0.1")
    assert "a map uses one camera" in error_of(*common, "--out", "m", "--masks", "t", "--camera", "a", "--camera", "b")


@pytest.mark.parametrize("option", ["--far", "--cell", "--voxel", "--threshold"])
@pytest.mark.parametrize("value", ["inf", "nan"])
def test_a_length_is_a_finite_number(option, value):
    said = error_of("map", "x.mcap", "--trajectory", "p.tum", "--out", "m", option, value)
    assert f"'{option}': '{value}' is not a finite number" in said


@pytest.mark.parametrize("option", ["--far", "--cell", "--voxel", "--threshold"])
def test_what_a_map_refuses_is_told_by_the_name_of_its_option(option):
    common = ("map", "x.mcap", "--trajectory", "p.tum", "--out", "m")
    assert f"'{option}': -1.0 is not in the range" in error_of(*common, option, "-1").replace("-1 ", "-1.0 ")
    with pytest.raises(OptionError, match=r"^--far: expected more than near_m"):
        _settings(MapSettings, {"far_m": 0.01})
    assert "<=None" not in CliRunner().invoke(main, ["map", "--help"]).output


def test_a_map_is_a_folder_and_not_named_as_a_cloud(tmp_path):
    out = tmp_path / "true.ply"
    said = error_of("map", "x.mcap", "--trajectory", "p.tum", "--masks", "truth", "--out", str(out))
    assert "true.ply: expected the name of a folder for a map, or no --masks for a cloud" in said
    assert not out.exists()


def test_a_folder_of_masks_may_be_called_truth(dive_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_tum(tmp_path / "p.tum", open_sequence(dive_file).truth())
    common = ("map", str(dive_file), "--trajectory", "p.tum", "--depth", "layer", "--out", "m")
    (tmp_path / "truth").mkdir()
    said = error_of(*common, "--masks", "truth")
    assert "not an estimate" not in said
    assert "truth: expected a .png, .npy or .npz per image, got none" in said


def test_an_oyster_is_refused_by_the_names_of_its_options():
    assert scene_states == STATES
    assert "'--state': 'dead' is not one of" in error_of("oyster", "--state", "dead")
    assert "'--size': " in error_of("oyster", "--size", "5")


def test_a_map_reads_every_kind_of_masks():
    assert KINDS == FORMS


def test_a_cloud_needs_the_name_of_a_ply_file():
    result = CliRunner().invoke(main, ["map", "x.mcap", "--trajectory", "p.tum", "--out", "folder"])
    assert result.exit_code == 1
    assert ".ply" in result.output


@pytest.mark.parametrize("options", [("--cell", "0.5"), ("--depth", "plane"), ("--poses", "here")])
def test_options_of_the_density_track_are_refused_elsewhere(options):
    assert f"{options[0]}: of the track density" in error_of("eval", "--track", "slam", *options)


def test_options_of_run_are_said_to_be_its():
    said = error_of("eval", "density", "--topics", "/imu")
    assert "--topics: an option of `oysterbench run --track density`, not of eval" in said
    assert "No such option '--topicality'" in error_of("eval", "density", "--topicality", "3")


def test_options_of_other_tracks_are_refused_on_the_density_track():
    assert "--associate: of the track slam" in error_of("eval", "--track", "density", "--associate", "nearest")
    assert "--threshold" in error_of("eval", "--track", "density", "--threshold", "0.4")


def test_a_map_of_the_ground_truth_says_so_wherever_it_is_read(dive_file, tmp_path):
    out = tmp_path / "m"
    given = ("map", str(dive_file), "--trajectory", "truth", "--masks", "truth", "--depth", "layer", "--out", str(out))
    done = CliRunner().invoke(main, given)
    told = "the true path and masks are used: this map is not an estimate"
    assert done.exit_code == 0, done.output
    assert done.stderr.count(told) == 1
    assert told in json.loads((out / "summary.json").read_text())["notes"]
    assert told[1:] in (out / "map.html").read_text(), "as a sentence"
