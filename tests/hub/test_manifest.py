"""Manifests: one spelling, checked on the way in, and a content hash that no compressor changes."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from mcap._chunk_builder import ChunkBuilder
from mcap.writer import Writer

from oysterbench.core.errors import HubError, IntegrityError, SequenceError
from oysterbench.hub.canonical import canonical, parse, sha256
from oysterbench.hub.content import content_of
from oysterbench.hub.manifest import build_manifest, describe_file, read_manifest, released_manifest
from oysterbench.hub.verify import ABSENT, DAMAGED, OTHER, REPACKED, RIGHT, UNKNOWN, check_file, check_unknown, checks
from oysterbench.sensors import camera_messages
from tests.helpers.hand_made_dive import write_dive
from tests.helpers.trees import DIGEST, FACTS, TEXTS, write_sequence


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("data") / "dive-01.mcap", "dive-01")


@pytest.fixture(scope="module")
def manifest(file):
    return build_manifest(FACTS, {"dive-01": file}, DIGEST, piece_size=1 << 14)


def test_canonical_json_has_one_spelling():
    assert canonical({"b": 1, "a": ["é", None]}) == '{"a":["é",null],"b":1}\n'.encode()
    with pytest.raises(ValueError, match="Out of range float"):
        canonical({"a": float("nan")})
    for wrong in (b"{", b"[]", b"\xff", b"[" * 100_000, b'{"a": "\\ud800 alone"}', b'{"a": "\xed\xa0\x80"}'):
        with pytest.raises(IntegrityError, match="it was not used"):
            parse(wrong, "index")


def test_a_manifest_comes_back_as_it_went_and_its_hash_is_its_name(manifest):
    again = read_manifest(manifest.data, "manifest")
    assert again == manifest
    assert again.data == manifest.data == canonical(json.loads(manifest.data))
    assert again.sha256 == sha256(manifest.data)


def test_the_manifest_knows_every_byte(manifest, file):
    (entry,) = manifest.files
    data = file.read_bytes()
    assert (entry.size, entry.sha256) == (len(data), sha256(data))
    assert b"".join(data[slice(*entry.span(piece))] for piece in range(len(entry.pieces))) == data
    assert [sha256(data[slice(*entry.span(piece))]) for piece in range(len(entry.pieces))] == list(entry.pieces)
    assert sum(entry.length(piece) for piece in range(len(entry.pieces))) == len(data)
    assert entry.content["/imu"]["messages"] == 100
    assert entry.content["/imu"]["type"] == "sensor_msgs/msg/Imu"
    assert entry.duration_ns == 990_000_000


def test_the_same_files_give_the_same_manifest(manifest, tmp_path):
    again = write_sequence(tmp_path / "x" / "dive-01.mcap", "dive-01")
    assert build_manifest(FACTS, {"dive-01": again}, DIGEST, piece_size=1 << 14).data == manifest.data


def test_another_compression_of_the_same_data_is_known_for_it(file, tmp_path, monkeypatch):
    entry = describe_file(file)
    loose = write_sequence(tmp_path / "loose.mcap", "dive-01", compress=False)
    assert loose.read_bytes() != file.read_bytes()
    assert content_of(loose) == content_of(file)
    monkeypatch.setattr(camera_messages, "PNG_LEVEL", 9)
    smaller = write_sequence(tmp_path / "smaller.mcap", "dive-01")
    assert smaller.stat().st_size < file.stat().st_size
    assert content_of(smaller) == content_of(file)
    assert check_file(smaller, entry).state == REPACKED
    assert check_file(smaller, entry).good


def test_one_pixel_or_one_bit_makes_another_content(file, tmp_path, monkeypatch):
    colour = camera_messages.colour_message
    known = content_of(file).topics

    def one_pixel_off(stamp_ns, name, pixels, quality, image_format="jpeg"):
        changed = pixels.copy()
        changed[3, 4, 1] ^= 1
        return colour(stamp_ns, name, changed, quality, image_format)

    monkeypatch.setattr("tests.helpers.hand_made_dive.colour_message", one_pixel_off)
    other = content_of(write_sequence(tmp_path / "other.mcap", "dive-01")).topics
    changed = {topic for topic in known if known[topic] != other[topic]}
    assert changed == {"/cam_left/image", "/cam_right/image"}


def test_content_of_an_image_is_its_pixels_and_not_its_bytes(tmp_path):
    pixels = np.arange(48 * 64 * 3, dtype=np.uint8).reshape(48, 64, 3)
    done, other = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    assert done
    np.testing.assert_array_equal(cv2.imdecode(other, cv2.IMREAD_UNCHANGED), pixels)
    png, jpeg = (write_dive(tmp_path / f"{form}.mcap", 0.5, form) for form in ("png", "jpeg"))
    assert content_of(png).topics["/cam_left/image"] != content_of(jpeg).topics["/cam_left/image"]
    assert content_of(png).topics["/imu"] == content_of(jpeg).topics["/imu"]


def test_another_attachment_is_another_content(file, tmp_path, monkeypatch):
    monkeypatch.setitem(TEXTS, "split.toml", b"seed = 1")
    other = write_sequence(tmp_path / "other.mcap", "dive-01")
    assert content_of(other).topics == content_of(file).topics
    assert content_of(other).attachments != content_of(file).attachments
    assert check_file(other, describe_file(file)).state == OTHER


def changed(manifest, change):
    document = json.loads(manifest.data)
    change(document)
    return json.dumps(document).encode()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="oysterbench-manifest/9"), "another version of oysterbench"),
        (lambda d: d.update(piece_size=0), "Expected `int` >= 1024 - at `$.piece_size`"),
        (lambda d: d.update(piece_size=1 << 27), "Expected `int` <= 67108864 - at `$.piece_size`"),
        (lambda d: d.update(piece_size=1.5), "Expected `int`, got `float` - at `$.piece_size`"),
        (lambda d: d.update(piece_size=True), "Expected `int`, got `bool` - at `$.piece_size`"),
        (lambda d: d.update(split="../../etc"), "at `$.split`"),
        (lambda d: d.update(version="1/../.."), "at `$.version`"),
        (lambda d: d.update(recipe_digest="abc"), "at `$.recipe_digest`"),
        (lambda d: d.pop("summary"), "missing required field `summary`"),
        (lambda d: d.update(files={}), "Expected `array`, got `object` - at `$.files`"),
        (lambda d: d.update(files=[3]), "Expected `object`, got `int` - at `$.files[0]`"),
        (lambda d: d["files"][0].update(name="../dive.mcap"), "at `$.files[0].name`"),
        (lambda d: d["files"][0].update(name="/etc/passwd.mcap"), "at `$.files[0].name`"),
        (lambda d: d["files"][0].update(name=".hidden.mcap"), "at `$.files[0].name`"),
        (lambda d: d["files"][0].update(name="dive-01.mcap\n"), "at `$.files[0].name`"),
        (lambda d: d["files"][0].update(size=-1), "Expected `int` >= 1 - at `$.files[0].size`"),
        (lambda d: d["files"][0].update(size=1 << 60), "do not make"),
        (lambda d: d["files"][0]["pieces"].append("0" * 64), "do not make"),
        (lambda d: d["files"][0]["pieces"].__setitem__(0, "x" * 64), "at `$.files[0].pieces[0]`"),
        (lambda d: d["files"][0].update(sha256="0" * 63), "at `$.files[0].sha256`"),
        (lambda d: d.update(files=d["files"] * 2), "a name occurs twice"),
    ],
)
def test_a_bad_manifest_is_refused_by_name_and_key(manifest, change, message):
    with pytest.raises(IntegrityError, match="the mirror's manifest") as caught:
        read_manifest(changed(manifest, change), "the mirror's manifest")
    assert message in str(caught.value)
    assert caught.value.exit_code == 3


def test_verify_tells_right_damaged_absent_and_unknown(manifest, file, tmp_path):
    (entry,) = manifest.files
    assert check_file(file, entry).state == RIGHT
    assert check_file(tmp_path / "no.mcap", entry).state == ABSENT
    damaged = tmp_path / "dive-01.mcap"
    data = bytearray(file.read_bytes())
    data[entry.span(2)[0] + 5] ^= 1
    damaged.write_bytes(data)
    check = check_file(damaged, entry)
    assert check.state == DAMAGED
    assert f"1 of {len(entry.pieces)} pieces are wrong, the first at byte {2 << 14}" in check.detail
    damaged.write_bytes(data[:1000])
    assert f"expected {entry.size} bytes, got 1000" in check_file(damaged, entry).detail
    damaged.write_bytes(file.read_bytes() + b"more")
    assert check_file(damaged, entry).state == DAMAGED
    assert check_unknown(file).state == UNKNOWN
    damaged.write_bytes(data)
    assert check_unknown(damaged).state == DAMAGED


def hide_truth(writer):
    """Statistics say that there is none, and readers do not ask them."""
    (truth,) = (key for key, channel in writer._Writer__channels.items() if channel.topic == "/truth/odometry")
    writer._Writer__statistics.channel_message_counts[truth] = 0


def lead_elsewhere(chunk):
    """Readers of one message by its number go where the index leads."""
    for index in chunk.message_indices.values():
        index.records[-1] = (index.records[-1][0], index.records[-1][1] + 9)


def leave_out_last(chunk):
    for index in chunk.message_indices.values():
        index.records.pop()


def end_early(chunk):
    """Readers of some time leave out the chunk."""
    chunk.message_end_time = chunk.message_start_time


@pytest.mark.parametrize(
    ("change", "of", "call", "cause"),
    [
        (hide_truth, Writer, "finish", "its statistics count 0 messages on /truth/odometry, it has 50"),
        (lead_elsewhere, ChunkBuilder, "end", "its index names other messages in the chunk at byte"),
        (leave_out_last, ChunkBuilder, "end", "its index names other messages in the chunk at byte"),
        (end_early, ChunkBuilder, "end", "its index has other times for the chunk at byte"),
    ],
)
def test_a_file_whose_index_says_something_else_than_its_chunks_is_damaged(
    manifest, tmp_path, monkeypatch, change, of, call, cause
):
    honest = getattr(of, call)
    monkeypatch.setattr(of, call, lambda self: (change(self), honest(self))[1])
    forged = write_sequence(tmp_path / "dive-01.mcap", "dive-01")
    with pytest.raises(SequenceError, match=cause):
        content_of(forged)
    assert check_file(forged, manifest.files[0], smaller=True).state == DAMAGED


def test_a_topic_on_two_channels_is_damage(tmp_path):
    path = tmp_path / "twice.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        for _ in range(2):
            writer.add_message(writer.register_channel("/a", "cdr", kind), 1, b"", 1)
        writer.finish()
    with pytest.raises(SequenceError, match="its index has two channels on /a"):
        content_of(path)


def test_verify_finds_the_manifest_of_a_file_beside_it_or_among_the_released(manifest, file, tmp_path, monkeypatch):
    alone = tmp_path / "dive-01.mcap"
    alone.write_bytes(file.read_bytes())
    assert [check.state for check in checks(str(alone))] == [UNKNOWN]
    assert [check.path for check in checks(str(tmp_path))] == [alone]
    with pytest.raises(HubError, match="expected a split, a sequence file or a folder"):
        list(checks(str(tmp_path / "nowhere")))
    released = {("fake-val", "1.0"): manifest}
    monkeypatch.setattr("oysterbench.hub.verify.released_manifest", lambda *key: released.get(key))
    assert [check.state for check in checks(str(alone))] == [RIGHT]
    monkeypatch.undo()
    (tmp_path / "manifest.json").write_bytes(manifest.data)
    assert [check.state for check in checks(str(alone))] == [RIGHT]


def test_released_manifests_are_found_by_split_and_version_only():
    assert released_manifest("no-such-split", "1.0") is None
    assert released_manifest("../splits/slam-mini", "1.0") is None
