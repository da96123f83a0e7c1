"""The sequence file: opens with stock readers, gives back what went in, and refuses what is damaged."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

import oysterbench
from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import parse_split
from oysterbench.sensors.camera_messages import LAYERS
from oysterbench.sensors.imu import ImuRecipe
from oysterbench.sequence import Image, ImuMeasurement, sequences_in
from oysterbench.sequence.types import imu_arrays
from oysterbench.simulation.generate import generate_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT


@pytest.fixture(scope="module")
def sequence(tiny_file):
    return oysterbench.open(tiny_file)


def test_every_topic_has_its_messages(sequence):
    counts = {topic: n for topic, _, n in sequence.contents()}
    assert counts == {
        "/tf_static": 1,
        "/imu": 250,
        "/truth/odometry": 125,
        "/truth/pose": 125,
        "/tf": 125,
        "/cam_front/image": 25,
        "/cam_front/camera_info": 25,
        "/cam_front/depth": 5,
        "/cam_front/class": 5,
        "/cam_front/instance": 5,
    }


def test_images_come_with_stamps_in_order_and_the_size_of_the_camera(sequence):
    images = list(sequence.images("cam_front"))
    stamps = np.array([image.stamp_ns for image in images])
    assert np.array_equal(stamps, EPOCH_NS + np.arange(25) * 100_000_000)
    assert all(image.pixels.shape == (48, 64, 3) and image.pixels.dtype == np.uint8 for image in images)
    assert len({image.pixels.tobytes() for image in images}) == 25


def test_layers_have_their_kinds_and_agree_with_each_other(sequence):
    depth, classes, instances = (
        np.stack([image.pixels for image in sequence.layer("cam_front", layer)])
        for layer in ("depth", "class", "instance")
    )
    assert (depth.dtype, classes.dtype, instances.dtype) == (np.float32, np.uint8, np.uint16)
    assert set(np.unique(classes)) <= set(oysterbench.recipe.CLASSES)
    assert np.array_equal(depth == 0, classes == 0)
    assert np.array_equal(instances > 0, classes >= 2)
    assert (classes == 1).any()


def test_the_calibration_travels_in_the_file(sequence, tiny_split):
    camera = sequence.cameras["cam_front"]
    assert (camera.width, camera.height) == (64, 48)
    assert camera.matrix[0, 0] == pytest.approx(32 / np.tan(np.radians(34.5)))
    assert np.allclose(camera.T_base_cam[:3, :3] @ [0, 0, 1], [np.cos(np.pi / 6), 0, -0.5]), "30 degrees down"
    assert sequence.imu_calibration.gyro_noise_density == tiny_split.rig.of(ImuRecipe)[0].gyro_noise_density
    assert sequence.attachments["split.toml"].decode() == tiny_split.source


def test_the_stream_merges_sensors_in_time_order_inertial_first(sequence):
    items = list(sequence.stream())
    keys = [(item.stamp_ns, isinstance(item, Image)) for item in items]
    assert keys == sorted(keys)
    assert sum(isinstance(item, ImuMeasurement) for item in items) == 250
    assert sum(isinstance(item, Image) for item in items) == 25


def test_truth_is_a_trajectory_at_its_own_rate(sequence):
    truth = sequence.truth()
    assert np.all(np.diff(truth.stamps_ns) == 20_000_000)
    assert np.allclose(np.linalg.norm(truth.quaternions, axis=1), 1.0)
    assert -3.0 < truth.positions[0, 2] < -1.0


def test_the_truth_about_each_oyster_travels_in_the_file(sequence):
    oysters = sequence.oysters()
    assert len(oysters) == 60
    assert oysters.id.is_unique
    assert set(oysters.state) <= {"live", "box", "left valve", "right valve"}
    assert oysters.height_m.between(0.025, 0.173).all()
    assert (oysters.volume_m3 > 0).all()
    seen = {k for image in sequence.layer("cam_front", "instance") for k in np.unique(image.pixels)}
    classes = np.concatenate([image.pixels.ravel() for image in sequence.layer("cam_front", "class")])
    instances = np.concatenate([image.pixels.ravel() for image in sequence.layer("cam_front", "instance")])
    assert set(instances[classes == 2]) <= set(oysters.id)
    assert len(seen) > 3


def test_inertial_samples_agree_with_the_truth(sequence):
    stamps, gyro, accel = imu_arrays(sequence.imu())
    assert np.all(np.diff(stamps) == 10_000_000)
    assert np.linalg.norm(accel.mean(axis=0)) == pytest.approx(9.81, abs=0.1)
    assert np.abs(gyro).max() < 2.0


def test_rosbags_opens_the_file_with_its_own_types_and_decodes_every_message(tiny_file):
    with AnyReader([tiny_file]) as reader:
        decoded = [(stamp, reader.deserialize(raw, connection.msgtype)) for connection, stamp, raw in reader.messages()]
    assert len(decoded) == 691
    assert [stamp for stamp, _ in decoded] == sorted(stamp for stamp, _ in decoded)


def test_reading_the_inertial_unit_touches_no_image(tiny_file):
    with open(tiny_file, "rb") as file:
        summary = make_reader(file).get_summary()
    names = {channel.id: channel.topic for channel in summary.channels.values()}
    for chunk in summary.chunk_indexes:
        inside = {names[channel] for channel in chunk.message_index_offsets}
        if "/imu" in inside:
            assert inside == {"/imu"}


def test_every_layer_can_be_asked_for(tmp_path):
    asked = TINY_RIG + f"layers = {list(LAYERS)}\n".replace("'", '"')
    split = parse_split(TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0"), "tiny.toml", rig_source=asked)
    sequence = oysterbench.open(generate_split(split, tmp_path)["tiny-01"])
    found = {name: [image.pixels for image in sequence.layer("cam_front", name)] for name in LAYERS}
    assert {name: len(images) for name, images in found.items()} == dict.fromkeys(LAYERS, 2)
    depth, instance, normals, share = (found[name][0] for name in ("depth", "instance", "normals", "visibility"))
    bottom = depth > 0
    np.testing.assert_allclose(np.linalg.norm(normals[bottom], axis=-1), 1.0, atol=1e-3)
    assert np.isnan(share[instance == 0]).all()
    assert share[instance > 0].min() > 0
    assert share[instance > 0].max() == 1
    # What comes back from the bottom is weakened by the water, and the water adds light of its own.
    near = bottom & (found["clean"][0].min(axis=-1) > 0.01)
    assert np.median((found["direct"][0] / found["clean"][0])[near]) < 0.8
    assert found["backscatter"][0][bottom].min() > 0
    assert found["forward_scatter"][0].dtype == np.float32


def test_a_method_cannot_reach_the_truth(sequence):
    sensors = sequence.for_method()
    with pytest.raises(MethodError, match="may not see the ground truth"):
        sensors.truth()
    assert not any("truth" in topic for topic, _, _ in sensors.contents())
    assert next(sensors.images("cam_front")).stamp_ns == EPOCH_NS
    assert sensors.duration_s == sequence.duration_s


def read_all(path):
    sequence = oysterbench.open(path)
    sequence.truth()
    list(sequence.stream())
    for layer in ("depth", "class", "instance"):
        list(sequence.layer("cam_front", layer))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.9999])
def test_a_truncated_file_is_refused_by_name(tiny_file, tmp_path, share):
    short = tmp_path / "short.mcap"
    data = tiny_file.read_bytes()
    short.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(SequenceError, match=r"short\.mcap: truncated or damaged.*render or download it again"):
        read_all(short)


def test_a_flipped_bit_is_never_returned_as_good(tiny_file, tmp_path):
    data = tiny_file.read_bytes()
    whole = list(oysterbench.open(tiny_file).stream())
    generator = np.random.default_rng(0)
    refused = 0
    for position in generator.integers(0, len(data), 60):
        flipped = bytearray(data)
        flipped[position] ^= 1 << int(generator.integers(8))
        path = tmp_path / "flipped.mcap"
        path.write_bytes(flipped)
        try:
            sequence = oysterbench.open(path)
            got = list(sequence.stream())
        except SequenceError:
            refused += 1
            continue
        # A bit that no reader looks at (a chunk's own header, repeated in the index) may change nothing else.
        assert len(got) == len(whole)
        for item, expected in zip(got, whole, strict=True):
            assert item.stamp_ns == expected.stamp_ns
            if isinstance(item, Image):
                assert np.array_equal(item.pixels, expected.pixels)
            else:
                assert np.array_equal(item.gyro, expected.gyro)
    assert refused > 20


@pytest.mark.parametrize("content", [b"", b"not a sequence", b"\x89MCAP0\r\n"])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(SequenceError, match=r"other\.mcap: (not an MCAP file|truncated or damaged)"):
        oysterbench.open(path)


def test_a_file_of_ones_own_is_not_to_be_deleted(tmp_path):
    for name, told in (("dive.mp4", False), ("dive.mcap", True)):
        (tmp_path / name).write_bytes(b"not a sequence")
        with pytest.raises(SequenceError, match=r"not an MCAP file; expected a sequence \(\.mcap\)") as caught:
            oysterbench.open(tmp_path / name)
        assert ("delete it" in str(caught.value)) == told


def test_an_absent_file_and_camera_are_named(tmp_path, sequence):
    with pytest.raises(SequenceError, match="no such file"):
        oysterbench.open(tmp_path / "absent.mcap")
    with pytest.raises(SequenceError, match="no camera 'cam_down'; cameras: cam_front"):
        list(sequence.images("cam_down"))
    with pytest.raises(SequenceError, match="no layer 'normals'; its layers: depth, class, instance"):
        list(sequence.layer("cam_front", "normals"))


def test_a_folder_of_sequences_is_all_of_them_and_anything_else_is_itself(tmp_path):
    for name in ("b.mcap", "a.mcap", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "V1_01_easy" / "mav0").mkdir(parents=True)
    (tmp_path / "notes").mkdir()
    assert sequences_in(tmp_path) == [tmp_path / "V1_01_easy", tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path in (tmp_path / "V1_01_easy", tmp_path / "b.mcap", tmp_path / "absent"):
        assert sequences_in(path) == [path]
