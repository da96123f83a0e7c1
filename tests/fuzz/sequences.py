"""Sequence files with other records, their checksums and lengths made right again, read as commands read them.

    python -m tests.fuzz.sequences --count 5000 --seed 1 --log sequences.jsonl

A case is a dive with every kind of sensor, of whose records some are changed. `oysterbench info`, `eval` and `view`,
and a reader of everything, say what is wrong in a line, or go through; and a path scores after them as before.
"""

from __future__ import annotations

import json
import math
import struct
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import zstandard
from click.testing import CliRunner

from oysterbench.cli.main import main as command
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.mcap import RECORD
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import write_tum
from oysterbench.sequence import open_sequence
from oysterbench.sequence.file import CHECKSUM, checksum
from oysterbench.sequence.truth import TRUTH
from tests.fuzz.mutations import NUMBERS, WORDS, Rng, document, one, raw, text
from tests.fuzz.records import File, read_file
from tests.fuzz.watch import Wrong, tool
from tests.helpers import hand_made_dive as dive
from tests.sequence.test_reader import read_everything

FLOATS = [struct.pack(form, value) for form in ("<d", "<f") for value in (math.nan, math.inf, -math.inf, 1e30, 1e-30)]
FLOATS += [struct.pack("<d", value) for value in (1e300, -1e300, 1e-320)]
SECONDS = 0.2
"""Of the dive."""


# What is changed, one function a kind; each returns the bytes of the file:


def payload(rng: Rng, file: File) -> bytes:
    """What a few messages say, of one topic or all over."""
    section = one(rng, file.sections)
    for _ in range(int(one(rng, (1, 3, len(section.messages))))):
        message = one(rng, section.messages)
        data = bytearray(message.data)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(data))) if rng.random() < 0.5 else int(rng.integers(min(len(data), 90)))
            number = struct.pack("<Q", one(rng, NUMBERS))[: one(rng, (1, 2, 4, 8))]
            new = one(rng, FLOATS) if rng.random() < 0.4 else number
            at -= at % 4 if rng.random() < 0.7 else 0
            data[at : at + len(new)] = new
        message.data = bytes(data) if rng.random() < 0.9 else raw(rng, message.data)
    return file.bytes(rng)


def message(rng: Rng, file: File) -> bytes:
    """Of which channel it is, when, and how many there are."""
    section = one(rng, file.sections)
    for _ in range(int(one(rng, (1, 3)))):
        changed = one(rng, section.messages)
        kind = rng.integers(4)
        if kind == 0:
            changed.channel_id = int(one(rng, (0, 1, 7, 65535, one(rng, file.channels).id)))
        elif kind == 1:
            changed.log_time = one(rng, NUMBERS)
        elif kind == 2:
            changed.publish_time, changed.sequence = one(rng, NUMBERS), one(rng, NUMBERS) & 0xFFFFFFFF
        else:
            section.messages += [changed] * int(one(rng, (1, 40)))
    if rng.random() < 0.2:
        section.messages.reverse()
    return file.bytes(rng)


def chunk(rng: Rng, file: File) -> bytes:
    """How it is packed, and what it says of that."""
    section = one(rng, file.sections)
    kind = rng.integers(6)
    section.compression = one(rng, ("", "zstd", "lz4", "bz2", "none", "x" * 300))
    if kind == 0:
        section.said["uncompressed_size"] = one(rng, NUMBERS)
    elif kind == 1:
        section.said |= {key: one(rng, NUMBERS) for key in ("message_start_time", "message_end_time")}
    elif kind == 2:
        section.more = RECORD.pack(int(rng.integers(256)), int(one(rng, NUMBERS))) + rng.bytes(40)
    elif kind == 3:
        bomb = b"\0" * int(one(rng, (1 << 20, 1 << 27)))
        packing = one(rng, (zstandard.compress, lz4.frame.compress))
        said = {"data": packing(bomb), "compression": "zstd" if packing is zstandard.compress else "lz4"}
        section.said = {**said, "uncompressed_crc": 0, "uncompressed_size": int(one(rng, (3000, len(bomb))))}
    elif kind == 4:
        section.said |= {"data": raw(rng, section.record().data), "uncompressed_crc": 0}
    else:
        file.sections += [section] * int(one(rng, (1, 20)))
    return file.bytes(rng)


def channel(rng: Rng, file: File) -> bytes:
    """Its topic, number, encoding or schema."""
    changed = one(rng, file.channels)
    kind = rng.integers(5)
    if kind == 0:
        changed.topic = one(rng, (one(rng, file.channels).topic, one(rng, WORDS), "/" + "a" * 70_000))
    elif kind == 1:
        changed.id = int(one(rng, (0, 65535, one(rng, file.channels).id)))
    elif kind == 2:
        changed.schema_id = int(one(rng, (0, 65535, one(rng, file.schemas).id)))
    elif kind == 3:
        changed.message_encoding = one(rng, ("ros1", "json", *WORDS))
    else:
        changed.metadata = {one(rng, WORDS): one(rng, WORDS) for _ in range(20)}
    return file.bytes(rng)


def schema(rng: Rng, file: File) -> bytes:
    """Its name, encoding, text or number."""
    changed = one(rng, file.schemas)
    kind = rng.integers(4)
    if kind == 0:
        changed.name = one(rng, (one(rng, file.schemas).name, *WORDS))
    elif kind == 1:
        changed.encoding = one(rng, ("ros1msg", "protobuf", "jsonschema", *WORDS))
    elif kind == 2:
        changed.data = one(rng, (raw(rng, changed.data), b"", b"x" * 1_000_000, b"float64[" + b"9" * 50 + b"] a"))
    else:
        changed.id = int(one(rng, (0, 65535, one(rng, file.schemas).id)))
    return file.bytes(rng)


