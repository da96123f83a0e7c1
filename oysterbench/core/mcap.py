"""MCAP files from untrusted sources: their index, and messages in time order, in bounded time and memory.

The reader of the mcap package decompresses a chunk to whatever size its compressed bytes claim, and accepts records of
zero length: 9 kB can then cost minutes. Here a chunk decompresses to the size that it declares, or not at all.
"""

from __future__ import annotations

import heapq
import io
import os
import struct
import zlib
from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.summary import Summary

MAGIC = b"\x89MCAP0\r\n"
FOOTER = struct.Struct("<BQQQI")  # opcode, length of the rest, offsets of the summary and its offset section, its CRC
RECORD = struct.Struct("<BQ")  # opcode, length of the rest
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then the data

LARGEST_CHUNK = 1 << 27
"""Size limit of a decompressed chunk, bytes: 32 times what writers make by default. Recipes allow no camera whose
layers are larger (`recipe.rig.LARGEST_LAYER`)."""
MOST_RECORDS = 1 << 19
"""Limit on the records in a chunk: 4 times what fits into one of the default size."""
LARGEST_KEPT = 1 << 20
"""Size limit of an index that is cached once parsed, bytes: that of a file of some gigabytes."""


def read_summary(file: IO[bytes]) -> Summary | None:
    """Read the index of a file; None where it has none. It may be cached, so callers must not modify it. Raises
    ValueError, EOFError and errors of mcap for damage."""
    start = summary_start(file)
    if start == 0:
        return None
    size = file.seek(0, os.SEEK_END) - start
    file.seek(start)
    return _kept(file.read(size)) if size <= LARGEST_KEPT else _parsed(file)


@lru_cache(maxsize=8)
def _kept(index: bytes) -> Summary:
    """Parse the bytes of an index; cached, since viewers read it once per image."""
    return _parsed(io.BytesIO(index))


def _parsed(file: IO[bytes]) -> Summary:
    """Parse the index that starts at the file's current position."""
    summary = Summary()
    # A chunk does not belong here: with `emit_chunks` it is skipped without being decompressed.
    for record in StreamReader(file, skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, AttachmentIndex):
            summary.attachment_indexes.append(record)
        elif isinstance(record, ChunkIndex):
            summary.chunk_indexes.append(record)
        elif isinstance(record, MetadataIndex):
            summary.metadata_indexes.append(record)
    end = 0
    for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
        if index.chunk_start_offset < end:
            raise ValueError(f"its index has two chunks at byte {index.chunk_start_offset}")
        end = index.chunk_start_offset + index.chunk_length
    return summary


