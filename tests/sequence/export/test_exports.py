"""What holds of exports in every format."""

from __future__ import annotations

import json

import pytest
from rosbags.rosbag1 import Reader

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.sequence.cut import cut_to
from oysterbench.sequence.export import export_sequence


def test_nothing_is_overwritten(sequence, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(SequenceError, match="already exists and was left unchanged"):
        export_sequence(sequence, "kalibr", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_an_export_that_fails_leaves_nothing(dive_file, tmp_path):
    data = bytearray(dive_file.read_bytes())
    data[len(data) // 2] ^= 255  # among the images
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(SequenceError, match=r"damaged\.mcap: truncated or damaged"):
        export_sequence(oysterbench.open(damaged), "euroc", tmp_path / "out" / "here")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("form", ["euroc", "tum", "rosbag", "kalibr"])
def test_a_file_with_images_only_is_exported_without_inertial_measurements(form, sequence, dive_file, tmp_path):
    kept = [topic for topic, _, _ in sequence.contents() if topic.startswith(("/cam_left/", "/truth", "/tf_static"))]
    cut_to(tmp_path / "left.mcap", dive_file, kept)
    out = tmp_path / "out"
    export_sequence(oysterbench.open(tmp_path / "left.mcap"), form, out)
    assert "There are no inertial measurements of this sequence here." in (out / "README.txt").read_text()
    if form == "euroc":
        again = oysterbench.open(out)
        assert not again.has_imu
        images = [image.stamp_ns for image in sequence.images("cam_left")]
        assert [image.stamp_ns for image in again.images("cam0")] == images
        assert again.duration_s == pytest.approx((images[-1] - images[0]) * 1e-9)
    if form == "rosbag":
        with Reader(next(out.glob("*.bag"))) as bag:
            assert {connection.topic for connection in bag.connections} == {"/cam0/image_raw", "/groundtruth"}


def test_an_unknown_format_is_named(sequence, tmp_path):
    with pytest.raises(SequenceError, match="unknown format 'pcap'; formats: euroc, tum"):
        export_sequence(sequence, "pcap", tmp_path / "out")


def test_the_documents_are_json_and_yaml_of_others(folders):
    document = json.loads((folders["coco"] / "instances.json").read_text())
    assert set(document) == {"info", "licenses", "images", "annotations", "categories"}
