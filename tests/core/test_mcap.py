"""MCAP files are read as mcap's own reader reads them, but where they unpack to more than they declare."""

from __future__ import annotations

import bz2
import io

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader

from oysterbench.core.mcap import LARGEST_CHUNK, iter_messages, iter_metadata, read_summary, unpack
from tests.helpers.forged_mcap import chunk_of, forged, message

ZEROS = bytes(1 << 20)


def messages_of(data, *window):
    file = io.BytesIO(data)
    summary = read_summary(file)
    assert summary is not None
    return list(iter_messages(file, summary, *window))


def streamed(data):
    """Compressed by zstd without the size that it unpacks to, which then only the chunk declares."""
    compressor = zstandard.ZstdCompressor().compressobj()
    return compressor.compress(data) + compressor.flush()


@pytest.mark.parametrize("topics", [None, {"/imu"}, {"/imu", "/cam_left/image", "/tf_static"}, {"/none"}])
def test_messages_come_as_the_library_reads_them(dive_file, topics):
    with open(dive_file, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        stamps = sorted(message.log_time for _, _, message in reader.iter_messages())
        for start, end in ((None, None), (stamps[9], None), (None, stamps[9]), (stamps[9], stamps[-9])):
            ours = list(iter_messages(file, summary, topics, start, end))
            assert ours == list(reader.iter_messages(topics, starting_at=start, ending_before=end))


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_chunks_of_every_compression_are_read(compression):
    records = message(3, b"three") + message(2, b"two")
    data = {"": None, "zstd": streamed(records), "lz4": lz4.frame.compress(records)}[compression]
    chunk = chunk_of(records, data, compression)
    for file in (forged(chunk), forged(chunk, indexed=False)):
        assert [message.data for _, _, message in messages_of(file)] == [b"two", b"three"]


def test_messages_outside_of_chunks_are_read():
    assert [message.data for _, _, message in messages_of(forged(loose=message(5, b"b") + message(4, b"a")))] == [
        b"a",
        b"b",
    ]


BOMBS = {
    "zstd says more than the chunk": (chunk_of(b"", zstandard.compress(ZEROS), "zstd", 999), "999 bytes, .* got more"),
    "zstd says nothing": (chunk_of(b"", streamed(ZEROS), "zstd", 999), "999 bytes, as it declares, got more"),
    "lz4": (chunk_of(b"", lz4.frame.compress(ZEROS), "lz4", 999), "999 bytes, as it declares, got more"),
    "stored": (chunk_of(message(1), size=9), "9 bytes, as it declares, got more"),
    "less than declared": (chunk_of(b"", streamed(ZEROS[:99]), "zstd", 999), "999 bytes, as it declares, got 99"),
    "huge, and honest": (chunk_of(b"", b"", "zstd", LARGEST_CHUNK + 1), "at most 128 MiB .* `mcap compress"),
    "no records": (chunk_of(ZEROS, streamed(ZEROS), "zstd"), "expected records in a chunk, got none"),
    "a part of a record": (chunk_of(message(1)[:-1]), "got a part of one"),
    "no messages": (chunk_of(message(1)[:9] + bytes(3)), "got a part of one"),
    "another compression": (chunk_of(b"x", compression="br"), "compressed with zstd or lz4, or uncompressed, got 'br'"),
    "no zstd": (chunk_of(b"x", b"x" * 20, "zstd"), "Unknown frame descriptor"),
    "no lz4": (chunk_of(b"x", b"x" * 20, "lz4"), "lz4: "),
    "wrong CRC": (chunk_of(message(1), crc=1), "crc validation failed"),
}


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.parametrize("indexed", [True, False])
def test_chunks_that_are_not_what_they_declare_are_refused(name, indexed):
    chunk, cause = BOMBS[name]
    with pytest.raises((ValueError, zstandard.ZstdError), match=cause):
        messages_of(forged(chunk, indexed=indexed))


def test_chunks_of_more_records_than_any_has_are_refused(monkeypatch):
    monkeypatch.setattr("oysterbench.core.mcap.MOST_RECORDS", 3)
    assert len(messages_of(forged(chunk_of(message(1) * 3)))) == 3
    with pytest.raises(ValueError, match="expected at most 3 records in a chunk, got more"):
        messages_of(forged(chunk_of(message(1) * 4)))


def test_an_index_that_leads_twice_to_a_chunk_or_elsewhere_is_refused():
    chunk = chunk_of(message(1))
    with pytest.raises(ValueError, match="two chunks at byte"):
        messages_of(forged(chunk, twice=True))
    file = io.BytesIO(forged(chunk, metadata_at=8))
    summary = read_summary(file)
    assert summary is not None
    with pytest.raises(ValueError, match="expected a record METADATA at byte 8, got one of number 1"):
        list(iter_metadata(file, summary))


@pytest.mark.parametrize(
    ("compression", "data"),
    [("zstd", streamed(ZEROS)), ("lz4", lz4.frame.compress(ZEROS)), ("bz2", bz2.compress(ZEROS))],
)
def test_what_is_unpacked_ends_after_what_was_asked_for(compression, data):
    assert unpack(data, compression, 999) == bytes(1000)
    assert unpack(data, compression, len(ZEROS)) == ZEROS
