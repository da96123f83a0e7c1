"""The records of a sequence file, to be changed one by one and put together again."""

from __future__ import annotations

import bz2
import io
import zlib
from dataclasses import dataclass, field
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    DataEnd,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from oysterbench.core.mcap import MAGIC, RECORD
from tests.fuzz.mutations import NUMBERS, WORDS, Rng, one, raw
from tests.helpers.forged_mcap import index_of, packed, with_summary


@dataclass
class Section:
    """A chunk: its messages; whatever else a record of it is to say; what is packed besides, and how."""

    messages: list[Message]
    compression: str = "zstd"
    said: dict[str, Any] = field(default_factory=dict)
    more: bytes = b""

    def record(self) -> Chunk:
        """As it stands in a file."""
        data = b"".join(packed(message) for message in self.messages) + self.more
        pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}
        times = [message.log_time for message in self.messages] or [0]
        values = {
            "compression": self.compression,
            "data": pack.get(self.compression, bytes)(data),
            "message_start_time": min(times),
            "message_end_time": max(times),
            "uncompressed_crc": zlib.crc32(data),
            "uncompressed_size": len(data),
        }
        return Chunk(**values | self.said)


@dataclass
class File:
    """The records of a file."""

    schemas: list[Schema]
    channels: list[Channel]
    sections: list[Section]
    attachments: list[Attachment]
    metadata: list[Metadata]
    statistics: Statistics

    def bytes(self, rng: Rng, spoilt: str = "") -> bytes:
        """The file; spoilt: the kind of records of its index that are changed, with the CRC made right again."""
        data = MAGIC + packed(Header(profile="ros2", library=""))
        index: list[Any] = [*self.schemas, *self.channels, self.statistics]
        for section in self.sections:
            chunk = section.record()
            record = packed(chunk)
            channels = (one.channel_id for one in section.messages)
            index.append(index_of(chunk, len(record), len(data), channels))
            data += record
        for one_ in self.attachments:
            record = packed(one_)
            index.append(
                AttachmentIndex(
                    offset=len(data),
                    length=len(record),
                    create_time=0,
                    log_time=0,
                    data_size=len(one_.data),
                    name=one_.name,
                    media_type=one_.media_type,
                )
            )
            data += record
        for meta in self.metadata:
            index.append(MetadataIndex(offset=len(data), length=len(packed(meta)), name=meta.name))
            data += packed(meta)
        data += packed(DataEnd(data_section_crc=0))
        if spoilt == "field":
            changed = one(rng, index)
            key = one(rng, [key for key, value in vars(changed).items() if isinstance(value, int)] or ["name"])
            setattr(changed, key, one(rng, NUMBERS) % (1 << 16) if key != "name" else one(rng, WORDS)[:300])
        summary = b"".join(packed(record) for record in index)
        return with_summary(data, raw(rng, summary) if spoilt == "bytes" else summary)


def read_file(data: bytes) -> File:
    """The records of a file that a writer has made."""
    reader = make_reader(io.BytesIO(data))
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    sections = []
    for index in summary.chunk_indexes:
        start = index.chunk_start_offset + RECORD.size
        chunk = Chunk.read(ReadDataStream(io.BytesIO(data[start:])))
        unpacked = zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)
        messages, at = [], 0
        while at < len(unpacked):
            opcode, length = RECORD.unpack_from(unpacked, at)
            at += RECORD.size
            if opcode == 5:
                messages.append(Message.read(ReadDataStream(io.BytesIO(unpacked[at : at + length])), length))
            at += length
        sections.append(Section(messages))
    return File(
        list(summary.schemas.values()),
        list(summary.channels.values()),
        sections,
        list(reader.iter_attachments()),
        list(reader.iter_metadata()),
        summary.statistics,
    )
