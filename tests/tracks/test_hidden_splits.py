"""Runs on a hidden split: of a participant, who downloaded it, and of the host, who has its salt."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import RecipeError
from oysterbench.hub.download import Hub, download
from oysterbench.tracks.slam import TRACK
from oysterbench.tracks.track import Request
from tests.helpers.tiny import TINY_SPLIT, make_split
from tests.helpers.trees import SECRET, a_key, publish_secret, write_split

SALT = "0123456789abcdefghij"


@pytest.fixture
def split(home, monkeypatch):
    for name in ("OYSTERBENCH_SALT", "OYSTERBENCH_SALT_FILE"):
        monkeypatch.delenv(name, raising=False)
    named = TINY_SPLIT.replace('name = "tiny"', 'name = "fake-val"\nhidden = true', 1)
    return make_split(named.replace("tiny-01", "dive-01"))


@pytest.fixture
def downloaded(home, tmp_path):
    """Folder under the home folder where the split was downloaded from its hub."""
    key, public = a_key(tmp_path)
    manifest = publish_secret(tmp_path / "tree", tmp_path / "truth", write_split(tmp_path / "data", SECRET), key)
    folder = home / "splits" / "fake-val" / f"{manifest.version}-{manifest.sha256[:12]}"
    download(Hub.at([str(tmp_path / "tree")], public), manifest, folder)
    return folder


def test_a_hidden_split_is_run_on_as_it_was_downloaded(split, downloaded, tmp_path):
    told = []
    request = Request(tmp_path, split, sequences=("dive-01",), announce=told.append)
    files = TRACK.rendered(request)
    assert files == {"dive-01": downloaded / "dive-01.mcap"}
    assert told == [f"fake-val: as downloaded to {downloaded}"]
    (sequence,) = TRACK.run_sequences(split, files, {})
    assert sequence.truth is None
    assert str(downloaded) in sequence.origin, "another download of the split is other data"


def test_one_that_is_not_here_says_where_participants_get_it(split, tmp_path):
    with pytest.raises(
        RecipeError, match="to take part: `oysterbench download fake-val --from URL --key KEY`"
    ) as raised:
        TRACK.rendered(Request(tmp_path, split))
    assert "\n" not in str(raised.value)


def test_topics_of_a_downloaded_split_are_chosen_with_the_download(split, downloaded, tmp_path):
    with pytest.raises(RecipeError, match="--topics: split fake-val was downloaded with all its topics"):
        TRACK.rendered(Request(tmp_path, split, topics=("/imu",)))


def test_the_host_renders_with_the_salt(split, downloaded, tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_SALT", SALT)
    asked = {}
    TRACK.rendered(Request(tmp_path, split, render=lambda split, **options: asked.update(options) or {}))
    assert asked["salt"] == SALT.encode()


@pytest.fixture
def run_by_name(downloaded, monkeypatch):
    """Ask for a run on the split by its name, as one who has no recipe of it: the output, and the request if any."""

    def run(*options):
        asked = [None]
        monkeypatch.setattr("oysterbench.cli.run.evaluate", lambda track, request, outputs: asked.append(request))
        words = ["run", "mine", "--command", "mine {mcap} {out}", "--split", "fake-val", *options]
        return CliRunner().invoke(main, words).output, asked[-1]

    return run


def test_a_hidden_split_of_the_hosts_own_is_known_by_its_name_once_it_is_downloaded(run_by_name, downloaded):
    told, request = run_by_name()
    assert f"fake-val: as downloaded to {downloaded}" in told
    assert request.places == (downloaded / "dive-01.mcap", downloaded / "dive-02.mcap")
    assert (request.split, request.out) == (None, downloaded / "runs")
    _, request = run_by_name("--sequence", "dive-02", "--out", "mine")
    assert (request.places, list(request.sequences)) == ((downloaded / "dive-02.mcap",), [])
    told, request = run_by_name("--topics", "/imu")
    assert (request, "--topics: split fake-val was downloaded with all its topics" in told) == (None, True)


def test_one_that_is_here_in_several_releases_or_in_part_is_not_chosen_from(run_by_name, downloaded):
    other = downloaded.with_name("another")
    shutil.copytree(downloaded, other)
    told, request = run_by_name()
    assert (request, told.count("\n")) == (None, 1)
    assert (
        f"split fake-val: expected one release of it under the home folder, got {downloaded}, {other}; choose one"
        in told
    )
    shutil.rmtree(other)
    (downloaded / "dive-02.mcap").unlink()
    told, request = run_by_name()
    assert (request, told.count("\n")) == (None, 1)
    assert "fake-val: its recipe is not known here, and only a part of it was downloaded; `oysterbench downl" in told
    shutil.rmtree(downloaded)
    assert "unknown split 'fake-val'" in run_by_name()[0]


def test_a_recipe_that_is_not_the_released_one_is_not_run_on_what_was_released(
    split, downloaded, tmp_path, monkeypatch
):
    edited = replace(split, seed=split.seed + 1)
    monkeypatch.setattr("oysterbench.recipe.split_names", lambda: [split.name])
    monkeypatch.setattr("oysterbench.recipe.load_split", lambda name: split)
    assert TRACK.rendered(Request(tmp_path, split))
    with pytest.raises(RecipeError, match=f"its recipe is not the released one; .* --split {split.name} is the"):
        TRACK.rendered(Request(tmp_path, edited))
