"""Whom a client trusts: signatures, hashes, the newest index it has seen, and never a server."""

from __future__ import annotations

import json
import shutil

import pytest

from oysterbench.core.errors import HubError, IntegrityError, NetworkError
from oysterbench.hub import download as downloading
from oysterbench.hub import verify as verifying
from oysterbench.hub.canonical import canonical
from oysterbench.hub.download import Hub, choose, download, find_here
from oysterbench.hub.index import read_index
from oysterbench.hub.manifest import build_manifest
from oysterbench.hub.topics import plan_topics
from oysterbench.hub.verify import DAMAGED, OTHER, RIGHT, checks
from tests.helpers.blobs import CALM
from tests.helpers.trees import (
    FACTS,
    a_key,
    assert_same,
    hub_at,
    publish_split,
    write_sequence,
)
from tests.helpers.web import misbehaving


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


def test_a_hostile_mirror_cannot_swap_a_manifest(published, tmp_path):
    """It has good files, another manifest that it signed itself, and the good index with its hash in it."""
    evil = tmp_path / "evil"
    shutil.copytree(published.tree, evil)
    other = publish_split(tmp_path / "own", {"dive-01": published.files["dive-02"]}, a_key(tmp_path)[0])
    shutil.copytree(tmp_path / "own" / "manifests", evil / "manifests", dirs_exist_ok=True)
    # 1. its own index, with its own signature
    shutil.copy(tmp_path / "own" / "index.json", evil / "index.json")
    with pytest.raises(IntegrityError, match="not signed with the key"):
        hub_at(published, evil).manifest("fake-val")
    # 2. the good index, changed, with the good signature
    document = json.loads((published.tree / "index.json").read_bytes())
    document["signed"]["splits"][0]["manifest"] = other.sha256
    (evil / "index.json").write_text(json.dumps(document))
    with pytest.raises(IntegrityError, match="not signed with the key") as refused:
        hub_at(published, evil).manifest("fake-val")
    assert str(refused.value).count(published.public[:16]) == 1
    assert "the signature is wrong, so it was altered on the way, at the mirror or since" in str(refused.value)
    # 3. the good index as it is, and another manifest under the good one's name
    shutil.copy(published.tree / "index.json", evil / "index.json")
    (evil / "manifests" / f"{published.manifest.sha256}.json").write_bytes(other.data)
    with pytest.raises(IntegrityError, match="expected a manifest with SHA-256"):
        hub_at(published, evil).manifest("fake-val")
    # 4. beside an honest mirror none of it matters
    hub = hub_at(published, evil, published.tree)
    assert hub.manifest("fake-val") == published.manifest
    assert "expected a manifest" in hub.mirrors[0].failure


@pytest.mark.parametrize("wrong", ["", "00" * 64, "zz" * 64, "12"])
def test_a_bad_signature_is_none(published, wrong):
    document = json.loads((published.tree / "index.json").read_bytes())
    document["signatures"][0]["signature"] = wrong
    for data in (document, {**document, "signatures": []}, {**document, "signatures": 7}, {"signed": {}}):
        with pytest.raises(IntegrityError, match=r"nothing of it was used|it was not used"):
            read_index(json.dumps(data).encode(), published.public, "index")


def test_a_second_signature_by_the_pinned_key_is_enough(published):
    """So a hub can change its key: both sign for a while."""
    document = json.loads((published.tree / "index.json").read_bytes())
    document["signatures"].insert(0, {"key": "ab" * 32, "signature": "00" * 64})
    assert read_index(json.dumps(document).encode(), published.public, "index").counter == 1


def test_an_older_index_is_refused_once_a_newer_one_was_seen(published, tmp_path):
    tree, old = tmp_path / "tree", tmp_path / "old"
    shutil.copytree(published.tree, tree)
    shutil.copytree(published.tree, old)
    hub_at(published, old).manifest("fake-val")
    publish_split(tree, published.files, published.key, version="1.1")
    assert hub_at(published, tree).manifest("fake-val").version == "1.1"
    with pytest.raises(IntegrityError, match="index number 1 is older than number 2, which was seen before"):
        hub_at(published, old).manifest("fake-val")
    both = hub_at(published, old, tree)
    assert both.manifest("fake-val").version == "1.1"
    assert both.manifest("fake-val", "1.0") == published.manifest


