"""Content of a sequence file irrespective of its compression: a hash of the decoded messages of each topic."""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
from mcap.summary import Summary

from oysterbench.core.mcap import chunk_places, iter_messages, message_places
from oysterbench.core.pictures import decode_picture
from oysterbench.core.ros import decode, stamp_of
from oysterbench.hub.canonical import sha256
from oysterbench.hub.pixels import sampler
from oysterbench.sensors.camera_messages import COLOUR
from oysterbench.sequence.file import Reading, read_attachments, read_messages

RECORD = struct.Struct("<qq")  # stamp in ns, bytes that follow


@dataclass(frozen=True)
class Content:
    """Content of a file. topics: topic -> {"type", "messages", "sha256"}, for those that have messages, and, for
    images, "pixels": a sample of their values; attachments: name -> SHA-256."""

    topics: dict[str, dict[str, Any]]
    attachments: dict[str, str]
    duration_ns: int


def content_of(path: Path) -> Content:
    """Hash all topics and attachments of a sequence file. Raises SequenceError where it is damaged, or its index says
    something else than its chunks.

    The hash of a topic covers each message's stamp (int64, ns), length (int64) and payload, in the order of the file.
    The payload is the CDR data; for an image in PNG, it is header, shape and pixels. So neither the compression of
    chunks nor that of PNG images changes it. JPEG stays as it is: its decoders may differ in the last bit.
    """
    with Reading(path) as (file, summary):
        _check_index(file, summary)
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    content = {}
    for channel in sorted(summary.channels.values(), key=lambda channel: channel.topic):
        if not counts.get(channel.id, 0):
            continue
        kind = summary.schemas[channel.schema_id].name
        whole, pixels = hashlib.sha256(), sampler(channel.topic, kind, counts[channel.id])
        for number, message in enumerate(read_messages(path, [channel.topic])):
            payload = decoded_image(message.data) if kind == COLOUR else message.data
            whole.update(RECORD.pack(message.stamp_ns, len(payload)))
            whole.update(payload)
            if pixels:
                pixels.see(number, message.data)
        content[channel.topic] = {"type": kind, "messages": counts[channel.id], "sha256": whole.hexdigest()}
        if pixels:
            content[channel.topic]["pixels"] = pixels.text()
    attachments = {name: sha256(data) for name, data in sorted(read_attachments(path).items())}
    statistics = summary.statistics
    return Content(content, attachments, statistics.message_end_time - statistics.message_start_time)


def _check_index(file: IO[bytes], summary: Summary) -> None:
    """Raise ValueError unless the index names exactly the messages that the chunks hold. Readers that seek one message,
    or those of some time, follow the index, and would else give other data than is hashed here."""
    topics = Counter(channel.topic for channel in summary.channels.values())
    if twice := [topic for topic, n in topics.items() if n > 1]:
        raise ValueError(f"its index has two channels on {twice[0]}")
    counts: Counter[int] = Counter()
    for index in summary.chunk_indexes:
        found = chunk_places(file, index)
        stamps = [stamp for places in found.values() for stamp, _ in places]
        if stamps and (index.message_start_time, index.message_end_time) != (min(stamps), max(stamps)):
            raise ValueError(f"its index has other times for the chunk at byte {index.chunk_start_offset}")
        # A chunk without message indexes is read whole.
        for number in {*found, *index.message_index_offsets} if index.message_index_offsets else ():
            if sorted(message_places(file, index, number)) != sorted(found.get(number, [])):
                raise ValueError(f"its index names other messages in the chunk at byte {index.chunk_start_offset}")
        counts.update({number: len(places) for number, places in found.items()})
    if not summary.chunk_indexes:
        counts.update(channel.id for _, channel, _ in iter_messages(file, summary))
    assert summary.statistics is not None
    told = Counter(summary.statistics.channel_message_counts)
    if unknown := counts.keys() - summary.channels.keys():
        raise ValueError(f"it has messages of a channel {min(unknown)}, which its index lacks")
    for number, channel in summary.channels.items():
        if counts[number] != told[number]:
            raise ValueError(
                f"its statistics count {told[number]} messages on {channel.topic}, it has {counts[number]}"
            )


def decoded_image(data: bytes) -> bytes:
    """CDR data of a compressed image; for PNG, which is lossless, its header, shape and pixels instead."""
    message = decode(data, COLOUR)
    if message.format != "png":
        return data
    pixels = decode_picture(message.data, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        return data
    shape = "x".join(str(n) for n in pixels.shape)
    head = f"{stamp_of(message.header)} {message.header.frame_id} {shape} {pixels.dtype.str} "
    return head.encode() + pixels.tobytes()
