"""Smaller sequence files: a selection of one's topics, attachments and metadata, copied chunk by chunk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import IO

from mcap.records import Channel, ChunkIndex
from mcap.summary import Summary

from oysterbench.core.atomic import appearing
from oysterbench.core.errors import SequenceError
from oysterbench.core.mcap import read_chunk as records_of
from oysterbench.core.ros import TF_STATIC, Message
from oysterbench.sensors.registry import sensor_kinds
from oysterbench.sequence.file import DAMAGE, Reading, damaged, read_attachments, read_metadata
from oysterbench.sequence.read import CALIBRATION, STEERING, McapSequence
from oysterbench.sequence.truth import TRUTH
from oysterbench.sequence.types import is_measured
from oysterbench.sequence.write import SequenceWriter

TOPICS = "topics-"
"""Prefix of the folders of smaller files."""

PUBLIC_METADATA = ("sequence", "split", "split_version", "track", "rig", "generation")
PUBLIC_ATTACHMENTS = (CALIBRATION, "classes.json")
"""What a hidden split shows besides measurements. These list what may be seen, so that anything new stays hidden until
it is listed. A topic is listed by the `leaves` of its kind of sensor."""


def is_public(topic: str) -> bool:
    """Whether a hidden split shows a topic: a measurement of a known kind of sensor, or the static transforms."""
    if topic == TF_STATIC:
        return True
    name, _, leaf = topic.removeprefix("/").partition("/")
    kinds = sensor_kinds()
    # Only of a kind that a rig has at most once is the name known: an altimeter is called anything, "altimeter" too.
    single = name in kinds and kinds[name].single
    listed = (kinds[name],) if single else (kind for kind in kinds.values() if not kind.single)
    return is_measured(topic) and any(leaf in kind.leaves for kind in listed)


def cut(
    source: Path,
    output: IO[bytes],
    keep_topic: Callable[[str], bool],
    keep_attachment: Callable[[str], bool] = lambda name: True,
    keep_metadata: Callable[[str], bool] = lambda key: True,
) -> None:
    """Copy the sequence file `source` with only the topics, attachments and metadata that are kept.

    Chunks keep their order and boundaries, so that small topics stay in chunks of their own. The same call gives the
    same bytes.
    """
    with Reading(source) as (file, summary):
        records = read_metadata(file, summary)
    types = {
        channel.topic: summary.schemas[channel.schema_id].name
        for channel in sorted(summary.channels.values(), key=lambda channel: channel.id)
        if keep_topic(channel.topic)
    }
    writer = SequenceWriter(output, types)
    for name, values in records.items():
        writer.metadata(name, {key: value for key, value in values.items() if keep_metadata(key)})
    media = {index.name: index.media_type for index in summary.attachment_indexes}
    for name, data in read_attachments(source).items():
        if keep_attachment(name):
            writer.attachment(name, media[name], data)
    for chunk in chunks_with(summary, types):
        writer.section()
        for message in read_chunk(source, chunk, summary.channels):
            if message.topic in types:
                writer.write(message)
    writer.finish()


def cut_to(target: Path, source: Path, topics: Collection[str]) -> None:
    """Write a smaller file with these topics of `source`; it appears complete or not at all."""
    with appearing(target) as file:
        cut(source, file, set(topics).__contains__)


def cut_public(source: Path, output: IO[bytes]) -> None:
    """Write what a hidden split shows of a sequence: measurements and calibration; no recipe, truth or digest."""
    cut(source, output, is_public, PUBLIC_ATTACHMENTS.__contains__, PUBLIC_METADATA.__contains__)


def cut_truth(source: Path, output: IO[bytes]) -> None:
    """Write what a hidden split withholds of a sequence, with what is needed to open it; `cut_public` has the rest."""
    shared = (TF_STATIC, "/imu")
    cut(source, output, lambda topic: not is_public(topic) or topic in shared or topic.endswith("/camera_info"))


def chunks_with(summary: Summary, topics: Collection[str]) -> list[ChunkIndex]:
    """Chunks that hold messages of some topics, in the order of the file."""
    wanted = {channel.id for channel in summary.channels.values() if channel.topic in topics}
    found = [index for index in summary.chunk_indexes if wanted & index.message_index_offsets.keys()]
    return sorted(found, key=lambda index: index.chunk_start_offset)


def read_chunk(path: Path, index: ChunkIndex, channels: Mapping[int, Channel]) -> Iterator[Message]:
    """Messages of a chunk, in the order in which they were written; the chunk's CRC is checked."""
    try:
        with open(path, "rb") as file:
            for record in records_of(file, index):
                yield Message(channels[record.channel_id].topic, record.log_time, record.data)
    except DAMAGE as error:
        raise SequenceError(damaged(path, str(error))) from None


def read_written(path: Path, topics: Collection[str]) -> Iterator[Message]:
    """Messages of some topics, in the order in which they were written; CRCs are checked."""
    with Reading(path) as (_, summary):
        chunks = chunks_with(summary, topics)
    for chunk in chunks:
        yield from (message for message in read_chunk(path, chunk, summary.channels) if message.topic in topics)


def smaller_files(folder: Path, sequence: str) -> list[Path]:
    """Smaller files of a sequence in the subfolders of a split's folder, for any choice of topics."""
    return sorted(folder.glob(f"{TOPICS}*/{sequence}.mcap"))


def topics_folder(folder: Path, wanted: Collection[str]) -> Path:
    """Subfolder of a split's folder for smaller files, one for each choice of topics."""
    return folder / f"{TOPICS}{hashlib.sha256(' '.join(sorted(wanted)).encode()).hexdigest()[:8]}"


def match_topics(known: Collection[str], wanted: Collection[str], what: str) -> list[str]:
    """Topics that match patterns such as `/imu` or `/cam_front/*`. Raises SequenceError where a pattern matches
    none."""
    from fnmatch import fnmatchcase

    for pattern in wanted:
        if not any(fnmatchcase(topic, pattern) for topic in known):
            raise SequenceError(f"{what}: no topic matches {pattern!r}; its topics: {', '.join(sorted(known))}")
    return [topic for topic in known if any(fnmatchcase(topic, pattern) for pattern in wanted)]


def is_scorable(sequence: McapSequence) -> bool:
    """Whether a sequence has the ground truth that its track is scored against."""
    if sequence.metadata.get("track") == "segmentation":
        from oysterbench.sequence.export.parts import labelled_cameras

        return bool(labelled_cameras(sequence))
    if sequence.metadata.get("track") == "steering":
        return STEERING in sequence.attachments
    return sequence.counts.get(TRUTH, 0) > 0