def test_two_indexes_of_one_number_are_refused(published, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    publish_split(one, published.files, published.key, split="one")
    publish_split(other, published.files, published.key, split="other")
    hub_at(published, one).manifest("one")
    with pytest.raises(IntegrityError, match="two indexes with number 1"):
        hub_at(published, other).manifest("other")


def test_without_a_key_no_index_is_believed(published):
    hub = Hub.at([str(published.tree)], None, patience=CALM)
    with pytest.raises(HubError, match=r"add --key KEY \(or OYSTERBENCH_HUB_KEY"):
        hub.manifest("fake-val", "1.0")


def test_a_released_manifest_needs_no_key_and_no_index(published, tmp_path, monkeypatch):
    monkeypatch.setattr(
        downloading, "released_manifest", lambda *name: published.manifest if name == ("fake-val", "1.0") else None
    )
    (tmp_path / "mirror" / "blobs").mkdir(parents=True)
    for entry in published.manifest.files:
        shutil.copy(published.tree / "blobs" / entry.sha256, tmp_path / "mirror" / "blobs")
    hub = Hub.at([str(tmp_path / "mirror")], None, patience=CALM)
    assert_same(download(hub, hub.manifest("fake-val", "1.0"), tmp_path / "a"), published)


def test_a_manifest_beside_files_does_not_stand_in_for_the_released_one(published, tmp_path, monkeypatch):
    monkeypatch.setattr(verifying, "released_manifest", lambda *name: published.manifest)
    forged = write_sequence(tmp_path / "dive-01.mcap", "dive-01", 0.5)
    (tmp_path / "manifest.json").write_bytes(build_manifest(FACTS, {"dive-01": forged}).data)
    assert find_here("fake-val", "1.0", folder=tmp_path) is None
    states = {check.path.name: check.state for check in checks(str(tmp_path))}
    assert states == {"manifest.json": DAMAGED, "dive-01.mcap": OTHER}
    assert [check.state for check in checks(str(forged))] == [OTHER]


def test_a_good_manifest_does_not_vouch_for_files_that_were_not_downloaded_here(published, tmp_path):
    """One byte of one file is changed, in a copy of a folder that was downloaded into."""
    own, usb = tmp_path / "own", tmp_path / "usb"
    hub = hub_at(published, published.tree)
    download(hub, hub.manifest("fake-val"), own)
    shutil.copytree(own, usb)
    forged = bytearray((usb / "dive-01.mcap").read_bytes())
    forged[1000] ^= 1
    (usb / "dive-01.mcap").write_bytes(forged)
    assert find_here("fake-val", "1.0", folder=usb) is None
    assert plan_topics(hub, published.manifest.files, usb, ["/imu"])["dive-01"] > 0
    with pytest.raises(HubError, match=r"dive-01\.mcap: a different file has this name"):  # else it would count as read
        download(hub, published.manifest, usb, choose(published.manifest, ["dive-02"]))
    assert_same(download(hub, published.manifest, usb), published)


def test_damaged_files_are_not_taken_for_right_after_a_repair_that_broke_off(published, tmp_path):
    for entry in published.manifest.files:
        (tmp_path / entry.name).write_bytes(bytes(entry.size))
    (tmp_path / "manifest.json").write_bytes(published.manifest.data)
    with pytest.raises(NetworkError):
        download(Hub([], None), published.manifest, tmp_path)
    assert (tmp_path / "dive-02.mcap").is_file()  # it was not reached
    assert find_here("fake-val", "1.0", ["dive-02"], tmp_path) is None
    assert_same(download(hub_at(published, published.tree), published.manifest, tmp_path), published)


def test_a_folder_that_was_downloaded_into_is_not_read_again(published, tmp_path, monkeypatch):
    hub = hub_at(published, published.tree)
    (tmp_path / "old").mkdir()
    for entry in published.manifest.files:
        shutil.copy(published.tree / "blobs" / entry.sha256, tmp_path / "old" / entry.name)
    (tmp_path / "old" / "manifest.json").write_bytes(published.manifest.data)
    read = []
    monkeypatch.setattr(downloading, "check_file", lambda *of: read.append(of) or verifying.check_file(*of))
    assert_same(download(hub, published.manifest, tmp_path / "old"), published)
    assert len(read) == 2
    assert_same(download(hub, published.manifest, tmp_path / "old"), published)
    assert len(read) == 2


def test_verify_says_where_no_key_vouches_for_a_manifest(published, tmp_path):
    for name, path in published.files.items():
        shutil.copy(path, tmp_path / f"{name}.mcap")
    (tmp_path / "manifest.json").write_bytes(published.manifest.data)
    unsigned = "by the manifest beside it, which was not checked against a key"
    assert [(check.state, check.detail) for check in checks(str(tmp_path))] == [(RIGHT, unsigned)] * 2
    assert [check.detail for check in checks(str(tmp_path / "dive-01.mcap"))] == [unsigned]
    hub_at(published, published.tree).manifest("fake-val")
    assert [(check.state, check.detail) for check in checks(str(tmp_path))] == [(RIGHT, "")] * 2


def test_splits_and_versions_that_are_not_there_are_named_with_those_that_are(published):
    hub = hub_at(published, published.tree)
    with pytest.raises(HubError, match="no split or model 'slam-max'; it has fake-val"):
        hub.manifest("slam-max")
    with pytest.raises(HubError, match=r"no version '3.0' of fake-val; it has 1.0"):
        hub.manifest("fake-val", "3.0")


def test_an_endless_index_is_not_read_to_its_end(published, monkeypatch):
    monkeypatch.setattr(downloading, "LARGEST", 100)
    with pytest.raises(IntegrityError, match="longer than 100 bytes"):
        hub_at(published, published.tree).index()


@pytest.mark.parametrize("kind", ["cut", "unavailable", "redirect", "nonsense", "wrong_file", "truncated_chunks"])
def test_index_and_manifest_survive_a_misbehaving_server(published, kind):
    for seed in range(5):
        with misbehaving(kind, published.site, seed, 0.5) as site:
            found = failure = None
            try:
                found = hub_at(published, site.url).manifest("fake-val")
            except (NetworkError, IntegrityError) as error:
                failure = str(error)
            assert found == published.manifest or site.url in failure


def test_the_memory_of_the_newest_index_is_canonical(published, home):
    hub_at(published, published.tree).index()
    (path,) = (home / "hub").glob("*.json")
    assert path.name == f"{published.public}.json"
    assert path.read_bytes() == canonical(json.loads(path.read_bytes()))
