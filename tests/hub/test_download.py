"""Downloading a published split: what it fetches, what it keeps, and what it does without a network."""

from __future__ import annotations

import errno
import json
import os
import shutil

import pytest
from click.testing import CliRunner

import oysterbench
from oysterbench.cli.main import main
from oysterbench.core.errors import HubError, IntegrityError, NetworkError, SequenceError
from oysterbench.hub import download as downloading
from oysterbench.hub.download import Hub, choose, download, find_here, part_path, plan
from oysterbench.hub.manifest import Manifest, build_manifest
from oysterbench.hub.topics import fetch_topics, plan_topics
from oysterbench.hub.verify import DAMAGED, UNKNOWN, checks
from oysterbench.sequence.file import read_messages
from tests.helpers.blobs import CALM
from tests.helpers.trees import (
    DIGEST,
    SECRET,
    a_key,
    assert_same,
    hub_at,
    publish_secret,
    tree_bytes,
    write_sequence,
    write_split,
)
from tests.helpers.web import Honest, serving


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


def test_a_split_comes_whole_over_http_and_from_a_folder(published, tmp_path):
    with serving(Honest, published.site) as site:
        hub = hub_at(published, site.url)
        manifest = hub.manifest("fake-val")
        assert manifest == published.manifest
        seen = []
        files = download(hub, manifest, tmp_path / "a", progress=lambda *count: seen.append(count))
    assert_same(files, published)
    assert seen[0] == (0, manifest.size)
    assert seen[-1] == (manifest.size, manifest.size)
    assert sorted(path.name for path in (tmp_path / "a").iterdir() if not path.name.endswith(".lock")) == [
        "dive-01.mcap",
        "dive-02.mcap",
        "manifest.json",
    ]
    folder = hub_at(published, published.tree)
    assert_same(download(folder, folder.manifest("fake-val", "1.0"), tmp_path / "b"), published)
    assert len(oysterbench.open(tmp_path / "b" / "dive-01.mcap").truth()) == 50


def test_what_is_here_is_not_fetched_again(published, tmp_path):
    with serving(Honest, published.site) as site:
        hub = hub_at(published, site.url)
        manifest = hub.manifest("fake-val")
        download(hub, manifest, tmp_path)
        sent = site.sent
        assert_same(download(hub, manifest, tmp_path), published)
        assert site.sent == sent


def test_rendered_files_that_are_the_same_are_taken_as_they_are(published, tmp_path):
    folder = tmp_path / "rendered"
    shutil.copytree(published.folder / "data", folder)
    assert_same(download(Hub([], None), published.manifest, folder), published)


def test_another_file_under_the_name_is_left_alone(published, tmp_path):
    (tmp_path / "dive-01.mcap").write_bytes(b"mine")
    with pytest.raises(HubError, match="it was left unchanged"):
        download(hub_at(published, published.tree), published.manifest, tmp_path)
    assert (tmp_path / "dive-01.mcap").read_bytes() == b"mine"


@pytest.mark.parametrize("as_long", [False, True])
def test_another_file_is_left_alone_too_where_it_was_not_chosen(published, tmp_path, as_long):
    """Else the manifest would vouch for it, and the next download replace it or take it for the published one."""
    mine = b"mine".ljust(published.manifest.files[1].size if as_long else 4)
    (tmp_path / "dive-02.mcap").write_bytes(mine)
    hub, entries = hub_at(published, published.tree), choose(published.manifest, ["dive-01"])
    with pytest.raises(HubError, match=r"dive-02\.mcap: a different file has this name"):
        download(hub, published.manifest, tmp_path, entries)
    assert tree_bytes(tmp_path) == {"dive-02.mcap": mine}


def test_a_manifest_that_was_damaged_since_is_written_anew_and_no_file_is_fetched_again(published, tmp_path, home):
    hub = hub_at(published, published.tree)
    folder = home / "splits" / "fake-val" / "1.0-x"
    download(hub, published.manifest, folder)
    (folder / "manifest.json").write_text("garbage")
    found = {check.path.name: check.state for check in checks("")}
    assert found == {"manifest.json": DAMAGED, "dive-01.mcap": UNKNOWN, "dive-02.mcap": UNKNOWN}
    assert find_here("fake-val", "1.0") is None
    assert json.loads(CliRunner().invoke(main, ["splits", "--json"]).stdout)["splits"]
    assert [step.state for step in plan(published.manifest, published.manifest.files, folder)] == ["here", "here"]
    download(Hub([], None), published.manifest, folder)
    assert (folder / "manifest.json").read_bytes() == published.manifest.data


