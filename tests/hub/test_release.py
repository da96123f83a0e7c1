"""Releases: made sequence by sequence, of whole files, and never changed."""

from __future__ import annotations

import json

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub.manifest import describe_file, read_manifest
from oysterbench.hub.release import (
    DECIDING,
    keep_read,
    made_with,
    not_read,
    put_together,
    take_over,
    write_partial,
    write_release,
)
from oysterbench.version import GENERATION
from tests.helpers.trees import DIGEST, FACTS, TEXTS, write_split

NAMES = ("dive-01", "dive-02")
TOPICS = ("/cam_left/image", "/imu", "/truth/pose")


@pytest.fixture
def files(tmp_path):
    return write_split(tmp_path / "data")


def test_a_release_is_made_of_sequences_that_were_never_on_the_disk_together(files, tmp_path):
    kept = tmp_path / "kept"
    entries = {name: describe_file(path) for name, path in files.items()}
    for name, path in files.items():
        assert name in not_read(kept, NAMES)
        keep_read(kept, name, path, TOPICS)
        path.unlink()
    assert not_read(kept, NAMES) == []
    manifest = put_together(kept, FACTS, NAMES, DIGEST, TEXTS)
    assert [(entry.sequence, entry) for entry in manifest.files] == sorted(entries.items())
    path = write_release(manifest, tmp_path / "manifests")
    assert path.name == "fake-val-1.0.json"
    assert read_manifest(path.read_bytes(), "it") == manifest
    assert manifest.made_with == made_with()


def test_a_release_says_what_decides_its_bytes():
    found = made_with()
    assert found["generation"] == str(GENERATION)
    assert {*DECIDING} <= {*found}
    assert {"python", "processor"} <= {*found}


def test_parts_made_with_different_versions_make_no_release(files, tmp_path):
    for name, path in files.items():
        keep_read(tmp_path, name, path, TOPICS)
    other = tmp_path / "dive-02.json"
    document = json.loads(other.read_bytes())
    document["made_with"]["numpy"] = "9.9"
    other.write_text(json.dumps(document))
    with pytest.raises(HubError, match=r"dive-02 was made with numpy 9\.9, and dive-01 with"):
        put_together(tmp_path, FACTS, NAMES, DIGEST, TEXTS)


def test_a_file_that_lacks_a_topic_of_its_rig_is_not_released(files, tmp_path):
    with pytest.raises(HubError, match="got none of /sonar_front/image; it was not accepted"):
        keep_read(tmp_path, "dive-01", files["dive-01"], (*TOPICS, "/sonar_front/image"))
    assert not_read(tmp_path, NAMES) == [*NAMES]


def test_a_release_never_changes(files, tmp_path):
    for name, path in files.items():
        keep_read(tmp_path, name, path, TOPICS)
    manifest = put_together(tmp_path, FACTS, NAMES, DIGEST, TEXTS)
    path = write_release(manifest, tmp_path)
    assert write_release(manifest, tmp_path) == path
    with pytest.raises(HubError, match="a release never changes"):
        write_release(put_together(tmp_path, FACTS, NAMES[:1], DIGEST, TEXTS), tmp_path)
    assert path.read_bytes() == manifest.data


def test_a_partial_manifest_grows_on_any_machine_until_it_is_the_release(files, tmp_path):
    place = ("fake-val", "1.0", DIGEST)
    keep_read(tmp_path / "here", "dive-01", files["dive-01"], TOPICS)
    partial = write_partial(put_together(tmp_path / "here", FACTS, NAMES[:1], DIGEST, TEXTS), tmp_path)
    assert partial == tmp_path / "partial" / "fake-val-1.0.json"
    take_over(tmp_path / "another recipe's", tmp_path, "fake-val", "1.0", "0" * 64)
    assert not_read(tmp_path / "another recipe's", NAMES) == [*NAMES]
    take_over(tmp_path / "there", tmp_path, *place)
    assert not_read(tmp_path / "there", NAMES) == ["dive-02"]
    keep_read(tmp_path / "there", "dive-02", files["dive-02"], TOPICS)
    manifest = put_together(tmp_path / "there", FACTS, NAMES, DIGEST, TEXTS)
    path = write_release(manifest, tmp_path)
    assert [entry.sequence for entry in read_manifest(path.read_bytes(), "it").files] == [*NAMES]
    assert not partial.exists()


def test_what_a_partial_manifest_says_of_a_sequence_never_changes(files, tmp_path):
    for name, path in files.items():
        keep_read(tmp_path, name, path, TOPICS)
    path = write_partial(put_together(tmp_path, FACTS, NAMES[:1], DIGEST, TEXTS), tmp_path)
    before = path.read_bytes()
    keep_read(tmp_path, "dive-01", files["dive-02"], TOPICS)
    whole, other = (put_together(tmp_path, FACTS, names, DIGEST, TEXTS) for names in (NAMES, NAMES[1:]))
    for write, manifest in ((write_partial, whole), (write_partial, other), (write_release, whole)):
        with pytest.raises(HubError, match="dive-01 has another description in it than was read now"):
            write(manifest, tmp_path)
    with pytest.raises(HubError, match="it is of another recipe or generation"):
        write_partial(put_together(tmp_path, FACTS, NAMES, "0" * 64, TEXTS), tmp_path)
    assert path.read_bytes() == before
    assert not (tmp_path / path.name).exists()


@pytest.mark.parametrize("text", ["split.toml", "rig.toml"])
def test_sequences_made_from_another_text_of_a_recipe_make_no_release(files, tmp_path, text):
    """The digest leaves comments out, but files keep them: the recipe as it is could not render them to the byte."""
    for name, path in files.items():
        keep_read(tmp_path, name, path, TOPICS)
    other = tmp_path / "dive-02.json"
    document = json.loads(other.read_bytes())
    document["entry"]["attachments"][text] = "0" * 64
    other.write_text(json.dumps(document))
    with pytest.raises(HubError, match=rf"dive-02 was made from another text of {text} than the recipe has now"):
        put_together(tmp_path, FACTS, NAMES, DIGEST, TEXTS)
