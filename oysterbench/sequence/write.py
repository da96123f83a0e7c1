"""Writing a sequence file: MCAP in the ROS 2 profile, with small topics in chunks of their own."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from typing import IO, Any

from mcap.writer import CompressionType, Writer

from oysterbench.core.ros import EPOCH_NS, Message, channel_metadata, schema
from oysterbench.sequence.file import CHECKSUM, LIBRARY, checksum
from oysterbench.version import VERSION

CHUNK_BYTES = 4_000_000


class SequenceWriter:
    """Writer of messages to a binary stream. The same calls give the same bytes.

    Call `section` before each group of topics that is read by itself: the group then starts a chunk of its own,
    so that reading /imu touches none of the images.
    """

    def __init__(self, output: IO[bytes], types: Mapping[str, str], compress: bool = True) -> None:
        """types: topic -> message type, in the order in which the channels are registered."""
        compression = CompressionType.ZSTD if compress else CompressionType.NONE
        self._writer: Any = Writer(output, chunk_size=CHUNK_BYTES, compression=compression, enable_data_crcs=True)
        self._writer.start(profile="ros2", library=LIBRARY)
        schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts = dict.fromkeys(types, 0)
        for topic, type_name in types.items():
            if type_name not in schemas:
                schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", schema(type_name))
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", schemas[type_name], channel_metadata(topic, type_name)
            )

    def section(self) -> None:
        """Start a new chunk."""
        self._writer.flush()

    def write(self, message: Message) -> None:
        """Add a message."""
        self._writer.add_message(
            self._channels[message.topic],
            log_time=message.stamp_ns,
            publish_time=message.stamp_ns,
            data=message.data,
            sequence=self._counts[message.topic],
        )
        self._counts[message.topic] += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record, with its own checksum among the values: MCAP has none for it."""
        self._writer.add_metadata(name, {**values, CHECKSUM: checksum(values)})

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment."""
        self._writer.add_attachment(EPOCH_NS, EPOCH_NS, name, media_type, data)

    def finish(self) -> None:
        """Write indexes and statistics; the stream stays open."""
        self._writer.finish()


def pack(messages: Iterable[Message], types: Mapping[str, str], tables: Mapping[str, bytes] | None = None) -> bytes:
    """Pack messages, and CSV tables by name, into a small uncompressed MCAP file, with checksums."""
    output = io.BytesIO()
    writer = SequenceWriter(output, types, compress=False)
    for message in messages:
        writer.write(message)
    for name, table in (tables or {}).items():
        writer.attachment(name, "text/csv", table)
    writer.metadata("oysterbench_part", {"version": VERSION})
    writer.finish()
    return output.getvalue()
