"""An MCAP file, opened so that no damaged byte of it passes for a good one."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

from mcap.exceptions import InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.reader import McapReader, make_reader
from mcap.summary import Summary
from zstandard import ZstdError

from oysterbench.core.errors import SequenceError
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
)
"""What the libraries underneath raise on bytes that are not what they should be."""

MAGIC = b"\x89MCAP0\r\n"
FOOTER = struct.Struct("<BQQQI")  # opcode, length of what follows, start of the summary, of its offsets, its CRC
CHECKSUM = "crc32"
RECORD = struct.Struct("<BQ")  # opcode, length of what follows


class Reading:
    """A file opened with the MCAP reader; whatever is wrong with its bytes becomes one SequenceError.

    The reader checks the CRC of each chunk that it reads. That of the summary, which leads to the chunks, is checked
    here; those of attachments in `read_attachment`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> McapReader:
        self._file = open(self.path, "rb")
        try:
            reader = make_reader(self._file, validate_crcs=True)
            check_summary(self._file)
            return reader
        except InvalidMagic:
            self._file.close()
            raise SequenceError(
                f"{self.path}: not an MCAP file; expected a sequence (.mcap) or an EuRoC folder; if it was one, delete "
                "it and render or download it again"
            ) from None
        except DAMAGE as error:
            self._file.close()
            raise SequenceError(damaged(self.path, str(error) or type(error).__name__)) from None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if isinstance(error, DAMAGE) and not isinstance(error, SequenceError):
            raise SequenceError(damaged(self.path, str(error) or type(error).__name__)) from None


def damaged(path: Path, cause: str) -> str:
    """What to say of a damaged file."""
    return (
        f"{path}: truncated or damaged ({cause or 'unreadable'}); expected a whole sequence file; "
        "delete it and render or download it again"
    )


def check_summary(file: IO[bytes]) -> None:
    """Raise ValueError unless the file ends as it should and its summary has the CRC that its footer says."""
    size = file.seek(0, os.SEEK_END)
    tail = FOOTER.size + len(MAGIC)
    if size < tail + len(MAGIC):
        raise EOFError("it ends before its index")
    file.seek(size - tail)
    end = file.read(tail)
    opcode, length, start, _, crc = FOOTER.unpack(end[: FOOTER.size])
    if end[FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or length != FOOTER.size - RECORD.size:
        raise EOFError("it has no end")
    if not len(MAGIC) <= start <= size - tail:
        raise ValueError("its index is outside it")
    file.seek(start)
    # The CRC covers the footer as well, up to the CRC itself.
    # Zero says that there is none: a file of another program.
    if crc and zlib.crc32(file.read(size - tail - start) + end[: FOOTER.size - 4]) != crc:
        raise ValueError("the CRC of its index is wrong")


def checksum(values: Mapping[str, str]) -> str:
    """CRC of the values of a metadata record, which MCAP leaves unprotected."""
    return f"{zlib.crc32(json.dumps(dict(values), sort_keys=True).encode()):08x}"


def read_metadata(reader: McapReader) -> dict[str, dict[str, str]]:
    """Metadata records that `SequenceWriter` wrote, by name. Raises ValueError where a checksum is wrong."""
    found = {}
    for record in reader.iter_metadata():
        if CHECKSUM not in record.metadata:
            continue  # of another program
        values = {key: value for key, value in record.metadata.items() if key != CHECKSUM}
        if record.metadata[CHECKSUM] != checksum(values):
            raise ValueError(f"the CRC of the metadata {record.name!r} is wrong")
        found[record.name] = values
    return found


def read_attachment(file: IO[bytes], offset: int) -> tuple[str, bytes]:
    """Name and data of the attachment at an offset. Raises ValueError where its CRC is wrong."""
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
    """Attachments of a file by name, each read and checked when it is asked for."""

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
    """Attachments by name."""
    with Reading(path) as reader:
        return Attachments(path, summary_of(path, reader))


def summary_of(path: Path, reader: McapReader) -> Summary:
    """The index of a file, with its statistics."""
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise SequenceError(damaged(path, "it has no index"))
    return summary


def read_messages(
    path: Path, names: Iterable[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[Message]:
    """Messages of some topics (all by default) in time order, checksums checked; SequenceError on damage.

    Of `start_ns <= stamp_ns < end_ns`: only chunks that hold such messages are read.
    """
    if start_ns is not None and end_ns is not None and start_ns >= end_ns:
        return
    with Reading(path) as reader:
        for _, channel, message in reader.iter_messages(
            topics=None if names is None else list(names), starting_at=start_ns, ending_before=end_ns
        ):
            yield Message(channel.topic, message.log_time, message.data)
