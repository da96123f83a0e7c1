"""Sequence files with bytes changed at random and every checksum made right again: read, or refused in a line."""

from __future__ import annotations

import io
import json
import math
import resource
import signal
import struct
import zlib

import numpy as np
import pytest
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk, Metadata

import oysterbench
from oysterbench.core.errors import OysterbenchError, SequenceError
from oysterbench.core.mcap import FOOTER, MAGIC, RECORD
from oysterbench.core.measurements import ImuMeasurement
from oysterbench.core.ros import Message, decode
from oysterbench.sensors.camera_messages import colour_message
from oysterbench.sensors.imu import KIND as IMU
from oysterbench.sensors.imu import ImuRecipe
from oysterbench.sequence import describe
from oysterbench.sequence.file import CHECKSUM, checksum
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS
from oysterbench.sequence.truth import read_truth, truth_message
from oysterbench.sequence.write import SequenceWriter
from tests.helpers import hand_made_dive as dive
from tests.helpers.forged_mcap import packed, with_summary
from tests.sequence.test_reader import read_everything

NUMBERS = [struct.pack("<Q", n) for n in (0, 1, 0xFF, 1 << 31, (1 << 32) - 1, 1 << 40, 1 << 63, (1 << 64) - 1)]
LIMIT_S, LIMIT_KIB = 10, 1 << 20


class Forger:
    """Changes files of one dive; `kinds` are what it changes."""

    def __init__(self, path, rng) -> None:
        self.plain = dive.write_dive(path / "plain.mcap", compress=False).read_bytes()
        self.small = dive.write_dive(path / "small.mcap").read_bytes()
        self.rng = rng
        indexes = (self.index, self.index_of_compressed)
        self.kinds = (self.messages, self.compressed, self.attachment, self.metadata, *indexes)

    def spoil(self, data: bytearray, start: int, end: int) -> None:
        """Put other bytes at a place or two, all within the span."""
        for _ in range(int(self.rng.integers(1, 4))):
            at = int(self.rng.integers(start, end))
            new = NUMBERS[self.rng.integers(len(NUMBERS))] if self.rng.random() < 0.5 else self.rng.bytes(1)
            data[at : min(at + len(new), end)] = new[: end - at]

    def one(self, found):
        return found[self.rng.integers(len(found))]

    def messages(self) -> bytes:
        """What a chunk holds."""
        data = bytearray(self.plain)
        index = self.one(summary_of(self.plain).chunk_indexes)
        end = index.chunk_start_offset + index.chunk_length
        self.spoil(data, end - index.uncompressed_size, end)
        crc = zlib.crc32(data[end - index.uncompressed_size : end])
        struct.pack_into("<I", data, index.chunk_start_offset + RECORD.size + 24, crc)
        return bytes(data)

    def compressed(self) -> bytes:
        """What is to be unpacked, without a checksum of what should come of it."""
        data = bytearray(self.small)
        index = self.one(summary_of(self.small).chunk_indexes)
        end = index.chunk_start_offset + index.chunk_length
        chunk = Chunk.read(ReadDataStream(io.BytesIO(data[index.chunk_start_offset + RECORD.size : end])))
        self.spoil(data, end - len(chunk.data), end)
        struct.pack_into("<I", data, index.chunk_start_offset + RECORD.size + 24, 0)
        return bytes(data)

    def attachment(self) -> bytes:
        data = bytearray(self.plain)
        index = self.one(summary_of(self.plain).attachment_indexes)
        start, end = index.offset + RECORD.size, index.offset + index.length
        self.spoil(data, start, end - 4)
        struct.pack_into("<I", data, end - 4, zlib.crc32(data[start : end - 4]))
        return bytes(data)

    def metadata(self) -> bytes:
        """A value; the record stays as long as it was."""
        data = bytearray(self.plain)
        index = self.one(summary_of(self.plain).metadata_indexes)
        start = index.offset + RECORD.size
        record = Metadata.read(ReadDataStream(io.BytesIO(data[start:])))
        values = {key: value for key, value in record.metadata.items() if key != CHECKSUM}
        key = self.one(sorted(values))
        values[key] = "".join(chr(c) for c in self.rng.integers(0, 128, len(values[key])))
        record.metadata = {name: {**values, CHECKSUM: checksum(values)}[name] for name in record.metadata}
        data[index.offset : index.offset + index.length] = packed(record)
        return bytes(data)

    def index(self) -> bytes:
        return self._index_of(self.plain)

    def index_of_compressed(self) -> bytes:
        return self._index_of(self.small)

    def _index_of(self, data: bytes) -> bytes:
        start, end = summary_span(data)
        summary = bytearray(data[start:end])
        self.spoil(summary, 0, len(summary))
        return with_summary(data[:start], bytes(summary))


