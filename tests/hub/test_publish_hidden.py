"""Publishing a hidden split: what it keeps back, and what it commits to."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

import oysterbench
from oysterbench.core.errors import HubError, SequenceError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.manifest import read_manifest
from oysterbench.hub.publish import check_made_by
from oysterbench.sequence.cut import cut_public, cut_to, is_scorable
from oysterbench.sequence.file import read_attachments, read_messages
from oysterbench.sequence.read import STEERING, McapSequence
from tests.helpers.trees import (
    DIGEST,
    SECRET,
    SEED,
    publish_secret,
    tree_bytes,
    write_sequence,
)


@pytest.fixture(scope="module")
def hidden(tmp_path_factory, secret_files, key_and_public):
    """A hidden split: tree, truth package, manifest."""
    folder = tmp_path_factory.mktemp("hidden")
    manifest = publish_secret(folder / "tree", folder / "truth", secret_files, key_and_public[0])
    return folder / "tree", folder / "truth" / "fake-val-1.0", manifest


def test_a_hidden_split_shows_measurements_only(hidden, secret_files):
    tree, _, manifest = hidden
    public = tree / "blobs" / manifest.files[0].sha256
    sequence = oysterbench.open(public)
    shown = {topic for topic, _, n in sequence.contents()}
    assert shown == {
        "/tf_static",
        "/imu",
        "/pressure",
        "/magnetometer",
        "/dvl/velocity",
        "/dvl/beams",
        "/dvl/altitude",
        "/alt/range",
        "/msis/ping",
        "/msis/head",
        "/fls/image",
        "/cam_left/image",
        "/cam_left/camera_info",
        "/cam_right/image",
        "/cam_right/camera_info",
    }
    with pytest.raises(SequenceError, match="no ground truth"):
        sequence.truth()
    assert set(read_attachments(public)) == {"calibration.json", "classes.json"}
    assert set(sequence.metadata) == {"sequence", "split", "split_version", "track", "rig", "generation"}
    original = secret_files["dive-01"]
    for topic in shown:
        assert list(read_messages(public, [topic])) == list(read_messages(original, [topic]))


def test_nothing_of_a_hidden_splits_tree_tells_recipe_or_digest(hidden, secret_files):
    """Every byte of the tree is searched, chunks unpacked, for what would let somebody render or guess the truth."""
    tree, truth, manifest = hidden
    secrets = [SECRET, DIGEST, SEED, "truth/odometry", "split.toml", "rig.toml", "truth/oysters", "/tf\0"]
    truths = [message.data for message in read_messages(secret_files["dive-01"], ["/truth/odometry"])]
    for path, data in tree_bytes(tree).items():
        unpacked = data
        if path.startswith("blobs/"):
            with open(tree / path, "rb") as file:
                unpacked += b"".join(message.data for _, _, message in make_reader(file).iter_messages())
        for secret in secrets:
            assert secret.encode() not in unpacked, f"{path} tells {secret}"
        assert not any(message in unpacked for message in truths)
    assert manifest.recipe_digest is None
    assert b"recipe_digest" not in manifest.data
    assert sorted(path.name for path in truth.iterdir()) == ["dive-01.mcap", "dive-02.mcap", "manifest.json"]


def test_the_commitment_is_the_hash_of_the_truth_package(hidden, secret_files):
    _, truth, manifest = hidden
    data = (truth / "manifest.json").read_bytes()
    assert manifest.commitment == sha256(data)
    for entry in read_manifest(data, "truth").files:
        assert sha256((truth / entry.name).read_bytes()) == entry.sha256
    kept = oysterbench.open(truth / "dive-01.mcap")
    whole = oysterbench.open(secret_files["dive-01"])
    np.testing.assert_array_equal(kept.truth().positions, whole.truth().positions)
    assert len(kept.oysters()) == 2
    assert kept.attachments["split.toml"] == SEED.encode()


def test_public_part_and_truth_package_are_the_whole_sequence(hidden, secret_files):
    tree, truth, manifest = hidden
    parts = (tree / "blobs" / manifest.files[0].sha256, truth / "dive-01.mcap")
    found = {topic: n for part in parts for topic, _, n in oysterbench.open(part).contents()}
    assert found == {topic: n for topic, _, n in oysterbench.open(secret_files["dive-01"]).contents()}


def test_publishing_a_hidden_split_twice_adds_nothing(hidden, secret_files, key, tmp_path):
    tree, truth, manifest = hidden
    shutil.copytree(tree, tmp_path / "tree")
    before = tree_bytes(tmp_path / "tree")
    assert publish_secret(tmp_path / "tree", tmp_path / "truth", secret_files, key) == manifest
    assert tree_bytes(tmp_path / "tree") == before
    assert tree_bytes(tmp_path / "truth" / "fake-val-1.0") == tree_bytes(truth)


@pytest.mark.parametrize("published", [True, False])
def test_a_later_oysterbench_goes_on_with_a_hidden_split(hidden, secret_files, key, tmp_path, monkeypatch, published):
    """Also where it was interrupted once its truth package was written."""
    tree, truth, manifest = hidden
    if published:
        shutil.copytree(tree, tmp_path / "tree")
    shutil.copytree(truth, tmp_path / "truth" / "fake-val-1.0")
    monkeypatch.setattr("oysterbench.hub.manifest.VERSION", "99.0")
    found = publish_secret(tmp_path / "tree", tmp_path / "truth", secret_files, key)
    assert found.commitment == manifest.commitment
    assert tree_bytes(tmp_path / "truth" / "fake-val-1.0") == tree_bytes(truth)
    if published:
        assert publish_secret(tmp_path / "tree", tmp_path / "elsewhere", secret_files, key) == manifest


def test_another_truth_has_another_commitment(hidden, key, tmp_path):
    other = {"dive-01": write_sequence(tmp_path / "dive-01.mcap", "dive-01", 0.8, SECRET)}
    manifest = publish_secret(tmp_path / "tree", tmp_path / "truth", other, key)
    assert manifest.commitment != hidden[2].commitment


def test_files_without_ground_truth_are_not_published_as_a_hidden_split(secret_files, tmp_path):
    """As teams get them, or with some topics only: their truth package would commit to nothing."""
    name, whole = next(iter(secret_files.items()))
    with open(tmp_path / "public.mcap", "wb") as file:
        cut_public(whole, file)
    cut_to(tmp_path / "some.mcap", whole, ["/imu", "/cam_left/image"])
    check_made_by({name: whole}, "fake-val", "1.0", DIGEST, hidden=True)
    for path in (tmp_path / "public.mcap", tmp_path / "some.mcap"):
        with pytest.raises(HubError, match=f"^{path}: has no ground truth to withhold: it is as teams get it"):
            check_made_by({name: path}, "fake-val", "1.0", DIGEST, hidden=True)


def test_images_have_what_they_are_scored_against_and_not_true_poses_alone(secret_files):
    sequence = McapSequence(secret_files["dive-01"])
    for track, known in (("slam", True), ("segmentation", True), ("steering", False)):
        sequence.metadata = {**sequence.metadata, "track": track}
        assert is_scorable(sequence) == known
    sequence.attachments = {STEERING: b"stamp_ns,yaw,pitch"}
    assert is_scorable(sequence)
    sequence.metadata, sequence.counts = {**sequence.metadata, "track": "segmentation"}, {"/truth/odometry": 9}
    sequence.types = dict.fromkeys(sequence.counts, "")
    assert not is_scorable(sequence)


def test_a_refused_publication_leaves_the_truth_that_was_released(hidden, key, tmp_path):
    shutil.copytree(hidden[0], tmp_path / "tree")
    shutil.copytree(hidden[1], tmp_path / "truth" / "fake-val-1.0")
    before = tree_bytes(tmp_path)
    other = {"dive-01": write_sequence(tmp_path / "dive-01.mcap", "dive-01", 0.8, SECRET)}
    with pytest.raises(HubError, match="a release never changes"):
        publish_secret(tmp_path / "tree", tmp_path / "truth", other, key)
    with pytest.raises(HubError, match=r"the truth of another render of fake-val 1\.0 is there"):
        publish_secret(tmp_path / "new", tmp_path / "truth", other, key)
    after = tree_bytes(tmp_path)
    assert {path: data for path, data in after.items() if path in before} == before
    assert after.keys() - before.keys() == {"dive-01.mcap", "new/.lock"}


@pytest.mark.parametrize("lost", ["tree", "truth", "both"])
@pytest.mark.parametrize("damage", ["cut", "changed"])
def test_lost_manifests_of_a_hidden_split_are_made_again(
    hidden, secret_files, key, tmp_path, monkeypatch, lost, damage
):
    """Also by a later oysterbench, which the Croissant file tells of the one that made them."""
    shutil.copytree(hidden[0], tmp_path / "tree")
    shutil.copytree(hidden[1], tmp_path / "truth" / "fake-val-1.0")
    before = tree_bytes(tmp_path)
    of_tree, of_truth = next((tmp_path / "tree" / "manifests").iterdir()), next(tmp_path.glob("truth/*/manifest.json"))
    for path in {"tree": [of_tree], "truth": [of_truth], "both": [of_tree, of_truth]}[lost]:
        data = path.read_bytes()
        path.write_bytes(data[:-2] if damage == "cut" else data.replace(b'"track":"slam"', b'"track":"slum"'))
    monkeypatch.setattr("oysterbench.hub.manifest.VERSION", "99.0")
    assert publish_secret(tmp_path / "tree", tmp_path / "truth", secret_files, key) == hidden[2]
    assert tree_bytes(tmp_path) == before


@pytest.mark.parametrize("place", ["tree", "tree/truth", "tree/blobs"])
def test_the_truth_never_goes_into_the_tree(tmp_path, secret_files, key, place):
    with pytest.raises(HubError, match="outside the tree"):
        publish_secret(tmp_path / "tree", tmp_path / place, secret_files, key)
    assert not list((tmp_path).rglob("*.mcap"))
