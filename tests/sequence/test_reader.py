"""The reader: by sensor and time range, in order, touching no more of the file than it must, and never the truth."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader

import oysterbench
from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.measurements import ImuMeasurement, SonarImage
from oysterbench.core.ros import EPOCH_NS, Message
from oysterbench.sensors.imu import KIND as IMU
from oysterbench.sensors.imu import ImuRecipe
from oysterbench.sequence.file import read_messages
from oysterbench.sequence.read import FAULTS, MOVING, OYSTERS
from oysterbench.sequence.write import SequenceWriter
from tests.helpers import hand_made_dive as dive
from tests.helpers.forged_mcap import chunk_of, forged

START = EPOCH_NS
READERS = {
    "imu": lambda s, *r: s.imu(*r),
    "dvl": lambda s, *r: s.dvl(*r),
    "pressure": lambda s, *r: s.pressure(*r),
    "magnetometer": lambda s, *r: s.magnetometer(*r),
    "ranges": lambda s, *r: s.ranges("alt", *r),
    "sonar": lambda s, *r: s.sonar("fls", *r),
    "scans": lambda s, *r: s.scans("msis", *r),
    "clouds": lambda s, *r: s.clouds("fls", *r),
    "images": lambda s, *r: s.images("cam_left", *r),
    "layer": lambda s, *r: s.layer("cam_left", "depth", *r),
}


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.mark.parametrize("kind", READERS)
def test_a_time_range_holds_its_first_stamp_and_not_its_last(sequence, kind):
    read = READERS[kind]
    whole = [sample.stamp_ns for sample in read(sequence)]
    assert whole == sorted(whole)
    assert len(whole) >= 4
    first, last = whole[1], whole[-1]
    assert [s.stamp_ns for s in read(sequence, first, last)] == whole[1:-1]
    assert [s.stamp_ns for s in read(sequence, None, last)] == whole[:-1]
    assert [s.stamp_ns for s in read(sequence, last)] == [last]
    assert [s.stamp_ns for s in read(sequence, last, last)] == []
    assert [s.stamp_ns for s in read(sequence, last + 1)] == []


def test_a_stream_merges_what_is_named_inertial_first(sequence):
    items = list(sequence.stream("fls", "dvl", "cam_left", "alt", "msis", "pressure", "magnetometer"))
    stamps = [item.stamp_ns for item in items]
    assert stamps == sorted(stamps)
    kinds = [type(item).__name__ for item in items]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {
        "ImuMeasurement": 200,
        "SonarImage": 10,
        "DvlMeasurement": 16,
        "Image": 20,
        "RangeMeasurement": 10,
        "ScanPing": 40,
        "PressureMeasurement": 40,
        "MagneticMeasurement": 100,
    }
    at_start = [type(item) for item in items if item.stamp_ns == START]
    assert at_start[:2] == [ImuMeasurement, SonarImage], "inertial first, then as named"
    part = list(sequence.stream("dvl", start_ns=START + 10**9, end_ns=START + 10**9 + 2 * 10**8))
    assert [type(item).__name__ for item in part].count("ImuMeasurement") == 20
    assert [type(item).__name__ for item in part].count("DvlMeasurement") == 2


def test_a_stream_of_no_name_is_of_all_cameras(sequence):
    cameras = {item.camera for item in sequence.stream() if hasattr(item, "camera")}
    assert cameras == {"cam_left", "cam_right"}


def test_an_unknown_sensor_is_named_with_what_there_is(sequence):
    with pytest.raises(SequenceError, match=r"no sensor 'fsl'; its sensors: imu, .*fls, msis, .*dvl"):
        list(sequence.stream("fsl"))
    with pytest.raises(SequenceError, match="no imaging sonar 'msis'; imaging sonars: fls"):
        list(sequence.sonar("msis"))
    with pytest.raises(SequenceError, match="no altimeter 'x'; altimeters: alt"):
        list(sequence.ranges("x"))


def test_a_sequence_without_a_sensor_says_so(tiny_file):
    sequence = oysterbench.open(tiny_file)
    for read in (sequence.dvl, sequence.pressure, sequence.magnetometer):
        with pytest.raises(SequenceError, match=r"has no .*oysterbench info"):
            list(read())
    assert sequence.sonars == {}


def test_calibrations_travel_in_the_file(sequence):
    known = dive.calibration()
    sonar = sequence.sonars["fls"]
    assert (sonar.beams, sonar.bins, sonar.frequency_hz) == (16, 40, 750e3)
    assert np.array_equal(sonar.azimuths_rad, known["sonars"]["fls"]["azimuths_rad"])
    assert np.array_equal(sequence.dvl_calibration.beam_directions, dive.DIRECTIONS)
    assert sequence.pressure_calibration.density == 1010.0
    assert sequence.altimeters["alt"].max_range_m == 100.0
    assert sequence.scanners["msis"].ranges_m.shape == (30,)
    assert sequence.magnetometer_calibration.T_base_sensor.shape == (4, 4)


def test_scalar_sensors_are_tables(sequence):
    made = dive.measurements()
    table = sequence.frame("/imu")
    assert list(table.columns) == ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    assert table.index.name == "stamp_ns"
    assert table.index.dtype == np.int64
    assert np.array_equal(table[["gyro_x", "gyro_y", "gyro_z"]].to_numpy(), [s.gyro for s in made.imu])
    speed = sequence.frame("/dvl/velocity")
    assert list(speed.columns[:3]) == ["velocity_x", "velocity_y", "velocity_z"]
    assert np.array_equal(speed.velocity_x.to_numpy(), [s.velocity[0] for s in made.dvl], equal_nan=True)
    beams = sequence.frame("/dvl/beams")
    assert list(beams.columns) == [f"{key}_{k}" for k in range(4) for key in ("range", "velocity", "valid")]
    assert np.array_equal(beams.range_3, [s.beam_ranges[3] for s in made.dvl], equal_nan=True)
    assert list(beams.valid_3) == [s.beam_valid[3] for s in made.dvl]
    assert np.array_equal(sequence.frame("/pressure").pressure, [s.pressure for s in made.pressure])
    assert np.array_equal(sequence.frame("/alt/range")["range"], [s.range for s in made.ranges])
    assert np.array_equal(sequence.frame("/msis/head").angle, [s.angle for s in made.scans])
    assert np.allclose(sequence.frame("/truth/odometry").velocity_x, dive.SPEED)
    assert len(sequence.frame("/truth/pose")) == len(sequence.truth())
    assert list(sequence.frame("/magnetometer", START, START + 10**8).index) == [
        START + k * 20_000_000 for k in range(5)
    ]
    with pytest.raises(SequenceError, match=r"topic '/cam_left/image' makes no table; .*/imu, "):
        sequence.frame("/cam_left/image")


def test_a_method_has_every_sensor_and_nothing_of_the_truth(sequence):
    sensors = sequence.for_method()
    for kind in ("imu", "dvl", "pressure", "magnetometer", "ranges", "sonar", "scans", "images"):
        got, expected = list(READERS[kind](sensors)), list(READERS[kind](sequence))
        assert [s.stamp_ns for s in got] == [s.stamp_ns for s in expected]
    assert len(list(sensors.stream("dvl", "fls"))) == 200 + 16 + 10
    assert len(sensors.frame("/imu")) == 200
    seen = {topic for topic, _, _ in sensors.contents()}
    assert seen == {
        "/tf_static",
        "/imu",
        "/dvl/velocity",
        "/dvl/beams",
        "/dvl/altitude",
        "/pressure",
        "/magnetometer",
        "/alt/range",
        "/msis/ping",
        "/msis/head",
        "/cam_left/image",
        "/cam_left/camera_info",
        "/cam_right/image",
        "/cam_right/camera_info",
        "/fls/image",
    }
    for forbidden in (
        sensors.truth,
        sensors.oysters,
        lambda: sensors.clouds("fls"),
        lambda: sensors.layer("cam_left", "depth"),
        lambda: sensors.frame("/truth/odometry"),
        lambda: sensors.frame("/truth/pose"),
    ):
        with pytest.raises(MethodError, match="may not see the ground truth"):
            forbidden()
    assert not hasattr(sensors, "attachments")
    assert not hasattr(sensors, "path")
    assert sensors.sonars == sequence.sonars


class Counting:
    """A file that counts the bytes read from it."""

    total = 0

    def __init__(self, path):
        self._file = open(path, "rb")  # noqa: SIM115

    def read(self, size=-1):
        data = self._file.read(size)
        Counting.total += len(data)
        return data

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._file.close()


@pytest.fixture
def counted(monkeypatch):
    """Bytes that the reader has read since the test began."""
    Counting.total = 0
    monkeypatch.setattr("oysterbench.sequence.file.open", lambda path, mode: Counting(path), raising=False)
    return lambda: Counting.total


def long_file(path, megabytes: int, seconds: float):
    """A file of that size: an inertial unit of 200 Hz, and noise for pictures, which nothing compresses."""
    generator = np.random.default_rng(0)
    types = {name: dive.all_types()[name] for name in ("/imu", "/truth/odometry", "/cam_left/image")}
    frame = 250_000
    (unit,) = dive.rig().of(ImuRecipe)
    with open(path, "wb") as file:
        writer = SequenceWriter(file, types)
        writer.metadata("oysterbench", {"sequence": "long"})
        writer.attachment("calibration.json", "application/json", json.dumps(dive.calibration()).encode())
        writer.attachment("truth/oysters.csv", "text/csv", generator.bytes(min(frame * 4, megabytes * 10_000)))
        for stamp, _ in dive.stamps(200, seconds):
            gyro, accel = generator.normal(size=(2, 3))
            writer.write(*IMU.encode(unit, ImuMeasurement(stamp, gyro, accel)))
        writer.section()
        n = megabytes * 1_000_000 // frame
        for k in range(n):
            data = b"\0\1\0\0" + struct.pack("<I", 0) + generator.bytes(frame)
            writer.write(Message("/cam_left/image", START + round(k * seconds / n * 1e9), data))
        writer.finish()
    return path


def share_read(path, counted, *span) -> float:
    sequence = oysterbench.open(path)
    measurements = list(sequence.imu(*span))
    assert len(measurements) > 50
    return counted() / path.stat().st_size


def test_reading_the_inertial_unit_reads_little_of_the_file(tmp_path, counted):
    """At the rate of two cameras of 20 Hz and 60 kB a frame: 2.5 MB in a second."""
    assert share_read(long_file(tmp_path / "long.mcap", 20, 8.0), counted) < 0.03


@pytest.mark.slow
def test_reading_the_inertial_unit_of_500_mb_reads_at_most_3_percent(tmp_path, counted):
    """The same for 200 s."""
    assert share_read(long_file(tmp_path / "long.mcap", 500, 200.0), counted) < 0.03


def test_a_time_range_reads_only_its_chunks(tmp_path, counted):
    path = long_file(tmp_path / "long.mcap", 40, 4.0)
    frames = list(read_messages(path, ["/cam_left/image"], START + 10**9, START + 10**9 + 2 * 10**8))
    assert len(frames) == 8
    assert counted() < 13_000_000, "three chunks of 4 MB at most"


# Damage ------------------------------------------------------------------------------------------------------------


def read_everything(path):
    """Every sample of every sensor, with the truth, the attachments and the tables."""
    sequence = oysterbench.open(path)
    found = {kind: list(read(sequence)) for kind, read in READERS.items()}
    found["layers"] = [
        image for layer in ("class", "instance", "visibility") for image in sequence.layer("cam_left", layer)
    ]
    found["right"] = list(sequence.images("cam_right"))
    found["truth"] = sequence.truth().positions.tolist()
    found["poses"] = sequence.frame("/truth/pose").to_numpy().tolist()
    found["oysters"] = sequence.oysters().to_numpy().tolist()
    found["attachments"] = {name: sequence.attachments[name] for name in sequence.attachments}
    found["metadata"] = dict(sequence.metadata)
    found["calibration"] = [sequence.sonars["fls"].ranges_m.tolist(), sequence.cameras["cam_left"].matrix.tolist()]
    return found


def equal(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(equal(x, y) for x, y in zip(a, b, strict=True))
    if hasattr(a, "__dataclass_fields__"):
        return equal(vars(a), vars(b))
    if isinstance(a, np.ndarray) or (isinstance(a, float) and isinstance(b, float)):
        return np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f")
    return a == b


@pytest.mark.parametrize("share", [0.0005, 0.2, 0.6, 0.95, 0.9999])
def test_a_truncated_file_is_refused_by_name(dive_file, tmp_path, share):
    short = tmp_path / "short.mcap"
    data = dive_file.read_bytes()
    short.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(SequenceError, match=r"short\.mcap: truncated or damaged.*render or download it again"):
        read_everything(short)


def test_a_flipped_bit_in_any_chunk_is_refused_for_its_topic(dive_file, tmp_path):
    """In the middle of each chunk's compressed records: whoever reads a topic of it is told."""
    with open(dive_file, "rb") as file:
        summary = make_reader(file).get_summary()
    names = {channel.id: channel.topic for channel in summary.channels.values()}
    data = dive_file.read_bytes()
    refused = set()
    for chunk in summary.chunk_indexes:
        flipped = bytearray(data)
        header = 9 + 8 + 8 + 8 + 4 + 4 + len(chunk.compression) + 8
        flipped[chunk.chunk_start_offset + header + chunk.compressed_size // 2] ^= 16
        path = tmp_path / "flipped.mcap"
        path.write_bytes(flipped)
        for topic in {names[channel] for channel in chunk.message_index_offsets}:
            with pytest.raises(SequenceError, match=r"flipped\.mcap: truncated or damaged"):
                list(read_messages(path, [topic]))
            refused.add(topic)
    assert refused == set(dive.all_types())


def test_a_flipped_bit_anywhere_never_passes_for_good(dive_file, tmp_path):
    data = dive_file.read_bytes()
    whole = read_everything(dive_file)
    assert equal(whole, read_everything(dive_file))
    generator = np.random.default_rng(3)
    messages: list[str] = []
    for position in generator.integers(0, len(data), 60):
        flipped = bytearray(data)
        flipped[position] ^= 1 << int(generator.integers(8))
        path = tmp_path / "flipped.mcap"
        path.write_bytes(flipped)
        try:
            got = read_everything(path)
        except SequenceError as error:
            messages.append(str(error))
            continue
        assert equal(got, whole), f"bit at byte {position} of {len(data)}"
    assert len(messages) > 40
    assert all("flipped.mcap" in line for line in messages)


def test_a_flipped_bit_in_metadata_attachments_or_the_index_is_refused(dive_file, tmp_path):
    data = dive_file.read_bytes()
    with open(dive_file, "rb") as file:
        summary = make_reader(file).get_summary()
    places = [index.offset + index.length - 20 for index in summary.attachment_indexes]
    places += [index.offset + index.length // 2 for index in summary.metadata_indexes]
    places += [len(data) - 60, len(data) - 300, len(data) - 2000]
    for place in places:
        flipped = bytearray(data)
        flipped[place] ^= 1
        path = tmp_path / "flipped.mcap"
        path.write_bytes(flipped)
        with pytest.raises(SequenceError, match=r"flipped\.mcap: truncated or damaged.*(CRC|end)"):
            read_everything(path)


def test_a_file_of_another_program_is_not_called_damaged(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="another")
        writer.add_metadata("oysterbench", {"sequence": "not ours"})
        writer.finish()
    with pytest.raises(SequenceError, match="an MCAP file, but not a sequence written by oysterbench"):
        oysterbench.open(path)


def test_nine_kilobytes_that_unpack_to_much_more_are_refused(dive_file, tmp_path):
    path = tmp_path / "bomb.mcap"
    records = zstandard.compress(bytes(1 << 22))
    path.write_bytes(forged(chunk_of(b"", records, "zstd", 25_000)))
    with pytest.raises(SequenceError, match=r"bomb\.mcap: .*a chunk of 25000 bytes, as it declares, got more"):
        list(read_messages(path))


@pytest.mark.parametrize(("name", "read"), [(OYSTERS, "oysters"), (FAULTS, "faults"), (MOVING, "moving")])
def test_a_table_that_lacks_a_column_is_damage(dive_file, monkeypatch, name, read):
    sequence = oysterbench.open(dive_file)
    monkeypatch.setattr(sequence, "attachments", {**sequence.attachments, name: b"size\n1\n"})
    with pytest.raises(SequenceError, match=f"damaged.*{name}: expected the columns"):
        getattr(sequence, read)()
