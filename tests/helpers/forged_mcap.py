"""MCAP files as somebody may forge them: their records as one likes, and their checksums right."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable

from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
)

from oysterbench.core.mcap import MAGIC, MESSAGE, RECORD

SCHEMA = Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data")
CHANNEL = Channel(id=1, topic="/a", message_encoding="cdr", metadata={}, schema_id=1)


def packed(record: McapRecord) -> bytes:
    """The bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def message(stamp: int, data: bytes = b"") -> bytes:
    """The bytes of a message of the channel 1: mcap's own class cannot write so many so fast."""
    return RECORD.pack(5, MESSAGE.size + len(data)) + MESSAGE.pack(1, 0, stamp, stamp) + data


def chunk_of(records: bytes, data: bytes | None = None, compression: str = "", size: int | None = None, crc: int = 0):
    """A chunk; data: the records, compressed; size: that it declares; its CRC by default is none."""
    return Chunk(
        compression=compression,
        data=records if data is None else data,
        message_start_time=1,
        message_end_time=9,
        uncompressed_crc=crc,
        uncompressed_size=len(records) if size is None else size,
    )


def index_of(chunk: Chunk, length: int, start: int, channels: Iterable[int] = ()) -> ChunkIndex:
    """What an index says of a chunk, whose record has so many bytes from `start` on, without indexes of messages."""
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets=dict.fromkeys(channels, 0),
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )


def forged(
    *chunks: Chunk, indexed: bool = True, twice: bool = False, loose: bytes = b"", metadata_at: int | None = None
):
    """The bytes of a file of chunks; indexed: whether its index names them; twice: the last one a second time; loose:
    records outside of chunks; metadata_at: where its index says that metadata is."""
    data = MAGIC + packed(Header(profile="ros2", library="")) + loose
    index = []
    for chunk in chunks:
        record = packed(chunk)
        index.append(index_of(chunk, len(record), len(data)))
        data += record
    data += packed(DataEnd(data_section_crc=0))
    statistics = Statistics(
        attachment_count=0,
        channel_count=1,
        channel_message_counts={1: 1},
        chunk_count=len(chunks),
        message_count=1,
        message_end_time=9,
        message_start_time=1,
        metadata_count=0,
        schema_count=1,
    )
    summary = packed(SCHEMA) + packed(CHANNEL) + packed(statistics)
    summary += b"".join(packed(one) for one in (index + index[-1:] * twice if indexed else []))
    if metadata_at is not None:
        summary += packed(MetadataIndex(length=0, name="oysterbench", offset=metadata_at))
    return with_summary(data, summary)


def with_summary(data: bytes, summary: bytes) -> bytes:
    """A file of these bytes and this index, with its end."""
    footer = packed(Footer(summary_start=len(data), summary_offset_start=0, summary_crc=0))
    crc = zlib.crc32(summary + footer[:-4])
    return data + summary + footer[:-4] + struct.pack("<I", crc) + MAGIC
