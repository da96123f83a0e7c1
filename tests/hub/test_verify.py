"""A render held against a release: to the byte, by what it says, or by its pixels; and what differs is named."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import HubError, IntegrityError
from oysterbench.hub.download import plan
from oysterbench.hub.manifest import describe_file
from oysterbench.hub.pixels import NUMBERS, share_within
from oysterbench.hub.release import keep_read, put_together
from oysterbench.hub.verify import (
    ALIKE,
    DAMAGED,
    FOREIGN,
    OTHER,
    REPACKED,
    RIGHT,
    SMALLER,
    UNKNOWN,
    check_file,
    check_released,
    checks,
    claims,
)
from oysterbench.sensors import camera_messages
from oysterbench.sequence.cut import cut_to
from tests.helpers import hand_made_dive, trees
from tests.helpers.trees import DIGEST, FACTS, TEXTS, write_bag, write_sequence


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("data") / "dive-01.mcap", "dive-01")


@pytest.fixture(scope="module")
def entry(file):
    return describe_file(file)


@pytest.fixture
def doctored(tmp_path, monkeypatch):
    """Writes the dive with other pictures, or layers: what is given changes the pixels of each."""

    def write(pictures=lambda pixels: pixels, layers=lambda layer, pixels: pixels):
        colour, layer_message = camera_messages.colour_message, camera_messages.layer_message
        with monkeypatch.context() as patch:
            patch.setattr(
                hand_made_dive,
                "colour_message",
                lambda stamp, name, pixels, *how: colour(stamp, name, pictures(pixels.copy()), *how),
            )
            patch.setattr(
                hand_made_dive,
                "layer_message",
                lambda stamp, name, layer, pixels: layer_message(stamp, name, layer, layers(layer, pixels.copy())),
            )
            return write_sequence(tmp_path / "dive-01.mcap", "dive-01")

    return write


def brighter(by, share=1.0):
    """Changes a share of the pixels, spread evenly, by so many grey levels towards the middle."""

    def change(pixels):
        spread = np.random.default_rng(3).random(pixels.shape) < share
        return np.where(spread, np.where(pixels > 127, pixels - by, pixels + by), pixels).astype(np.uint8)

    return change


def test_pictures_within_a_grey_level_are_alike_and_said_to_be(doctored, entry):
    check = check_file(doctored(brighter(1)), entry)
    assert (check.state, check.good) == (ALIKE, True)
    assert "/cam_left/image is within a grey level on 100 % of the pixels checked" in check.detail
    assert "/cam_right/image is within a grey level on 100 % of the pixels checked" in check.detail
    assert "/imu" not in check.detail


def test_few_pixels_further_off_are_forgiven_and_more_are_not(doctored, entry):
    assert check_file(doctored(brighter(40, 0.0001)), entry).state == ALIKE
    check = check_file(doctored(brighter(2, 0.02)), entry)
    assert (check.state, check.good) == (OTHER, False)
    assert "/cam_left/image is within a grey level on 9" in check.detail


def test_a_label_that_is_off_by_one_is_another_label(doctored, entry):
    check = check_file(doctored(layers=lambda layer, pixels: pixels + (layer == "instance")), entry)
    assert check.state == OTHER
    assert check.detail == "/cam_left/instance is within a grey level on 0 % of the pixels checked"


def test_a_millimetre_of_depth_is_alike_and_a_centimetre_is_not(doctored, entry):
    def deeper(by):
        return lambda layer, pixels: pixels + by * (layer == "depth")

    assert check_file(doctored(layers=deeper(0.001)), entry).state == ALIKE
    check = check_file(doctored(layers=deeper(0.01)), entry)
    assert (check.state, check.detail.split()[0]) == (OTHER, "/cam_left/depth")


def test_measurements_have_to_be_the_same(doctored, entry, monkeypatch):
    monkeypatch.setattr(hand_made_dive, "RATE", 0.2000001)
    check = check_file(doctored(), entry)
    assert check.state == OTHER
    assert "/imu differs" in check.detail


def test_a_sequence_of_another_length_says_how_many_messages_are_missing(tmp_path, entry):
    check = check_file(write_sequence(tmp_path / "dive-01.mcap", "dive-01", 0.5), entry)
    assert check.state == OTHER
    assert "/imu has 50 messages, expected 100" in check.detail


def test_a_file_with_some_of_the_topics_is_held_against_those(file, entry, tmp_path, doctored):
    some = tmp_path / "some" / "dive-01.mcap"
    cut_to(some, file, ["/imu", "/cam_left/image"])
    assert check_file(some, entry).state == OTHER, "where it should be complete"
    check = check_file(some, entry, smaller=True)
    assert (check.state, check.detail, check.good) == (SMALLER, f"2 of {len(entry.content)} topics", True)
    other = doctored(brighter(40))
    cut_to(some, other, ["/imu", "/cam_left/image"])
    assert check_file(some, entry, smaller=True).state == OTHER
    cut_to(some, file, [])
    assert check_file(some, entry, smaller=True).state == OTHER


def test_a_smaller_file_of_another_recipe_or_in_the_place_of_a_complete_one_is_not_right(file, tmp_path, monkeypatch):
    keep_read(tmp_path, "dive-01", file, ())
    manifest = put_together(tmp_path, FACTS, ["dive-01"], DIGEST, TEXTS)
    some, folder = tmp_path / "some" / "dive-01.mcap", tmp_path / "split"
    cut_to(some, file, ["/imu"])
    assert check_released(some, manifest).state == SMALLER
    other = write_sequence(tmp_path / "other.mcap", "dive-01", digest="0" * 64)
    cut_to(some, other, ["/imu"])
    assert check_released(some, manifest).state == OTHER
    folder.mkdir()
    (folder / "manifest.json").write_bytes(manifest.data)
    cut_to(folder / "dive-01.mcap", file, ["/imu"])
    assert [one.state for one in checks(str(folder))] == [OTHER]
    cut_to(folder / "topics-1" / "dive-01.mcap", file, ["/imu"])
    monkeypatch.setattr("oysterbench.hub.verify.released_manifest", lambda *key: manifest)
    assert [one.state for one in checks(str(folder))] == [OTHER, SMALLER]
    with pytest.raises(HubError, match=r"a different file has this name \(.*/cam_left/image is absent"):
        plan(manifest, manifest.files, some.parent.parent / "some")


def test_a_render_that_differs_says_which_versions_do(file, tmp_path, monkeypatch):
    keep_read(tmp_path, "dive-01", file, ())
    manifest = put_together(tmp_path, FACTS, ["dive-01"], DIGEST, TEXTS)
    assert check_released(file, manifest).state == RIGHT
    made = {**manifest.made_with, "numpy": "9.9"}
    monkeypatch.setattr("oysterbench.hub.verify.made_with", lambda: made)
    assert check_released(file, manifest).detail == ""
    loose = write_sequence(tmp_path / "loose.mcap", "dive-01", compress=False)
    check = check_released(loose, manifest)
    assert check.state == REPACKED
    assert check.detail.endswith(f"; released with numpy {manifest.made_with['numpy']} (here 9.9)")
    other = write_sequence(tmp_path / "other.mcap", "dive-01", 0.5, digest="0" * 64)
    assert "made by another recipe or generation" in check_released(other, manifest).detail
    monkeypatch.setattr("oysterbench.hub.verify.released_manifest", lambda *key: manifest)
    assert [one.state for one in checks(str(loose))] == [REPACKED]


def test_files_beside_those_of_the_manifest_are_checked_too(file, tmp_path):
    """Such as those of a split that was downloaded into the same folder before."""
    keep_read(tmp_path / "kept", "dive-01", file, ())
    manifest = put_together(tmp_path / "kept", FACTS, ["dive-01"], DIGEST, TEXTS)
    (tmp_path / "manifest.json").write_bytes(manifest.data)
    (tmp_path / "dive-01.mcap").write_bytes(file.read_bytes())
    (tmp_path / "before.mcap").write_bytes(file.read_bytes()[:-100])
    assert [(one.path.name, one.state) for one in checks(str(tmp_path))] == [
        ("dive-01.mcap", RIGHT),
        ("before.mcap", DAMAGED),
    ]


def test_smaller_files_are_held_against_the_manifest_of_the_folder_around_theirs(file, tmp_path):
    keep_read(tmp_path / "kept", "dive-01", file, ())
    manifest = put_together(tmp_path / "kept", FACTS, ["dive-01"], DIGEST, TEXTS)
    (tmp_path / "manifest.json").write_bytes(manifest.data)
    some = tmp_path / "topics-1" / "dive-01.mcap"
    (tmp_path / "dive-01.mcap").write_bytes(file.read_bytes())
    cut_to(some, file, ["/imu"])
    assert [one.state for one in checks(str(tmp_path))] == [RIGHT, SMALLER]
    cut_to(some, write_sequence(tmp_path / "other" / "dive-01.mcap", "dive-01", 0.5), ["/imu"])
    assert [one.state for one in checks(str(tmp_path))] == [RIGHT, OTHER]
    assert [one.state for one in checks(str(some))] == [OTHER]
    some.write_bytes(some.read_bytes()[:-9])
    (check,) = checks(str(some))
    assert check.state == DAMAGED
    assert "truncated or damaged" in check.detail


def test_files_of_other_programs_are_said_to_be_that_and_bad_only_where_they_are_named(file, tmp_path):
    (tmp_path / "dive-01.mcap").write_bytes(file.read_bytes())
    bag = write_bag(tmp_path / "bag.mcap")
    assert [(one.path.name, one.state, one.good) for one in checks(str(tmp_path))] == [
        ("bag.mcap", FOREIGN, True),
        ("dive-01.mcap", UNKNOWN, True),
    ]
    assert [(one.state, one.good) for one in checks(str(bag))] == [(FOREIGN, False)]
    (tmp_path / "dive-01.mcap").unlink()
    with pytest.raises(IntegrityError, match=r"expected sequence files \(\.mcap\)"):
        list(checks(str(tmp_path)))


def test_recordings_of_other_programs_without_an_index_are_not_called_damaged(file, tmp_path):
    """A legal file needs none, and one that was broken off has none."""
    bag = write_bag(tmp_path / "bag.mcap")
    bag.write_bytes(bag.read_bytes()[:-60])
    (check,) = checks(str(bag))
    assert (check.state, check.good, "delete" in check.detail) == (FOREIGN, False, False)
    for data in (file.read_bytes()[:-60], file.read_bytes()[:12] + b"?" + file.read_bytes()[13:-60]):
        (tmp_path / "dive-01.mcap").write_bytes(data)  # of ours, whose header may be damaged too
        assert [one.state for one in checks(str(tmp_path))] == [FOREIGN, DAMAGED]


def test_a_sound_file_that_this_version_cannot_open_is_not_damaged(tmp_path, monkeypatch):
    """Such as one whose calibration is of a later version."""
    known = trees.calibration()
    for camera in known["cameras"].values():
        camera["distortion_model"] = "double_sphere"
    monkeypatch.setattr(trees, "calibration", lambda: known)
    path = write_sequence(tmp_path / "dive-01.mcap", "dive-01")
    assert [one.state for one in checks(str(path))] == [UNKNOWN]


def test_a_file_tells_which_sequence_it_is_as_long_as_its_beginning_is_right(file, tmp_path):
    said, data = ("fake-val", "1.0", DIGEST), file.read_bytes()
    path = tmp_path / "dive-01.mcap"
    for whole in (data, data[:-100], data[:5000], data[:5000] + bytes(900)):
        path.write_bytes(whole)
        assert claims(path, *said)
        assert not claims(path, "fake-val", "1.1", DIGEST)
        assert not claims(path, "fake-val", "1.0", None)
        assert not claims(path.rename(tmp_path / "dive-02.mcap"), *said)
    for other in (b"", b"my notes", data[:100], bytes(5000) + data[5000:], data.replace(b"fake-val", b"fake-vam", 1)):
        path.write_bytes(other)
        assert not claims(path, *said)


def test_pixels_that_cannot_be_compared_are_like_none():
    assert share_within("/cam/image", "", "") == 0.0
    assert share_within("/cam/image", "|u1 AAEC", "|u1 AAECAw==") == 0.0
    assert share_within("/cam/image", "|u1 AAEC", "<u2 AAEC") == 0.0
    assert share_within("/cam/image", "|O AAEC", "|O AAEC") == 0.0
    assert share_within("/cam/image", "|u1 AAEC", "|u1 AQMC") == pytest.approx(2 / 3)


def test_a_share_of_a_thousandth_can_be_told():
    assert 1.0 - 2.0 / NUMBERS < 0.999 < 1.0 - 1.0 / NUMBERS


def test_a_folder_or_a_file_with_nothing_to_check_is_said_to_be_that(tmp_path):
    (tmp_path / "mine.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    with pytest.raises(IntegrityError, match=r"expected sequence files \(\.mcap\), or a published tree"):
        list(checks(str(tmp_path)))
    with pytest.raises(IntegrityError, match=r"mine\.tum: expected a sequence file \(\.mcap\) or weights"):
        list(checks(str(tmp_path / "mine.tum")))
    with pytest.raises(HubError, match=r"gone\.tum: expected a split, a sequence file or a folder"):
        list(checks(str(tmp_path / "gone.tum")))