def summary_of(data):
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    return summary


def summary_span(data) -> tuple[int, int]:
    """From the first record of the index to its end, without the offsets of its groups, which nothing here reads."""
    end = len(data) - FOOTER.size - len(MAGIC)
    _, _, start, offsets, _ = FOOTER.unpack(data[end : end + FOOTER.size])
    return start, offsets or end


def read(path) -> None:
    describe(path)
    read_everything(path)


def forge_and_read(forger, folder, times) -> int:
    """How many of so many files of each kind were refused. Fails for a traceback."""
    refused = 0
    path = folder / "forged.mcap"
    for _ in range(times):
        for kind in forger.kinds:
            path.write_bytes(kind())
            try:
                read(path)
            except OysterbenchError:
                refused += 1
    return refused


@pytest.mark.parametrize(
    ("position", "attitude"),
    [
        ([np.nan, 0, 0], [0, 0, 0, 1]),
        ([1e300, 0, 0], [0, 0, 0, 1]),
        ([0, 0, 0], [0, 0, 0, 0]),
        ([0, 0, 0], [1e300] * 4),
    ],
)
def test_a_truth_that_is_no_path_is_refused(position, attitude):
    def read(position, attitude):
        vectors = (np.array(value, float) for value in (position, attitude, [0, 0, 0], [0, 0, 0]))
        return read_truth([truth_message(1, *vectors).data])

    assert len(read([1, 2, 3], [0, 0, 0, 1])) == 1
    with pytest.raises(ValueError, match="expected positions within 1e\\+09 m and unit quaternions"):
        read(position, attitude)


def test_a_few_forged_files_are_read_or_refused(tmp_path):
    forger = Forger(tmp_path, np.random.default_rng(1))
    assert forge_and_read(forger, tmp_path, 3) > 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 12))
def test_forged_files_are_read_or_refused_in_little_time_and_memory(tmp_path, seed):
    def late(number: int, frame: object) -> None:
        raise AssertionError(f"more than {LIMIT_S} s for a file")

    forger = Forger(tmp_path, np.random.default_rng(seed))
    before = signal.signal(signal.SIGALRM, late)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        for _ in range(50):
            signal.alarm(LIMIT_S * len(forger.kinds))
            forge_and_read(forger, tmp_path, 1)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < LIMIT_KIB


def write(path, content: bytes, name: str = "forged", messages=()):
    """A file with a calibration, and messages of the topics and types of the hand-made dive."""
    types = dive.all_types()
    with open(path, "wb") as file:
        writer = SequenceWriter(file, {message.topic: types[message.topic] for message in messages})
        writer.metadata(METADATA, {"sequence": name})
        writer.attachment(CALIBRATION, "application/json", content)
        for message in messages:
            writer.write(message)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "content", [b"[" * 100_000, b'{"cameras": 1}', b'{"cameras": {}, "imu": []}', b"9" * 5000, b"\xff"]
)
def test_a_calibration_that_is_none_is_refused_in_a_line(tmp_path, content):
    path = write(tmp_path / "forged.mcap", content)
    with pytest.raises(SequenceError, match=r"forged\.mcap: truncated or damaged"):
        oysterbench.open(path)


@pytest.mark.parametrize(
    ("sensor", "key", "value", "message"),
    [
        ("camera", "distortion_model", "mei", "expected plumb_bob or equidistant, got mei"),
        ("camera", "distortion", [0.1] * 2, "expected 4 or 5 coefficients for plumb_bob"),
        ("camera", "distortion", [0.1] * 9, "expected 4 or 5 coefficients for plumb_bob"),
        ("camera", "matrix", [[math.nan] * 3] * 3, "matrix: expected finite numbers"),
        ("camera", "matrix", np.eye(2).tolist(), r"matrix: expected \(3, 3\) with focal lengths above zero"),
        ("camera", "T_base_cam", np.eye(3).tolist(), r"T_base_cam: expected a rigid transform \(4, 4\)"),
        ("camera", "T_base_cam", np.zeros((4, 4)).tolist(), "T_base_cam: expected a rigid transform"),
        ("camera", "T_base_cam", np.diag([1, 1, -1, 1]).tolist(), "T_base_cam: expected a rigid transform"),
        ("camera", "time_offset_s", 1e300, "expected a time offset of at most"),
        ("dvl", "T_base_sensor", np.zeros((4, 4)).tolist(), "T_base_sensor: expected a rigid transform"),
        ("imu", "rate_hz", math.inf, "rate_hz: expected finite numbers"),
    ],
)
def test_a_calibration_that_no_sensor_has_is_refused(tmp_path, sensor, key, value, message):
    known = dive.calibration()
    entry = known["cameras"]["cam_left"] if sensor == "camera" else known[sensor]
    entry[key] = value
    path = write(tmp_path / "forged.mcap", json.dumps(known).encode())
    with pytest.raises(SequenceError, match=message):
        oysterbench.open(path)


