"""A split by its name: what it says of itself without data, and how its files are had."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import HubError, MachineError, RecipeError, SequenceError
from oysterbench.core.places import home as home_folder
from oysterbench.hub.manifest import build_manifest, released_manifest
from oysterbench.recipe import load_split
from oysterbench.simulation.generate import digest, split_folder
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.helpers.trees import FACTS, a_key, publish_split, write_sequence, write_split

SHORT = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0").replace('rig = "tiny"', 'rig = "rig.toml"')
TWO = SHORT + SHORT[SHORT.index("[[sequence]]") :].replace("tiny-01", "tiny-02")


@pytest.fixture(autouse=True)
def alone(home, monkeypatch):
    """An empty home, and no hub."""
    for name in ("OYSTERBENCH_HUB", "OYSTERBENCH_HUB_KEY", "OYSTERBENCH_SALT", "OYSTERBENCH_SALT_FILE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def recipe(tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    (tmp_path / "tiny.toml").write_text(TWO)
    return tmp_path / "tiny.toml"


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A folder that is set as the hub, with a split that no recipe here makes."""
    key, public = a_key(tmp_path)
    files = write_split(tmp_path / "made")
    publish_split(tmp_path / "hub", files, key)
    monkeypatch.setenv("OYSTERBENCH_HUB", str(tmp_path / "hub"))
    monkeypatch.setenv("OYSTERBENCH_HUB_KEY", public)
    return files


def test_a_split_says_what_it_is_without_any_data():
    split = oysterbench.split("slam-val")
    assert (split.name, split.version, split.track, len(split)) == ("slam-val", "1.0", "slam", 8)
    assert repr(split) == "<Split slam-val 1.0: slam, 8 sequences, none here yet>"
    assert "val-03" in split
    assert "mini-01" not in split
    assert split[1:3].names == ("val-02", "val-03")
    assert len(split[8:]) == 0
    table = split.summary()
    assert list(table.index) == list(split.names)
    assert table.loc["val-01", "duration_s"] > 0
    assert not table["here"].any()
    assert table["size_mb"].isna().all()
    assert "val-01" in split._repr_html_()
    assert not (home_folder() / "splits").exists(), "nothing was rendered for it"


def test_every_split_is_listed():
    table = oysterbench.splits()
    assert table.loc["slam-test", "hidden"]
    assert table.loc["seg-mini", "track"] == "segmentation"
    assert (table["here"] == 0).all()


@pytest.mark.parametrize(
    ("ask", "error", "pattern"),
    [
        (lambda: oysterbench.split("slam-vall"), RecipeError, "unknown split 'slam-vall'; did you mean slam-val"),
        (lambda: oysterbench.split("slam-mini")["mini-02"], SequenceError, "no sequence 'mini-02'; it has mini-01"),
        (lambda: oysterbench.split("slam-mini")[1], IndexError, "slam-mini has 1 sequence, from 0 on; got number 1"),
        (lambda: oysterbench.split("slam-test")[0], HubError, "slam-test is a hidden split.*OYSTERBENCH_HUB"),
        (lambda: oysterbench.split("slam-mini@0.1"), HubError, "renders slam-mini 1.0, and no hub is set"),
    ],
)  # fmt: skip
def test_what_cannot_be_had_is_one_line_that_says_why(ask, error, pattern):
    with pytest.raises(error, match=pattern) as raised:
        ask()
    assert "\n" not in str(raised.value)


def test_a_sequence_is_rendered_when_it_is_first_asked_for(recipe, capsys):
    split = oysterbench.split(recipe, workers=1)
    assert split.here == {}
    assert split["tiny-02"].name == "tiny-02"
    assert list(split.here) == ["tiny-02"], "and no other one"
    assert "rendering tiny: 10 of 10 frames" in capsys.readouterr().err
    before = split.here["tiny-02"].stat().st_mtime_ns
    with split[1] as sequence:
        assert len(list(sequence.images("cam_front"))) == 10
    assert split.here["tiny-02"].stat().st_mtime_ns == before
    assert capsys.readouterr().err == ""
    assert split.summary().loc["tiny-02", "here"]
    assert "1 here" in repr(split)


def test_a_render_that_is_interrupted_goes_on_where_it_was(recipe, monkeypatch):
    seen: list[int] = []

    @contextmanager
    def impatient(title, unit="frames"):
        def tell(done, total):
            seen.append(done)
            if done == 3:
                raise KeyboardInterrupt

        yield tell

    monkeypatch.setattr("oysterbench.notebook.rendering.frames_bar", impatient)
    split = oysterbench.split(recipe, workers=1)[:1]
    with pytest.raises(KeyboardInterrupt):
        split.fetch()
    assert split.here == {}, "a file is there whole or not at all"
    assert seen[-1] == 3
    seen.clear()
    monkeypatch.setattr("oysterbench.notebook.rendering.frames_bar", impatient)
    with pytest.raises(KeyboardInterrupt):  # three are there before anything is rendered again
        split.fetch()
    assert seen == [3]
    monkeypatch.undo()
    monkeypatch.setenv("OYSTERBENCH_HOME", str(recipe.parent / "home"))
    assert [sequence.name for sequence in oysterbench.split(recipe, workers=1, quiet=True)[:1]] == ["tiny-01"]


