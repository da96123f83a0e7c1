"""The command `release`, and what `render` says of a release, as their users type them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner

from oysterbench.cli import render as rendering
from oysterbench.cli.main import main
from oysterbench.hub import manifest as manifests
from oysterbench.hub.manifest import read_manifest
from oysterbench.recipe import load_split, split_names
from oysterbench.simulation.generate import digest
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.helpers.trees import FACTS, TEXTS, write_sequence

MANIFESTS = Path(str(resources.files("oysterbench_datasets") / "manifests"))
RELEASED = sorted(MANIFESTS.glob("*.json"))
PARTIAL = sorted(MANIFESTS.glob("partial/*.json"))


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    """A recipe whose file was made by hand, of the topics of its rig."""
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    path = tmp_path / "tiny.toml"
    path.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "rig.toml"'))
    monkeypatch.setitem(FACTS, "split", "tiny")
    for name, text in load_split(str(path)).texts.items():
        monkeypatch.setitem(TEXTS, name, text)
    write_sequence(tmp_path / "data" / "tiny-01.mcap", "tiny-01", 0.3, digest(load_split(str(path))))
    monkeypatch.setattr("oysterbench.sequence.truth.rig_topics", lambda rig: {"/imu": "sensor_msgs/msg/Imu"})
    return path


def run(*arguments, code=0):
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.stderr
    return done


def test_a_split_is_released_from_its_files_which_may_go_afterwards(recipe, tmp_path):
    options = ("--data", tmp_path / "data", "--out", tmp_path / "manifests")
    done = run("release", recipe, "--sequence", "tiny-01", *options)
    path = Path(done.stdout.strip())
    assert path == tmp_path / "manifests" / "tiny-1.0.json"
    first = path.read_bytes()
    assert read_manifest(first, "it").recipe_digest == digest(load_split(str(recipe)))
    (tmp_path / "data" / "tiny-01.mcap").unlink()
    run("release", recipe, *options)
    assert path.read_bytes() == first
    assert "does not exist yet" in run("release", recipe, *options, "--again", code=1).stderr


def test_what_is_read_on_several_machines_is_put_together_from_a_folder_of_theirs(recipe, tmp_path, monkeypatch):
    options = ("--data", tmp_path / "data", "--out", tmp_path / "manifests", "--reads", tmp_path / "shared")
    first = Path(run("release", recipe, *options).stdout.strip()).read_bytes()
    assert not (tmp_path / "home" / "releases").exists()
    (tmp_path / "data" / "tiny-01.mcap").unlink()
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "another"))
    assert Path(run("release", recipe, *options).stdout.strip()).read_bytes() == first


def test_again_forgets_what_was_read_before_it_reads_anew(recipe, tmp_path, monkeypatch):
    """Interrupted, the command without it does not take a description of an older file."""
    options = ("--data", tmp_path / "data", "--out", tmp_path / "manifests")
    words = ("release", recipe, *options)
    run(*words)

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    kept = list((tmp_path / "home" / "releases").rglob("tiny-01.json"))
    assert len(kept) == 1
    monkeypatch.setattr("sys.argv", ["oysterbench", *map(str, words), "--again"])
    with monkeypatch.context() as within:
        within.setattr("oysterbench.hub.publish.check_made_by", interrupt)
        assert "interrupted before anything was started over" in run(*words, "--again", code=130).stderr
    assert kept[0].is_file()
    monkeypatch.setattr("oysterbench.hub.release.keep_read", interrupt)
    assert "the command without --again resumes from there" in run(*words, "--again", code=130).stderr
    assert not kept[0].exists()


def test_what_was_read_before_the_text_of_the_recipe_was_edited_is_not_released(recipe, tmp_path):
    """The digest leaves comments out, but files keep them: what everybody renders would be other content."""
    options = ("--data", tmp_path / "data", "--out", tmp_path / "manifests")
    text = recipe.read_text()
    recipe.write_text(f"# a comment\n{text}")
    line = run("release", recipe, *options, code=1).stderr
    assert "tiny-01.mcap: made from another text of split.toml than the recipe has now" in line
    recipe.write_text(text)
    Path(run("release", recipe, *options).stdout.strip()).unlink()
    recipe.write_text(f"# a comment\n{text}")
    line = run("release", recipe, *options, code=1).stderr
    assert "tiny-01 was made from another text of split.toml than the recipe has now" in line
    assert not list((tmp_path / "manifests").iterdir())


def test_a_hidden_split_is_not_released_so(tmp_path):
    assert "slam-test is a hidden split" in run("release", "slam-test", code=1).stderr


@pytest.fixture
def rendered(recipe, tmp_path, monkeypatch):
    """Takes the file made by hand for a render of a split of the package."""
    name = "tiny"
    monkeypatch.setattr(rendering, "render_files", lambda *of, **more: {"tiny-01": tmp_path / "data" / "tiny-01.mcap"})
    monkeypatch.setattr("oysterbench.recipe.split_names", lambda: [name])
    monkeypatch.setattr("oysterbench.recipe.load_split", lambda _: load_split(str(recipe)))
    return lambda: run("render", name)


def test_render_ends_by_saying_whether_the_files_are_those_released(rendered, recipe, tmp_path, monkeypatch):
    released = {}
    monkeypatch.setattr(manifests, "released_manifest", lambda *of: released.get(of))
    assert "tiny 1.0: no released manifest" in rendered().stderr
    path = run("release", recipe, "--data", tmp_path / "data", "--out", tmp_path / "manifests").stdout.strip()
    released["tiny", "1.0"] = read_manifest(Path(path).read_bytes(), path)
    done = rendered()
    assert done.stderr.endswith("tiny 1.0: as released, 1 of 1 files\n")
    assert done.stdout == f"{tmp_path / 'data' / 'tiny-01.mcap'}\n"
    write_sequence(tmp_path / "data" / "tiny-01.mcap", "tiny-01", 0.2, digest(load_split(str(recipe))))
    told = rendered().stderr
    assert "tiny-01.mcap: other content (" in told
    assert "/imu has 20 messages, expected 30" in told
    assert told.endswith("tiny 1.0: 1 of 1 files differ from the release: results from them cannot be compared\n")
    write_sequence(tmp_path / "data" / "tiny-01.mcap", "tiny-01", 0.3, digest(load_split(str(recipe))), compress=False)
    told = rendered().stderr
    assert "tiny-01.mcap: same content, other bytes (" in told
    assert told.endswith("tiny 1.0: 1 of 1 files can be used, though they differ from the release as said above\n")
    released["tiny", "1.0"] = manifests.Manifest(
        **FACTS, oysterbench="1.0.0", files=released["tiny", "1.0"].files, recipe_digest="0" * 64
    )
    assert "was released with another recipe or generation" in rendered().stderr


def test_sequences_are_compared_with_a_partial_manifest_while_the_release_is_being_made(
    rendered, recipe, tmp_path, monkeypatch
):
    block = recipe.read_text().partition("[[sequence]]")[2].replace("tiny-01", "tiny-02")
    recipe.write_text(f"{recipe.read_text()}\n[[sequence]]{block}")
    split = load_split(str(recipe))
    monkeypatch.setattr("tests.helpers.trees.TEXTS", split.texts)
    files = {name: tmp_path / "data" / f"{name}.mcap" for name in ("tiny-01", "tiny-02")}
    for name, path in files.items():
        write_sequence(path, name, 0.3, digest(split))
    options = ("--data", tmp_path / "data", "--out", tmp_path / "manifests")
    done = run("release", recipe, "--sequence", "tiny-01", *options, "--so-far")
    assert "1 of 2 to be read: tiny-02" in done.stderr
    partial = tmp_path / "manifests" / "partial" / "tiny-1.0.json"
    assert done.stdout == f"{partial}\n"
    shipped = read_manifest(partial.read_bytes(), "it")
    monkeypatch.setattr(manifests, "partial_manifest", lambda *of: shipped)
    told = rendered().stderr
    assert told.endswith("tiny 1.0: as released, 1 of 2 files\n")
    monkeypatch.setattr(rendering, "render_files", lambda *of, **more: files)
    told = rendered().stderr
    assert "its manifest is not complete yet, so tiny-02 could not be compared" in told
    assert told.endswith("tiny 1.0: as released, 1 of 2 files\n")
    monkeypatch.setattr("oysterbench.hub.verify.partial_manifest", lambda *of: shipped)
    assert "right" in run("verify", files["tiny-01"]).stdout
    assert "whether it is the released file is unknown" in run("verify", files["tiny-02"]).stdout
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "another"))
    files["tiny-01"].unlink()
    done = run("release", recipe, *options)
    assert done.stdout == f"{tmp_path / 'manifests' / 'tiny-1.0.json'}\n"
    assert not partial.exists()


@pytest.mark.parametrize("path", RELEASED + PARTIAL, ids=lambda path: path.stem)
def test_a_released_manifest_is_of_the_whole_split_that_this_program_renders(path):
    manifest = read_manifest(path.read_bytes(), path.name)
    assert manifest.data == path.read_bytes()
    assert path.name == f"{manifest.split}-{manifest.version}.json"
    assert manifest.split in split_names()
    split = load_split(manifest.split)
    if split.version != manifest.version:
        return  # of before: it stays, and its recipe is another one now
    assert manifest.recipe_digest == digest(split)
    whole = sorted(sequence.name for sequence in split.sequence)
    if path in PARTIAL:
        assert path.name not in [released.name for released in RELEASED]
        assert {entry.sequence for entry in manifest.files} < {*whole}
    else:
        assert [entry.sequence for entry in manifest.files] == whole
    assert manifest.made_with is not None


def test_something_was_released():
    assert "slam-mini-1.0" in [path.stem for path in RELEASED]