def imu(stamp: int, force: float = 9.8) -> bytes:
    recipe = ImuRecipe(
        rate_hz=100.0,
        gyro_noise_density=1e-4,
        gyro_random_walk=1e-4,
        accel_noise_density=1e-4,
        accel_random_walk=1e-4,
    )
    return IMU.encode(recipe, ImuMeasurement(stamp, np.zeros(3), np.full(3, force)))[0].data


def test_stamps_that_go_back_in_the_headers_alone_are_refused(tmp_path):
    sent = [Message("/imu", stamp, imu(own)) for stamp, own in ((1, 10**18), (2, 10**18 + 1), (3, 5))]
    sequence = oysterbench.open(write(tmp_path / "forged.mcap", json.dumps(dive.calibration()).encode(), messages=sent))
    with pytest.raises(SequenceError, match="/imu: expected stamps in time order, got 5 after 1000000000000000001"):
        list(sequence.imu())


def test_samples_of_an_inertial_unit_that_are_not_finite_are_refused(tmp_path):
    sent = [Message("/imu", 1, imu(1, math.nan))]
    sequence = oysterbench.open(write(tmp_path / "forged.mcap", json.dumps(dive.calibration()).encode(), messages=sent))
    with pytest.raises(SequenceError, match="imu: expected finite angular rates and specific forces"):
        list(sequence.imu())


def test_an_image_of_another_size_than_its_calibration_is_refused(tmp_path):
    known = dive.calibration()
    known["cameras"]["cam_left"]["width"] *= 2
    pixels = np.zeros((dive.HEIGHT, dive.WIDTH, 3), np.uint8)
    sent = [colour_message(1, "cam_left", pixels, 95)]
    sequence = oysterbench.open(write(tmp_path / "forged.mcap", json.dumps(known).encode(), messages=sent))
    with pytest.raises(SequenceError, match="expected images of 128 x 48 px, as its calibration says, got 64 x 48"):
        list(sequence.images("cam_left"))


def test_a_truth_whose_stamps_stand_still_is_refused():
    still = [np.array(value, float) for value in ([0, 0, 0], [0, 0, 0, 1], [0, 0, 0], [0, 0, 0])]
    with pytest.raises(ValueError, match="/truth/odometry: expected stamps that increase"):
        read_truth([truth_message(1, *still).data, truth_message(1, *still).data])


@pytest.mark.parametrize("name", ["../../thesis", "/tmp/thesis", "..", "", "a b"])
def test_a_name_that_could_lead_out_of_a_folder_is_refused(tmp_path, name):
    known = dive.calibration()
    path = write(tmp_path / "forged.mcap", json.dumps(known).encode(), name)
    with pytest.raises(
        SequenceError, match=r"forged\.mcap: name of the sequence: expected letters, digits, '-' and '_'"
    ):
        oysterbench.open(path)
    known["cameras"][name] = known["cameras"].pop("cam_left")
    path = write(tmp_path / "forged.mcap", json.dumps(known).encode())
    with pytest.raises(SequenceError, match=r"forged\.mcap: name of a sensor: expected letters, digits, '-' and '_'"):
        oysterbench.open(path)


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\x00\x01\x00\x00" + b"\xff" * 40, b"\x00\x09" + b"\0" * 400])
def test_bytes_that_are_no_message_are_a_value_error(data):
    with pytest.raises((ValueError, LookupError, struct.error)):
        decode(data, "sensor_msgs/msg/Imu")


@pytest.mark.parametrize("row", ["70000,live,1", "-1,live,1", "1.5,live,1", "x,live,1", "7,live,deep"])
def test_oysters_that_no_picture_can_show_are_damage(tmp_path, row):
    path = tmp_path / "forged.mcap"
    with open(path, "wb") as file:
        writer = SequenceWriter(file, {})
        writer.metadata(METADATA, {"sequence": "forged"})
        writer.attachment(CALIBRATION, "application/json", json.dumps(dive.calibration()).encode())
        writer.attachment(OYSTERS, "text/csv", f"id,state,x\n{row}\n".encode())
        writer.finish()
    with pytest.raises(SequenceError, match=r"forged\.mcap: truncated or damaged"):
        oysterbench.open(path).oysters()
