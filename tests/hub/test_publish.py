"""Publishing: what is in the tree, what is never half in it, and what others read of it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from html.parser import HTMLParser

import msgspec
import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub import publish as publishing
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.hub.index import read_index
from oysterbench.hub.manifest import read_manifest
from oysterbench.hub.pages import SCRIPT
from oysterbench.hub.publish import check_made_by
from oysterbench.hub.sign import public_hex
from oysterbench.hub.verify import ABSENT, DAMAGED, RIGHT, checks
from tests.helpers import weights_made
from tests.helpers.command import run
from tests.helpers.trees import (
    DIGEST,
    FACTS,
    TEXTS,
    a_key,
    publish_secret,
    publish_split,
    tree_bytes,
    write_split,
)


def test_the_tree_is_addressed_by_content(tmp_path, files, key_and_public):
    key, public = key_and_public
    manifest = publish_split(tmp_path / "tree", files, key)
    found = tree_bytes(tmp_path / "tree")
    for path, data in found.items():
        folder, _, name = path.rpartition("/")
        if folder:
            assert name.partition(".")[0] == sha256(data), path
    index = read_index(found["index.json"], public, "index")
    release = index.splits["fake-val"]["1.0"]
    assert release.manifest == manifest.sha256
    assert read_manifest(found[f"manifests/{manifest.sha256}.json"], "manifest") == manifest
    assert (release.sequences, release.size, release.hidden) == (2, manifest.size, False)
    for entry, path in zip(manifest.files, files.values(), strict=True):
        assert found[f"blobs/{entry.sha256}"] == path.read_bytes()
    assert manifest.recipe_digest == DIGEST
    assert b"creativecommons.org/licenses/by/4.0" in manifest.data
    assert {path.partition("/")[0] for path in found} == {
        "blobs",
        "manifests",
        "croissant",
        "pictures",
        "index.json",
        "index.html",
        ".lock",
    }


def test_publishing_twice_adds_nothing(tmp_path, files, key):
    publish_split(tmp_path, files, key)
    before = tree_bytes(tmp_path)
    stamps = {path: (tmp_path / path).stat().st_mtime_ns for path in before if path != ".lock"}
    publish_split(tmp_path, files, key)
    assert tree_bytes(tmp_path) == before
    assert {path: (tmp_path / path).stat().st_mtime_ns for path in stamps} == stamps


def test_a_second_version_keeps_the_first_and_shares_its_blobs(tmp_path, files, key_and_public):
    key, public = key_and_public
    publish_split(tmp_path, files, key)
    blobs = set((tmp_path / "blobs").iterdir())
    publish_split(tmp_path, files, key, version="1.1")
    assert set((tmp_path / "blobs").iterdir()) == blobs
    index = read_index((tmp_path / "index.json").read_bytes(), public, "index")
    assert list(index.splits["fake-val"]) == ["1.0", "1.1"]
    assert index.counter == 2


def test_a_release_never_changes(tmp_path, files, key):
    publish_split(tmp_path, files, key)
    before = tree_bytes(tmp_path)
    other = {**files, "dive-02": files["dive-01"]}
    with pytest.raises(HubError, match=r"a release never changes.*raise the version"):
        publish_split(tmp_path, other, key)
    assert tree_bytes(tmp_path) == before


def test_a_tree_of_another_key_is_left_alone(tmp_path, files, key):
    publish_split(tmp_path / "tree", files, key)
    before = tree_bytes(tmp_path / "tree")
    with pytest.raises(HubError, match="not signed with the key"):
        publish_split(tmp_path / "tree", files, a_key(tmp_path)[0], version="2.0")
    assert tree_bytes(tmp_path / "tree") == before


def test_an_old_key_and_a_new_one_sign_while_users_change_over(tmp_path, files, key_and_public):
    """Only the signatures change: whoever saw the index under one key goes on under the other."""
    (old, old_public), tree = key_and_public, tmp_path / "tree"
    new, new_public = a_key(tmp_path)
    publish_split(tree, files, old)
    before = read_index((tree / "index.json").read_bytes(), old_public, "index")
    publishing.publish(tree, FACTS, files, new, DIGEST, old_keys=[old])
    for public in (old_public, new_public):
        assert read_index((tree / "index.json").read_bytes(), public, "index") == before
    assert new_public in (tree / "index.html").read_text()
    publish_split(tree, files, new)  # and it ends with the new one alone
    assert read_index((tree / "index.json").read_bytes(), new_public, "index") == before
    with pytest.raises(HubError, match="not signed with the key"):
        publish_split(tree, files, old)


def test_a_later_oysterbench_signs_the_same_files_again(tmp_path, files, key_and_public, monkeypatch):
    """As a key is changed: neither its version nor a corrected summary makes other bytes."""
    (old, old_public), tree = key_and_public, tmp_path / "tree"
    manifest = publish_split(tree, files, old)
    before = read_index((tree / "index.json").read_bytes(), old_public, "index")
    new, new_public = a_key(tmp_path)
    monkeypatch.setattr("oysterbench.hub.manifest.VERSION", "99.0")
    facts = {**FACTS, "summary": "Two short dives, by hand"}
    assert publishing.publish(tree, facts, files, new, DIGEST, old_keys=[old]) == manifest
    assert read_index((tree / "index.json").read_bytes(), new_public, "index") == before
    assert publish_split(tree, files, new, version="2.0").oysterbench == "99.0"
    with pytest.raises(HubError, match="a release never changes"):
        publish_split(tree, {**files, "dive-02": files["dive-01"]}, new)


@pytest.mark.parametrize("damage", ["absent", "damaged"])
@pytest.mark.parametrize("kind", ["manifests", "croissant", "pictures"])
def test_what_was_lost_of_a_tree_is_made_again_also_by_a_later_oysterbench(tmp_path, files, key, kind, damage):
    """Here by one that is told of by the Croissant file, or by what is left of the manifest."""
    facts = {"oysterbench": "0.9.1"}
    manifest = publish_split(tmp_path, files, key, **facts)
    before = tree_bytes(tmp_path)
    for path in (tmp_path / kind).iterdir():
        path.unlink() if damage == "absent" else path.write_bytes(path.read_bytes()[:-2])
    assert {check.state for check in checks(str(tmp_path))} == {RIGHT, ABSENT if damage == "absent" else DAMAGED}
    assert publishing.publish(tmp_path, {**FACTS, "summary": "Better said"}, files, key, DIGEST) == manifest
    assert tree_bytes(tmp_path) == before


def test_what_cannot_be_made_again_is_to_be_copied_from_a_mirror(tmp_path, files, key):
    manifest = publish_split(tmp_path, files, key, oysterbench="0.9.1")
    (croissant,) = (tmp_path / "croissant").iterdir()
    croissant.unlink()
    told = []
    publishing.publish(tmp_path, FACTS, files, key, DIGEST, "https://hub.example.org", told.append)
    assert f"{croissant}: damaged or missing, and made otherwise by this version of oysterbench or with" in told[-1]
    assert told[-1].endswith("copy it from a mirror of the tree")
    path = tmp_path / "manifests" / f"{manifest.sha256}.json"
    path.unlink()  # and nothing tells of the version that made it
    with pytest.raises(HubError, match=rf"^{path}: damaged or missing.* copy it from a mirror of the tree$"):
        publish_split(tmp_path, files, key)
    done = run("verify", tmp_path)
    assert "absent (the index names it: publish its split or model again, or copy it from a mirror)" in done.stdout
    assert done.stderr.endswith("2 of 7 files are damaged or missing; each line above says what mends it\n")


@pytest.mark.parametrize("step", range(6))
def test_an_interrupted_publish_leaves_what_was_there(tmp_path, files, key_and_public, step, monkeypatch):
    """Whatever write is the last: the index that was there is whole and names only what is there."""
    key, public = key_and_public
    publish_split(tmp_path, {"dive-02": files["dive-02"]}, key, version="0.9")
    writes, replace = [], os.replace

    def failing(source, target):
        if len(writes) == step:
            raise KeyboardInterrupt
        writes.append(target)
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    try:
        publish_split(tmp_path, files, key)
    except KeyboardInterrupt:
        pass
    else:
        pytest.fail(f"there were fewer than {step + 1} writes")
    monkeypatch.undo()
    index = read_index((tmp_path / "index.json").read_bytes(), public, "index")
    for release in index.splits["fake-val"].values():
        manifest = read_manifest((tmp_path / "manifests" / f"{release.manifest}.json").read_bytes(), "manifest")
        for entry in manifest.files:
            assert sha256((tmp_path / "blobs" / entry.sha256).read_bytes()) == entry.sha256
    publish_split(tmp_path, files, key)
    undisturbed = tmp_path.parent / f"{tmp_path.name}-undisturbed"
    publish_split(undisturbed, {"dive-02": files["dive-02"]}, key, version="0.9")
    publish_split(undisturbed, files, key)
    assert tree_bytes(tmp_path) == tree_bytes(undisturbed)


@pytest.mark.parametrize("what", ["manifests", "models"])
def test_a_damaged_manifest_or_card_is_reported_and_all_else_is_checked(tmp_path, files, key, what):
    manifest = publish_split(tmp_path, files, key)
    weights_made.release(tmp_path, weights_made.write_weights(tmp_path / "of" / "unet.pt"), key)
    (path,) = (tmp_path / what).iterdir()
    path.write_bytes(path.read_bytes()[:-5])
    found = {one.path: one.state for one in checks(str(tmp_path))}
    assert [one for one, state in found.items() if state != RIGHT] == [path]
    assert found[path] == DAMAGED
    assert {tmp_path / "blobs" / entry.sha256 for entry in manifest.files} <= {*found}


def test_what_a_killed_publisher_left_is_taken_away(tmp_path, files, key):
    for name in ("blobs/.publishing-abc", ".publishing-x/dive.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"half")
    publish_split(tmp_path, files, key)
    assert not list(tmp_path.rglob(".publishing-*"))


def test_a_file_that_changes_under_way_is_not_published(tmp_path, files, key, monkeypatch):
    changing = shutil.copy(files["dive-01"], tmp_path / "dive-01.mcap")
    build = publishing.build_manifest

    def build_then_change(*arguments, **options):
        manifest = build(*arguments, **options)
        changing.write_bytes(changing.read_bytes()[:-1] + b"!")
        return manifest

    monkeypatch.setattr(publishing, "build_manifest", build_then_change)
    with pytest.raises(HubError, match="changed while it was published"):
        publish_split(tmp_path / "tree", {"dive-01": changing}, key)
    assert not (tmp_path / "tree" / "index.json").exists()
    assert not list((tmp_path / "tree" / "blobs").iterdir())


def test_what_is_published_is_made_by_the_recipe(files, secret_files, tmp_path):
    check_made_by(files, "fake-val", "1.0", DIGEST, hidden=False)
    check_made_by(secret_files, "fake-val", "1.0", DIGEST, hidden=True)
    with pytest.raises(HubError, match="made by another recipe"):
        check_made_by(secret_files, "fake-val", "1.0", DIGEST, hidden=False)
    with pytest.raises(HubError, match="without a salt"):
        check_made_by(files, "fake-val", "1.0", DIGEST, hidden=True)
    with pytest.raises(HubError, match=r"expected dive-01 of fake-val 2.0, got dive-01 of fake-val 1.0"):
        check_made_by(files, "fake-val", "2.0", DIGEST, hidden=False)
    with pytest.raises(HubError, match="oysterbench render fake-val"):
        check_made_by({"dive-01": tmp_path / "no.mcap"}, "fake-val", "1.0", DIGEST, hidden=False)


@pytest.mark.parametrize("text", ["split.toml", "rig.toml"])
def test_what_is_published_keeps_the_texts_that_the_recipe_has(files, secret_files, text):
    check_made_by(files, "fake-val", "1.0", DIGEST, hidden=False, texts=TEXTS)
    other = {**TEXTS, text: b"# a comment\n" + TEXTS[text]}
    with pytest.raises(HubError, match=rf"dive-01\.mcap: made from another text of {text} than the recipe has now"):
        check_made_by(files, "fake-val", "1.0", DIGEST, hidden=False, texts=other)
    check_made_by(secret_files, "fake-val", "1.0", DIGEST, hidden=True, texts=other)  # which keep none in public


def test_a_tree_can_be_verified_and_is_repaired_by_publishing_again(tmp_path, files, key):
    manifest = publish_split(tmp_path, files, key)
    assert {check.state for check in checks(str(tmp_path))} == {RIGHT}
    named = {path for path in tree_bytes(tmp_path) if "/" in path}
    assert {check.path for check in checks(str(tmp_path))} == {tmp_path / name for name in (*named, "index.json")}
    blob, other = (tmp_path / "blobs" / entry.sha256 for entry in manifest.files)
    blob.write_bytes(blob.read_bytes()[:-1] + b"?")
    other.unlink()
    assert {check.path: check.state for check in checks(str(tmp_path)) if not check.good} == {
        blob: DAMAGED,
        other: ABSENT,
    }
    blob.unlink()
    publish_split(tmp_path, files, key)
    assert {check.state for check in checks(str(tmp_path))} == {RIGHT}


def test_an_index_that_its_keys_did_not_sign_is_found(tmp_path, files, key):
    publish_split(tmp_path, files, key)
    index, (first, *_) = tmp_path / "index.json", checks(str(tmp_path))
    assert (first.path, first.state) == (index, RIGHT)
    assert first.detail == f"signed with {public_hex(key)[:16]}…"
    signed = json.loads(index.read_bytes())
    counted, unsigned, doubted = json.loads(json.dumps([signed] * 3))
    counted["signed"]["counter"] += 1
    unsigned["signatures"] = []
    doubted["signatures"].append({"key": "ab" * 32, "signature": "00" * 64})
    for document in (counted, unsigned, doubted):
        index.write_text(json.dumps(document))
        assert [(check.path, check.state) for check in checks(str(tmp_path)) if not check.good] == [(index, DAMAGED)]
    done = run("verify", tmp_path)
    assert done.returncode == 3
    assert f"{index}: damaged (not signed with what it names (" in done.stdout


def test_the_croissant_file_describes_every_file(tmp_path, files, key):
    manifest = publish_split(tmp_path, files, key)
    (path,) = (tmp_path / "croissant").iterdir()
    document = json.loads(path.read_bytes())
    assert path.read_bytes() == canonical(document)
    assert document["license"] == "https://creativecommons.org/licenses/by/4.0/"
    assert document["name"] == FACTS["split"]
    for entry, described in zip(manifest.files, document["distribution"], strict=True):
        assert described["sha256"] == entry.sha256
        assert (path.parent / described["contentUrl"]).read_bytes() == files[entry.sequence].read_bytes()
    rows = document["recordSet"][0]["data"]
    assert [row["sequences/name"] for row in rows] == ["dive-01", "dive-02"]


def test_the_croissant_file_validates_with_mlcroissant(tmp_path, files, secret_files, key):
    command = shutil.which("mlcroissant")
    if command is None:
        pytest.skip("mlcroissant is not on PATH: install it in an environment of its own (pip install mlcroissant)")
    publish_split(tmp_path / "open", files, key)
    publishing.publish(tmp_path / "url", FACTS, files, key, DIGEST, url="https://hub.example.org/")
    publish_secret(tmp_path / "hidden", tmp_path / "truth", secret_files, key)
    for tree in ("open", "url", "hidden"):
        (path,) = (tmp_path / tree / "croissant").iterdir()
        done = subprocess.run([command, "validate", "--jsonld", path], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "Done." in done.stderr
        assert "WARNING" not in done.stderr or tree != "url", done.stderr


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.open, self.text = [], [], ""

    def handle_starttag(self, tag, attributes):
        self.found += [value for name, value in attributes if name in ("href", "src")]

    def handle_data(self, data):
        self.text += data


def test_the_page_shows_every_release_and_its_links_lead_somewhere(tmp_path, files, key):
    publish_split(tmp_path, files, key)
    publish_split(tmp_path, files, key, split="other", summary="<script>alert(1)</script> & more")
    page = Links()
    text = (tmp_path / "index.html").read_text()
    page.feed(text)
    assert "<script" not in text.replace(f"<script>{SCRIPT}</script>", "")
    for name in (
        "fake-val 1.0",
        "other 1.0",
        "oysterbench download other@1.0",
        f"HUB_KEY={public_hex(key)}",
        "2 splits",
    ):
        assert name in page.text
    assert len(page.found) == 2 * 4 + 1
    for link in page.found:
        assert (tmp_path / link).is_file(), link
    assert 'name="viewport"' in text
    assert "prefers-color-scheme: dark" in text


def test_a_released_split_is_published_by_its_released_manifest_and_no_other_files_under_its_name(
    tmp_path, files, key, monkeypatch
):
    released = msgspec.structs.replace(publish_split(tmp_path / "first", files, key), made_with={"numpy": "2.0"})
    monkeypatch.setattr(publishing, "released_manifest", lambda *of: released)
    assert publish_split(tmp_path / "tree", files, key).sha256 == released.sha256
    assert (tmp_path / "tree" / "manifests" / f"{released.sha256}.json").read_bytes() == released.data
    other = write_split(tmp_path / "other", "0" * 64)
    with pytest.raises(HubError, match=r"was released with other files \(dive-01\.mcap, dive-02\.mcap\)"):
        publish_split(tmp_path / "none", other, key)
    assert not (tmp_path / "none" / "blobs").exists()
