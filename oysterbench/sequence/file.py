"""Access to an MCAP file such that no damaged byte passes for a good one."""

from __future__ import annotations

import contextlib
import io
import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header, Metadata
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from zstandard import ZstdError

from oysterbench.core.errors import SequenceError
from oysterbench.core.mcap import MAGIC, RECORD, iter_messages, iter_metadata, read_summary
from oysterbench.core.ros import Message

DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    ArithmeticError,
    MemoryError,
    OSError,
    AttributeError,
)
"""Exceptions that the underlying libraries raise on damaged bytes."""

LIBRARY = "oysterbench"
"""Name of the program in the header of a file. Without a version: a release of code must not change the bytes."""

CHECKSUM = "crc32"

START = 1 << 12
"""Bytes at the beginning of a file that `SequenceWriter` wrote, with its first metadata."""


class Reading:
    """Context that opens an MCAP file and its index, with statistics; any damage is raised as one SequenceError.

    The CRCs of the index and of each chunk that is read are checked in `core.mcap`; those of attachments in
    `read_attachment`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> tuple[IO[bytes], Summary]:
        self._file = open(self.path, "rb")
        try:
            if self._file.read(len(MAGIC)) != MAGIC:
                remedy = "; delete it and render or download it again" if self.path.suffix == ".mcap" else ""
                raise SequenceError(
                    f"{self.path}: not an MCAP file; expected a sequence (.mcap) or an EuRoC folder{remedy}"
                )
            summary = read_summary(self._file)
            if summary is None or summary.statistics is None:
                raise SequenceError(damaged(self.path, "it has no index"))
            return self._file, summary
        except SequenceError:
            self._file.close()
            raise
        except DAMAGE as error:
            self._file.close()
            raise SequenceError(damaged(self.path, str(error) or type(error).__name__)) from None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if isinstance(error, DAMAGE) and not isinstance(error, SequenceError):
            raise SequenceError(damaged(self.path, str(error) or type(error).__name__)) from None


def damaged(path: Path, cause: str) -> str:
    """Message about a damaged file."""
    return (
        f"{path}: truncated or damaged ({cause or 'unreadable'}); expected a whole sequence file; "
        "delete it and render or download it again"
    )


def checksum(values: Mapping[str, str]) -> str:
    """CRC of the values of a metadata record, which MCAP leaves unprotected."""
    return f"{zlib.crc32(json.dumps(dict(values), sort_keys=True).encode()):08x}"


def read_metadata(file: IO[bytes], summary: Summary) -> dict[str, dict[str, str]]:
    """Read the metadata records that `SequenceWriter` wrote, by name. Raises ValueError where a checksum is wrong."""
    found = {}
    for record in iter_metadata(file, summary):
        if CHECKSUM in record.metadata:  # or it is from another program
            found[record.name] = _checked(record)
    return found


def first_metadata(path: Path, name: str) -> dict[str, str]:
    """Values of the metadata record of that name at the beginning of a file, also of one that is damaged or ends behind
    it; empty where there is none, or it is damaged itself."""
    with open(path, "rb") as file:
        start = io.BytesIO(file.read(START))
    with contextlib.suppress(*DAMAGE):
        for record in StreamReader(start, emit_chunks=True).records:
            if isinstance(record, Metadata) and record.name == name:
                return _checked(record)
    return {}


def first_library(path: Path) -> str:
    """Name of the program that wrote an MCAP file, by its header; empty where it names none or is damaged there."""
    with open(path, "rb") as file, contextlib.suppress(*DAMAGE):
        start = io.BytesIO(file.read(START))
        header = next(iter(StreamReader(start, emit_chunks=True).records))
        return header.library if isinstance(header, Header) else ""
    return ""


def _checked(record: Metadata) -> dict[str, str]:
    values = {key: value for key, value in record.metadata.items() if key != CHECKSUM}
    if record.metadata[CHECKSUM] != checksum(values):
        raise ValueError(f"the CRC of the metadata {record.name!r} is wrong")
    return values


def read_attachment(file: IO[bytes], offset: int) -> tuple[str, bytes]:
    """Read the name and data of the attachment at an offset. Raises ValueError where its CRC is wrong."""
    file.seek(offset)
    opcode, length = RECORD.unpack(file.read(RECORD.size))
    if opcode != Opcode.ATTACHMENT:
        raise ValueError(f"expected an attachment at byte {offset}")
    record = file.read(length)
    if len(record) != length:
        raise EOFError("it ends within an attachment")
    if zlib.crc32(record[:-4]) != struct.unpack("<I", record[-4:])[0]:
        raise ValueError(f"the CRC of the attachment at byte {offset} is wrong")
    (n,) = struct.unpack_from("<I", record, 16)  # after two stamps
    name = record[20 : 20 + n].decode()
    (m,) = struct.unpack_from("<I", record, 20 + n)
    return name, record[32 + n + m : -4]  # after the media type and the length of the data


class Attachments(Mapping[str, bytes]):
    """Attachments of a file by name, each read and checked on access."""

    def __init__(self, path: Path, summary: Summary) -> None:
        self._path = path
        self._offsets = {index.name: index.offset for index in summary.attachment_indexes}

    def __getitem__(self, name: str) -> bytes:
        offset = self._offsets[name]
        try:
            with open(self._path, "rb") as file:
                found, data = read_attachment(file, offset)
                if found != name:
                    raise ValueError(f"expected the attachment {name}, got {found}")
                return data
        except DAMAGE as error:
            raise SequenceError(damaged(self._path, str(error))) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._offsets)

    def __len__(self) -> int:
        return len(self._offsets)


def read_attachments(path: Path) -> Attachments:
    """Attachments of a sequence file by name."""
    with Reading(path) as (_, summary):
        return Attachments(path, summary)


def read_messages(
    path: Path, names: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[Message]:
    """Yield the messages of some topics (all by default) in time order. Raises SequenceError on damage.

    Limited to `start_ns <= stamp_ns < end_ns`: only chunks that hold such messages are read, and their checksums
    checked.
    """
    if start_ns is not None and end_ns is not None and start_ns >= end_ns:
        return
    wanted = None if names is None else set(names)
    with Reading(path) as (file, summary):
        for _, channel, message in iter_messages(file, summary, wanted, start_ns, end_ns):
            yield Message(channel.topic, message.log_time, message.data)