def attachment(rng: Rng, file: File) -> bytes:
    """What it holds, by its form; its name; whether it is there, or twice."""
    changed = one(rng, file.attachments)
    kind = rng.integers(8)
    if kind < 5:
        by_form = document if changed.name.endswith(".json") else text
        changed.data = by_form(rng, changed.data) if rng.random() < 0.9 else raw(rng, changed.data)
    elif kind == 5:
        changed.name = one(rng, (one(rng, file.attachments).name, *WORDS))
    elif kind == 6:
        file.attachments.append(changed)
    else:
        file.attachments.remove(changed)
    return file.bytes(rng)


def metadata(rng: Rng, file: File) -> bytes:
    """Names and values, with the checksum that goes with them."""
    changed = one(rng, file.metadata)
    values = {key: value for key, value in changed.metadata.items() if key != CHECKSUM}
    for _ in range(int(rng.integers(1, 4))):
        values[one(rng, (*values, one(rng, WORDS)))] = one(rng, (*WORDS, "[" * 100_000, '{"a": ' * 9))
    if rng.random() < 0.2:
        del values[one(rng, list(values))]
    if rng.random() < 0.2:
        changed.name = one(rng, WORDS)
    changed.metadata = {**values, CHECKSUM: checksum(values)}
    return file.bytes(rng)


def statistics(rng: Rng, file: File) -> bytes:
    """Counts and times."""
    found = file.statistics
    key = one(rng, [key for key in vars(found) if key != "channel_message_counts"])
    setattr(found, key, one(rng, NUMBERS) % (1 << (16 if key == "schema_count" else 32 if "_count" in key else 64)))
    for number in rng.choice(list(found.channel_message_counts), 3):
        found.channel_message_counts[int(number)] = one(rng, NUMBERS)
    if rng.random() < 0.2:
        found.channel_message_counts = {k: one(rng, NUMBERS) for k in range(int(one(rng, (0, 3000))))}
    return file.bytes(rng)


def index(rng: Rng, file: File) -> bytes:
    """A number in a record of the index."""
    return file.bytes(rng, "field")


def index_bytes(rng: Rng, file: File) -> bytes:
    """Any bytes of the index."""
    return file.bytes(rng, "bytes")


def anything(rng: Rng, file: File) -> bytes:
    """Any bytes of the file, checksums as they were."""
    return raw(rng, file.bytes(rng))


KINDS = (
    payload,
    payload,
    payload,
    message,
    chunk,
    channel,
    schema,
    attachment,
    attachment,
    metadata,
    statistics,
    index,
    index_bytes,
    anything,
)


class Sequences:
    """Draws cases, and reads them."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.plain = dive.write_dive(folder / "plain.mcap", SECONDS)
        self.estimate, self.forged = folder / "estimate.tum", folder / "forged.mcap"
        write_tum(self.estimate, open_sequence(self.plain).truth())
        self.expected = self.score(self.plain)[0]
        assert not self.read(self.plain)

    def draw(self, number: int) -> tuple[str, Callable[[], tuple[str, str]]]:
        """A case by its number."""
        kind = KINDS[number % len(KINDS)]
        rng = stream(self.seed, b"", "fuzz", "sequences", number)
        self.forged.write_bytes(kind(rng, read_file(self.plain.read_bytes())))
        return kind.__name__, self.run

    def run(self) -> tuple[str, str]:
        """What came of the case. Raises Wrong where a refusal is no line, or the next score another one."""
        said = self.read(self.forged)
        if self.score(self.plain) != (self.expected, []):
            raise Wrong("another score after it")
        return ("refused" if len(said) == 5 else "refused in part" if said else "read"), " | ".join(said)

    def read(self, path: Path) -> list[str]:
        """What is said against a file."""
        said = []
        try:
            read_everything(path)
        except OysterbenchError as error:
            said.append(str(error))
        page = ("view", path, "--out", self.folder / "page.html")
        for arguments in (("info", path), ("info", path, "--json"), page):
            said += self.command(*arguments)[1]
        return said + self.score(path)[1]

    def score(self, truth: Path) -> tuple[Any, list[str]]:
        """The metrics of a path against a truth, or what is said against that."""
        files = ("--truth", truth, "--truth-topic", TRUTH, "--estimate", self.estimate)
        printed, said = self.command("eval", "slam", *files, "--json")
        return None if said else json.loads(printed)["results"][0]["metrics"], said

    def command(self, *arguments: object) -> tuple[str, list[str]]:
        """What a command prints, and the refusal, if it is one. Raises whatever it lets through."""
        done = CliRunner().invoke(command, [str(argument) for argument in arguments])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        if not done.exit_code:
            return done.stdout, []
        *_, last = done.stderr.splitlines() or [""]
        if not last.startswith("oysterbench: ") or not last.isprintable():
            raise Wrong(f"{arguments[0]}: expected a line, got {done.stderr!r}")
        return done.stdout, [last]


def main() -> None:
    """The tool."""
    cv2.setNumThreads(0)
    with tempfile.TemporaryDirectory(prefix="oysterbench-fuzz-") as folder:
        sys.exit(min(tool(__doc__, lambda seed: Sequences(Path(folder), seed).draw), 1))


if __name__ == "__main__":
    main()