def test_only_chosen_sequences_are_fetched(published, tmp_path):
    entries = choose(published.manifest, ["*-02"])
    files = download(hub_at(published, published.tree), published.manifest, tmp_path, entries)
    assert list(files) == ["dive-02"]
    assert not (tmp_path / "dive-01.mcap").exists()
    with pytest.raises(HubError, match=r"no sequence matching 'x\*'; it has dive-01, dive-02"):
        choose(published.manifest, ["x*"])


def test_verify_repairs_a_damaged_file_piece_by_piece(published, tmp_path):
    hub = hub_at(published, published.tree)
    download(hub, published.manifest, tmp_path)
    path = tmp_path / "dive-01.mcap"
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)
    message = []
    hub.announce = message.append
    assert download(hub, published.manifest, tmp_path)["dive-01"].read_bytes() == data  # its size is right
    assert_same(download(hub, published.manifest, tmp_path, verify=True), published)
    assert "damaged (1 of 1 pieces are wrong, the first at byte 0)" in message[0]


def test_a_disk_that_gives_back_other_bytes_is_noticed(published, tmp_path, monkeypatch):
    install = downloading.Part.install

    def install_badly(self, target):
        install(self, target)
        with open(target, "r+b") as file:
            file.write(b"?")

    monkeypatch.setattr(downloading.Part, "install", install_badly)
    with pytest.raises(IntegrityError, match="the disk may be failing"):
        download(hub_at(published, published.tree), published.manifest, tmp_path, verify=True)
    assert not (tmp_path / "dive-01.mcap").exists()


def test_room_is_looked_for_first(published, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=downloading.SPARE + 1000))
    with pytest.raises(HubError, match=r"not enough room.*nothing was fetched"):
        download(hub_at(published, published.tree), published.manifest, tmp_path / "new" / "folder")
    assert not (tmp_path / "new").exists()


def test_a_full_disk_is_told_by_the_name_that_the_file_will_have(published, tmp_path, monkeypatch):
    def full(*of):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OSError, match="No space left") as raised:
        download(hub_at(published, published.tree), published.manifest, tmp_path)
    assert raised.value.filename == str(tmp_path / "dive-01.mcap")


# Without a network


