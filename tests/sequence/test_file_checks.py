"""What `mcap doctor` looks at, on the records themselves: CRCs, indexes, schemas, statistics, times, chunks."""

from __future__ import annotations

import zlib

import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, MessageIndex, Statistics
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader, breakup_chunk

from oysterbench.core.ros import EPOCH_NS
from tests.helpers import hand_made_dive as dive


@pytest.fixture(scope="module", params=["dive_file", "tiny_file"])
def path(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def records(path):
    """All records of the file with where each begins and ends; the data section's CRC is checked on the way."""
    with open(path, "rb") as file:
        return list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)


def test_the_file_is_of_the_ros_2_profile(records):
    assert isinstance(records[0], Header)
    assert (records[0].profile, records[0].library) == ("ros2", "oysterbench")
    assert isinstance(records[-1], Footer)


def test_every_part_has_a_crc_that_holds(path, records):
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert chunks
    for chunk in chunks:
        assert chunk.uncompressed_crc != 0
        assert breakup_chunk(chunk, validate_crc=True)
    (end,) = (record for record in records if isinstance(record, DataEnd))
    assert end.data_section_crc != 0
    footer = records[-1]
    data = path.read_bytes()
    assert zlib.crc32(data[footer.summary_start : -12]) == footer.summary_crc != 0


def test_indexes_lead_to_what_they_say(path, records):
    data = path.read_bytes()
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert len(summary.chunk_indexes) == sum(isinstance(record, Chunk) for record in records)
    indexed = 0
    for index in summary.chunk_indexes:
        assert data[index.chunk_start_offset] == 0x06
        for channel, offset in index.message_index_offsets.items():
            assert data[offset] == 0x07
            assert int.from_bytes(data[offset + 9 : offset + 11], "little") == channel
    for record in records:
        if isinstance(record, MessageIndex):
            times = [stamp for stamp, _ in record.records]
            assert times == sorted(times)
            indexed += len(times)
    assert indexed == summary.statistics.message_count
    for index in summary.attachment_indexes:
        assert data[index.offset] == 0x09
    names = {record.name for record in records if isinstance(record, Attachment)}
    assert {index.name for index in summary.attachment_indexes} == names
    assert "calibration.json" in names


def test_statistics_are_what_is_there(records):
    counts: dict[int, int] = {}
    times = []
    for record in records:
        if isinstance(record, Chunk):
            for inner in breakup_chunk(record):
                if isinstance(inner, Record):
                    counts[inner.channel_id] = counts.get(inner.channel_id, 0) + 1
                    times.append(inner.log_time)
    (statistics,) = (record for record in records if isinstance(record, Statistics))
    assert statistics.channel_message_counts == counts
    assert statistics.message_count == sum(counts.values())
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    assert statistics.chunk_count == sum(isinstance(record, Chunk) for record in records)


def test_no_time_is_zero_and_chunks_span_their_messages(records):
    chunks = [record for record in records if isinstance(record, Chunk)]
    indexes = [record for record in records if isinstance(record, ChunkIndex)]
    for chunk, index in zip(chunks, indexes, strict=True):
        messages = [record for record in breakup_chunk(chunk) if isinstance(record, Record)]
        times = [message.log_time for message in messages]
        assert min(times) >= EPOCH_NS - 10**9
        assert all(message.publish_time == message.log_time for message in messages)
        assert (chunk.message_start_time, chunk.message_end_time) == (min(times), max(times))
        assert (index.message_start_time, index.message_end_time) == (min(times), max(times))
        assert times == sorted(times)


def test_messages_are_numbered_without_gaps(records):
    seen: dict[int, int] = {}
    for record in records:
        if isinstance(record, Chunk):
            for inner in breakup_chunk(record):
                if isinstance(inner, Record):
                    assert inner.sequence == seen.get(inner.channel_id, 0)
                    seen[inner.channel_id] = inner.sequence + 1


def test_every_channel_has_schema_qos_and_hash(records):
    channels = {record.id: record for record in records if isinstance(record, Channel)}
    assert len({channel.topic for channel in channels.values()}) == len(channels)
    for channel in channels.values():
        assert channel.schema_id != 0
        assert channel.message_encoding == "cdr"
        assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")


def test_scalar_topics_have_chunks_of_their_own(path):
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    names = {channel.id: channel.topic for channel in summary.channels.values()}
    scalar = [
        name for name in names.values() if name.startswith(("/imu", "/dvl", "/pressure", "/magnet", "/truth", "/tf"))
    ]
    scalar += [name for name in names.values() if name.endswith(("/range", "/head"))]
    for chunk in summary.chunk_indexes:
        inside = {names[channel] for channel in chunk.message_index_offsets}
        if inside & set(scalar):
            assert len(inside) == 1, inside


def test_the_same_dive_makes_the_same_bytes(tmp_path, dive_file):
    assert dive.write_dive(tmp_path / "again.mcap").read_bytes() == dive_file.read_bytes()
