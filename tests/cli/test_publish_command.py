"""The commands of those who run a hub, as they are typed."""

from __future__ import annotations

import json
import os
import shutil

import pytest

import oysterbench
from oysterbench.recipe import load_split
from oysterbench.sequence.cut import cut_to, match_topics
from oysterbench.simulation.generate import digest
from tests.helpers.hub_place import Place
from tests.helpers.tiny import TINY_RIG
from tests.helpers.trees import SECRET


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("commands"))


def test_a_hidden_split_from_publish_to_download(place, tmp_path):
    place.write(tmp_path / "salted", SECRET)
    published = place.run(
        "publish",
        place.recipe,
        tmp_path / "hub",
        *("--key", place.folder / "key.pem", "--data", tmp_path / "salted"),
        *("--hidden", "--truth-out", tmp_path / "truth", "--json"),
    )
    facts = json.loads(published.stdout)
    assert len(facts["commitment"]) == 64
    done = place.run("download", "tiny", "--from", tmp_path / "hub", "--key", place.public, home=tmp_path / "home")
    topics = json.loads(place.run("info", done.stdout.strip(), "--json").stdout)["topics"]
    assert not any(row["topic"].startswith("/truth") for row in topics)
    truth = json.loads(place.run("info", tmp_path / "truth" / "tiny-1.0" / "tiny-01.mcap", "--json").stdout)
    assert truth["path_length_m"] > 0


def test_a_hidden_recipe_is_never_published_with_its_truth(place, tmp_path):
    (tmp_path / "rig.toml").write_text(TINY_RIG)
    recipe = tmp_path / "tiny.toml"
    recipe.write_text("hidden = true\n" + place.recipe.read_text())
    arguments = ("publish", recipe, tmp_path / "hub", "--key", place.folder / "key.pem", "--data", place.data)
    assert "would reveal its ground truth" in place.run(*arguments, code=1).stderr
    assert not (tmp_path / "hub").exists()
    failed = place.run("download", recipe, code=1, home=tmp_path / "home")
    assert "cannot be rendered without its salt" in failed.stderr


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_a_tree_that_a_web_server_of_another_user_cannot_read_is_told_of(place, tmp_path, mask):
    before = os.umask(mask)
    try:
        words = ("publish", place.recipe, tmp_path / "hub", "--key", place.folder / "key.pem", "--data", place.data)
        done = place.run(*words)
    finally:
        os.umask(before)
    files = [path for path in (tmp_path / "hub").rglob("*") if path.is_file()]
    assert {path.stat().st_mode & 0o777 for path in files} == {0o666 & ~mask}
    line = f"{tmp_path}/hub: other users cannot read all of it (umask 077), a web server of another user neither: "
    assert (line in done.stderr) == (mask == 0o077)


@pytest.mark.parametrize("changed", ["comment", "summary", "rig", "generation"])
def test_the_files_of_a_release_are_signed_again_whatever_their_recipe_says_now(place, tmp_path, monkeypatch, changed):
    """Of another version it is still asked whether the recipe made them."""
    shutil.copytree(place.tree, tmp_path / "hub")
    recipe, rig = place.recipe.read_text(), (place.folder / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(("# a comment\n" if changed == "rig" else "") + rig)
    summary = recipe.replace("a very small reef", "a very small reef, better said")
    texts = {"comment": "# a comment\n" + recipe, "summary": summary}
    (tmp_path / "tiny.toml").write_text(texts.get(changed, recipe))
    if changed == "generation":
        monkeypatch.setattr("oysterbench.simulation.generate.GENERATION", 99)
    new = place.run("keygen", tmp_path / "new.pem").stdout.strip()
    before = {path.name: path.read_bytes() for path in (tmp_path / "hub").glob("*/*")}
    words = ("publish", tmp_path / "tiny.toml", tmp_path / "hub", "--data", place.data, "--key", tmp_path / "new.pem")
    place.run(*words, "--old-key", place.folder / "key.pem")
    assert {path.name: path.read_bytes() for path in (tmp_path / "hub").glob("*/*")} == before
    assert f"signed with {new[:16]}…" in place.run("verify", tmp_path / "hub").stdout
    elsewhere = [tmp_path / "other" if word == tmp_path / "hub" else word for word in words]
    assert "nothing was published" in place.run(*elsewhere, code=1).stderr


@pytest.mark.parametrize("hidden", [False, True])
def test_files_with_some_of_the_topics_are_not_published(place, tmp_path, hidden):
    """They share split, version and digest with the whole ones, which could then never be released."""
    data = tmp_path / "data" / "tiny-01.mcap"
    place.write(tmp_path / "whole", SECRET if hidden else digest(load_split(str(place.recipe))))
    topics = match_topics(oysterbench.open(tmp_path / "whole" / "tiny-01.mcap").types, ["/imu", "/truth/*"], "it")
    cut_to(data, tmp_path / "whole" / "tiny-01.mcap", topics)
    more = ("--hidden", "--truth-out", tmp_path / "truth") if hidden else ()
    words = ("publish", place.recipe, tmp_path / "hub", "--key", place.folder / "key.pem", "--data", data.parent, *more)
    line = place.run(*words, code=1).stderr
    assert f"{data}: expected all topics of its rig, got none of /alt/range, /cam_left/" in line
    assert line.count("\n") == 1
    assert not (tmp_path / "hub").exists()