def test_offline_asks_no_server_but_reads_folders_and_what_is_here(published, home, tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_OFFLINE", "1")
    with pytest.raises(NetworkError, match="OYSTERBENCH_OFFLINE is set"):
        Hub.at(["https://hub.example.org"], published.public)
    folder = home / "splits" / "fake-val" / "1.0-abc"
    download(hub_at(published, published.tree), published.manifest, folder)
    assert find_here("fake-val", "1.0") == (folder, published.manifest)
    assert find_here("fake-val", None) == (folder, published.manifest)
    assert find_here("fake-val", "2.0") is None
    (folder / "dive-02.mcap").unlink()
    assert find_here("fake-val", "1.0") is None
    assert find_here("fake-val", "1.0", ["dive-01"]) == (folder, published.manifest)
    monkeypatch.delenv("OYSTERBENCH_OFFLINE")
    assert find_here("fake-val", None) is None  # a hub may have a newer version


@pytest.mark.parametrize("place", ["ftp://x/y", "s3://bucket", "/no/such/folder"])
def test_places_that_cannot_be_read_are_refused(place):
    with pytest.raises(HubError, match="expected"):
        Hub.at([place], None)


def test_passwords_in_an_address_are_in_no_message(published):
    hub = Hub.at(["http://user:secret@127.0.0.1:9"], published.public, patience=CALM)
    with pytest.raises(NetworkError) as caught:
        hub.index()
    assert "secret" not in str(caught.value)


# Parts of a split


def test_a_hidden_split_downloads_like_any_other(published, tmp_path):
    key, public = a_key(tmp_path)
    manifest = publish_secret(tmp_path / "tree", tmp_path / "truth", write_split(tmp_path / "data", SECRET), key)
    hub = Hub.at([str(tmp_path / "tree")], public, patience=CALM)
    assert hub.manifest("fake-val") == manifest
    assert manifest.hidden
    files = download(hub, manifest, tmp_path / "here")
    assert len(list(oysterbench.open(files["dive-01"]).imu())) == 100


@pytest.fixture(scope="module")
def long_dive(tmp_path_factory):
    """One sequence of many small pieces: its file, manifest and a tree."""
    folder = tmp_path_factory.mktemp("long")
    file = write_sequence(folder / "dive-01.mcap", "dive-01", 4.0)
    facts = {"split": "fake-val", "version": "1.0", "track": "slam", "rig": "hand", "summary": "One dive"}
    manifest: Manifest = build_manifest(facts, {"dive-01": file}, DIGEST, piece_size=4096)
    (folder / "blobs").mkdir()
    shutil.copy(file, folder / "blobs" / manifest.files[0].sha256)
    return file, manifest, folder


def test_topics_are_cut_from_the_pieces_that_hold_them(long_dive, published, tmp_path):
    file, manifest, tree = long_dive
    with serving(Honest, tree_bytes(tree)) as site:
        files = fetch_topics(hub_at(published, site.url), manifest.files, tmp_path / "split", ["/imu", "/pressure"])
        assert site.sent < 0.2 * manifest.size, f"{site.sent} of {manifest.size} bytes"
    small = oysterbench.open(files["dive-01"])
    assert {topic for topic, _, n in small.contents()} == {"/imu", "/pressure"}
    for topic in ("/imu", "/pressure"):
        assert list(read_messages(files["dive-01"], [topic])) == list(read_messages(file, [topic]))
    assert small.attachments["split.toml"] == oysterbench.open(file).attachments["split.toml"]
    assert not list((tmp_path / "split").glob(".*.part"))


def test_what_topics_would_take_is_what_they_take(long_dive, published, tmp_path):
    _, manifest, tree = long_dive
    wanted = ["/imu", "/pressure"]
    with serving(Honest, tree_bytes(tree)) as site:
        sizes = plan_topics(hub_at(published, site.url), manifest.files, tmp_path / "split", wanted)
        assert not [path for path in (tmp_path / "split").rglob("*") if path.is_file()]
        told = []
        fetch_topics(
            hub_at(published, site.url),
            manifest.files,
            tmp_path / "split",
            wanted,
            progress=lambda done, total: told.append(done),
        )
    (size,) = sizes.values()
    assert 0 < size < manifest.size / 2
    assert told[-2] == size  # before it goes on to the next file


def test_topics_of_a_file_that_is_here_need_no_hub(long_dive, tmp_path):
    file, manifest, _ = long_dive
    download_folder = tmp_path / "split"
    download_folder.mkdir()
    shutil.copy(file, download_folder)
    files = fetch_topics(Hub([], None), manifest.files, download_folder, ["/cam_left/*"], tmp_path / "out")
    assert files == {"dive-01": tmp_path / "out" / "dive-01.mcap"}
    assert len(list(oysterbench.open(files["dive-01"]).images("cam_left"))) == 40
    again = fetch_topics(Hub([], None), manifest.files, download_folder, ["/cam_left/*"], tmp_path / "again")
    assert again["dive-01"].read_bytes() == files["dive-01"].read_bytes()
    with pytest.raises(SequenceError, match="no topic matches '/nothing'"):
        fetch_topics(Hub([], None), manifest.files, download_folder, ["/nothing"])
    with pytest.raises(HubError, match="it was left unchanged"):
        fetch_topics(Hub([], None), manifest.files, download_folder, ["/imu"], download_folder)


def test_topics_are_not_cut_from_another_file_of_the_same_size(long_dive, published, tmp_path):
    file, manifest, tree = long_dive
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "dive-01.mcap").write_bytes(data)
    hub = hub_at(published, tree)
    assert plan_topics(hub, manifest.files, tmp_path, ["/imu"])["dive-01"] > 0
    files = fetch_topics(hub, manifest.files, tmp_path, ["/imu"])
    assert list(read_messages(files["dive-01"], ["/imu"])) == list(read_messages(file, ["/imu"]))
    assert (tmp_path / "dive-01.mcap").read_bytes() == data


def test_a_part_that_grows_is_kept_when_topics_are_cut_from_it(long_dive, published, tmp_path):
    file, manifest, tree = long_dive
    (entry,) = manifest.files
    part = part_path(tmp_path, entry)
    part.write_bytes(file.read_bytes()[: 10 * entry.piece_size])
    hub = hub_at(published, tree)
    fetch_topics(hub, manifest.files, tmp_path, ["/imu"])
    assert part.is_file()
    (step,) = plan(manifest, manifest.files, tmp_path)
    assert step.state == "to fetch"
    assert download(hub, manifest, tmp_path)["dive-01"].read_bytes() == file.read_bytes()
    assert not part.exists()