def test_what_renders_not_being_installed_is_one_line_that_says_what_to_type(recipe, monkeypatch):
    monkeypatch.setattr("oysterbench.notebook.rendering.find_spec", lambda name: None)
    with pytest.raises(MachineError, match=r"pip install 'oysterbench\[render\]'"):
        oysterbench.split(recipe)[0]


def test_a_split_that_only_a_hub_knows_is_downloaded(hub, capsys):
    split = oysterbench.split("fake-val")
    assert (split.version, split.names, split.recipe) == ("1.0", ("dive-01", "dive-02"), None)
    assert split.summary()["size_mb"].gt(0).all()
    assert split[0].name == "dive-01"
    assert list(split.here) == ["dive-01"]
    assert "downloading fake-val" in capsys.readouterr().err
    assert split.fetch()["dive-02"].read_bytes() == hub["dive-02"].read_bytes()


@pytest.mark.parametrize(
    ("split", "changed", "taken"),
    [("tiny", "", True), ("other", "", False), ("tiny", "seed = 9", False)],
    ids=["its own", "of another split", "of another recipe of its name"],
)
def test_files_are_taken_by_the_manifest_of_the_same_recipe_only(recipe, split, changed, taken):
    folder = home_folder() / "splits" / "tiny" / "1.0-x"
    file = write_sequence(folder / "tiny-01.mcap", "tiny-01")
    manifest = build_manifest({**FACTS, "split": split}, {"tiny-01": file}, digest(load_split(str(recipe))))
    (folder / "manifest.json").write_bytes(manifest.data)
    recipe.write_text(re.sub(r"seed = \d+", changed, recipe.read_text()) if changed else recipe.read_text())
    assert list(oysterbench.split(recipe).here.values()) == ([file] if taken else [])


def test_an_edited_copy_of_a_recipe_that_kept_its_name_is_not_the_released_split(tmp_path):
    folder, manifest = split_folder(load_split("slam-mini")), released_manifest("slam-mini", "1.0")
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_bytes(manifest.data)
    file = folder / "mini-01.mcap"
    file.touch()
    os.truncate(file, manifest.find(file.name).size)
    text = (Path(str(files("oysterbench_datasets"))) / "splits" / "slam-mini.toml").read_text()
    for name, change, here in (("same.toml", "", [file]), ("edited.toml", "seed = 9", [])):
        (tmp_path / name).write_text(re.sub(r"seed = \d+", change, text, count=1) if change else text)
        assert list(oysterbench.split(tmp_path / name).here.values()) == here


def test_a_recipe_of_ones_own_is_rendered_though_a_hub_is_set(recipe, hub):
    assert [sequence.name for sequence in oysterbench.split(recipe, workers=1, quiet=True)[:1]] == ["tiny-01"]


def test_a_folder_of_files_is_a_split(hub):
    split = oysterbench.split(hub["dive-01"].parent)
    assert split.names == ("dive-01", "dive-02")
    assert [sequence.name for sequence in split] == ["dive-01", "dive-02"]
    assert split.summary().loc["dive-01", "cameras"] == 2
    hub["dive-02"].unlink()
    with pytest.raises(SequenceError, match="no longer exists"):
        split["dive-02"]


def test_labelled_pictures_of_a_split_have_their_conditions(recipe):
    found = oysterbench.split(recipe, workers=1, quiet=True)[:1].labelled()
    assert repr(found) == "<LabelledSet tiny: 2 images of 1 clips>"
    assert found[0].conditions["water_type"] == "1C"
    assert "oysters>" in repr(found[0])
    assert found[0]._repr_png_().startswith(b"\x89PNG")


def test_importing_loads_nothing_that_is_heavy():
    code = """
import sys, oysterbench
heavy = {"numpy", "pandas", "cv2", "torch", "warp", "matplotlib", "scipy"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
oysterbench.split("slam-mini"), oysterbench.metrics, oysterbench.score
assert not {"torch", "warp", "matplotlib", "pandas"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_public_name_is_there_and_described():
    assert set(oysterbench.__all__) <= set(dir(oysterbench))
    for name in oysterbench.__all__:
        assert getattr(oysterbench, name) is not None
        if not name.startswith("__"):
            assert getattr(oysterbench, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'spilt'"):
        oysterbench.spilt  # noqa: B018