def summary_start(file: IO[bytes]) -> int:
    """Offset of the index, 0 where there is none. Raises ValueError or EOFError unless the file ends as it should and
    its index matches the CRC in the footer."""
    size = file.seek(0, os.SEEK_END)
    tail = FOOTER.size + len(MAGIC)
    if size < tail + len(MAGIC):
        raise EOFError("it ends before its index")
    file.seek(size - tail)
    end = file.read(tail)
    opcode, length, start, _, crc = FOOTER.unpack(end[: FOOTER.size])
    if end[FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or length != FOOTER.size - RECORD.size:
        raise EOFError("it has no end")
    if start == 0:
        return 0
    if not len(MAGIC) <= start <= size - tail:
        raise ValueError("its index is outside it")
    file.seek(start)
    # The CRC covers the footer as well, up to the CRC itself.
    # Zero means that there is none: a file from another program.
    if crc and zlib.crc32(file.read(size - tail - start) + end[: FOOTER.size - 4]) != crc:
        raise ValueError("the CRC of its index is wrong")
    return int(start)


def iter_metadata(file: IO[bytes], summary: Summary) -> Iterator[Metadata]:
    """Yield the metadata records of a file."""
    for index in summary.metadata_indexes:
        yield Metadata.read(_record_at(file, index.offset, Opcode.METADATA))


def iter_messages(
    file: IO[bytes],
    summary: Summary,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """Yield the messages of some topics (all by default) with `start_ns <= log_time < end_ns`, in order of log time.

    Only chunks that hold such messages are read, each when its time has come. Raises ValueError for messages of a
    channel that the index lacks.
    """
    low, high = -1 if start_ns is None else start_ns, 1 << 64 if end_ns is None else end_ns
    wanted = {key: channel for key, channel in summary.channels.items() if topics is None or channel.topic in topics}
    # Entries are ordered by time, offset of the chunk, and index within it: -1 for the chunk itself.
    queue: list[tuple[int, int, int, ChunkIndex | Message]] = [
        (index.message_start_time, index.chunk_start_offset, -1, index)
        for index in summary.chunk_indexes
        if index.message_end_time >= low
        and index.message_start_time < high
        # Without message indexes, only the chunk itself tells which channels it holds.
        and (not index.message_index_offsets or topics is None or wanted.keys() & index.message_index_offsets.keys())
    ]
    if not summary.chunk_indexes:
        queue = [(message.log_time, 0, k, message) for k, message in enumerate(_in_file(file))]
    heapq.heapify(queue)
    while queue:
        _, offset, _, item = heapq.heappop(queue)
        for k, message in enumerate(read_chunk(file, item) if isinstance(item, ChunkIndex) else (item,)):
            if message.channel_id not in summary.channels:
                raise ValueError(f"it has messages of a channel {message.channel_id}, which its index lacks")
            if message.channel_id not in wanted or not low <= message.log_time < high:
                continue
            if message is item:
                channel = wanted[message.channel_id]
                yield summary.schemas[channel.schema_id] if channel.schema_id else None, channel, message
            else:
                heapq.heappush(queue, (message.log_time, offset, k, message))


def read_chunk(file: IO[bytes], index: ChunkIndex) -> Iterator[Message]:
    """Messages of a chunk, in the order in which they were written; its CRC is checked."""
    return _messages(unpacked_chunk(file, index.chunk_start_offset))


def message_places(file: IO[bytes], index: ChunkIndex, channel: int) -> list[tuple[int, int]]:
    """Log time, ns, and offset in the chunk of each message of a channel, in the order of the file, without
    decompressing the chunk. Raises ValueError where the message index is wrong."""
    if channel not in index.message_index_offsets:
        return []
    record = MessageIndex.read(_record_at(file, index.message_index_offsets[channel], Opcode.MESSAGE_INDEX))
    if record.channel_id != channel:
        raise ValueError(f"its index names messages of channel {channel}, and finds those of {record.channel_id}")
    return [(int(stamp), int(place)) for stamp, place in record.records]


def chunk_places(file: IO[bytes], index: ChunkIndex) -> dict[int, list[tuple[int, int]]]:
    """Channel -> log time, ns, and offset in the chunk of each of its messages, from the chunk itself: what
    `message_places` should give. Its CRC is checked."""
    found: dict[int, list[tuple[int, int]]] = {}
    for place, message in _placed(unpacked_chunk(file, index.chunk_start_offset)):
        found.setdefault(message.channel_id, []).append((message.log_time, place))
    return found


def unpacked_chunk(file: IO[bytes], offset: int) -> bytes:
    """Decompressed records of the chunk at an offset of the file; its CRC is checked."""
    return _unpacked(Chunk.read(_record_at(file, offset, Opcode.CHUNK)))


def message_at(data: bytes, place: int, channel: int, stamp_ns: int) -> bytes:
    """Data of the message at an offset in a chunk's records. Raises ValueError where there is another one, or none."""
    opcode, length = RECORD.unpack_from(data, place)
    found, _, log_time, _ = MESSAGE.unpack_from(data, place + RECORD.size)
    if opcode != Opcode.MESSAGE or (found, log_time) != (channel, stamp_ns) or length < MESSAGE.size:
        raise ValueError(f"its index names a message of channel {channel} at {stamp_ns}, where there is none")
    begin = place + RECORD.size
    if begin + length > len(data):
        raise ValueError("a message ends after its chunk")
    return data[begin + MESSAGE.size : begin + length]


def _record_at(file: IO[bytes], offset: int, expected: Opcode) -> ReadDataStream:
    file.seek(offset)
    opcode, _ = RECORD.unpack(file.read(RECORD.size))
    if opcode != expected:
        raise ValueError(f"expected a record {expected.name} at byte {offset}, got one of number {opcode}")
    return ReadDataStream(file)


def _in_file(file: IO[bytes]) -> Iterator[Message]:
    """All messages of a file whose index names no chunk, in the order of the file."""
    file.seek(0)
    for record in StreamReader(file, emit_chunks=True).records:
        if isinstance(record, Message):
            yield record
        elif isinstance(record, Chunk):
            yield from _messages(_unpacked(record))


def _unpacked(chunk: Chunk) -> bytes:
    """Decompress the records of a chunk. Raises ValueError where their size is not the declared one, or they are
    damaged."""
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(
            f"expected chunks of at most {LARGEST_CHUNK >> 20} MiB unpacked, got {size >> 20} MiB; `mcap compress "
            "--chunk-size 4194304` writes smaller ones"
        )
    data = unpack(chunk.data, chunk.compression, size)
    if len(data) != size:
        raise ValueError(f"expected a chunk of {size} bytes, as it declares, got {_count(len(data), size)}")
    if chunk.uncompressed_crc and (crc := zlib.crc32(data)) != chunk.uncompressed_crc:
        raise CRCValidationError(chunk.uncompressed_crc, crc, chunk)
    return data


def _count(found: int, expected: int) -> str:
    return "more" if found > expected else f"{found}"


def unpack(data: bytes, compression: str, most: int) -> bytes:
    """Decompress data (zstd, lz4 or bz2) to `most` + 1 bytes at most; with an empty `compression`, return it as it
    is."""
    if compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            return bytes(reader.read(most + 1))
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        try:
            return bytes(LZ4FrameDecompressor().decompress(data, max_length=most + 1))
        except RuntimeError as error:
            raise ValueError(f"lz4: {error}") from None
    if compression == "bz2":  # in chunks of ROS 1 bags
        import bz2

        return bz2.BZ2Decompressor().decompress(data, most + 1)
    if compression:
        raise ValueError(f"expected chunks compressed with zstd or lz4, or uncompressed, got {compression!a:.40}")
    return data


def _messages(data: bytes) -> Iterator[Message]:
    return (message for _, message in _placed(data))


def _placed(data: bytes) -> Iterator[tuple[int, Message]]:
    """Messages among the records of a chunk, each with its offset."""
    at = count = 0
    while at < len(data):
        count += 1
        if count > MOST_RECORDS:
            raise ValueError(f"expected at most {MOST_RECORDS} records in a chunk, got more")
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if opcode == 0 or length > len(data) - at:
            raise ValueError(f"expected records in a chunk, got {'none' if opcode == 0 else 'a part of one'}")
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(data, at)
            message = Message(
                channel_id=channel,
                log_time=log_time,
                data=data[at + MESSAGE.size : at + length],
                publish_time=publish_time,
                sequence=sequence,
            )
            yield at - RECORD.size, message
        at += length
