"""Archives, read in place: nothing of one is ever written to disk, and nothing in one is believed."""

from __future__ import annotations

import io
import os
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from oysterbench.core.text import in_one_line
from oysterbench_leaderboard.submissions.refusals import Refusal

ZIP_MAGIC = (b"PK\x03\x04", b"PK\x05\x06")
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Kinds of compression that are read: others reach far higher ratios."""

BROKEN = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, NotImplementedError, RuntimeError)
"""What the library raises where an archive is not one."""

ENCRYPTED = 0x1
EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of files in archives that are made here."""

NAMED = "expected names as `SEQUENCE.tum`"
OF_THE_SYSTEM = (".DS_Store", "Thumbs.db", "desktop.ini")
SHOWN = 80
"""Characters of a name in a message."""


@dataclass(frozen=True)
class Limits:
    """Of what is read (`SubmissionSettings`)."""

    file_bytes: int
    results_bytes: int
    entries: int
    unpacked_bytes: int
    ratio: float
    lines: int = 120_000
    annotations: int = 5000


class Budget:
    """What may still be unpacked of one submission, over all archives in it."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.entries = 0
        self.bytes = 0

    def take(self, entries: int, size: int) -> None:
        """Raises Refusal where that is too much."""
        self.entries += entries
        self.bytes += size
        if self.entries > self.limits.entries:
            raise Refusal("archive", f"expected at most {self.limits.entries} files in an archive, got more")
        if self.bytes > self.limits.unpacked_bytes:
            most = self.limits.unpacked_bytes // 1_000_000
            raise Refusal("archive", f"expected at most {most} MB in all when unpacked, got more")


def shown(name: str) -> str:
    """A name of somebody else's as it stands in a message."""
    return ascii(name[:SHOWN])


def _is_of_the_system(name: str) -> bool:
    """Whether an entry is what a desktop puts into archives beside the files of its user. It is never read."""
    return name.startswith("__MACOSX/") or name.rpartition("/")[2] in OF_THE_SYSTEM


class Archive:
    """A zip archive. All its entries are checked before the first is read.

    arrays: whether it is an .npz, whose members may shrink as much as they like
    """

    def __init__(self, file: IO[bytes] | Path, label: str, budget: Budget, arrays: bool = False) -> None:
        self.label = label
        self.limits = budget.limits
        try:
            self._zip = zipfile.ZipFile(file)
            entries = self._zip.infolist()
        except BROKEN as error:
            raise Refusal("archive", f"{label}: not a complete zip archive: {in_one_line(error, 100)}") from None
        budget.take(len(entries), sum(max(entry.file_size, 0) for entry in entries))
        self.entries: dict[str, zipfile.ZipInfo] = {}
        for entry in entries:
            if _is_of_the_system(entry.orig_filename):
                continue
            self._check(entry, arrays)
            self.entries[entry.orig_filename] = entry

    def _check(self, entry: zipfile.ZipInfo, arrays: bool) -> None:
        # `filename` has been mended by the library; what was written says what was meant.
        name = entry.orig_filename
        kind = stat.S_IFMT(entry.external_attr >> 16)
        size, most, ratio = entry.file_size, self.limits.file_bytes, self.limits.ratio
        wrong = (
            (not PurePosixPath(name).name, f"is not a valid file name; {NAMED}"),
            (name in self.entries, "is there twice; expected each name once"),
            (stat.S_ISLNK(kind), "is a symbolic link; expected only files"),
            (kind and not stat.S_ISREG(kind) and not stat.S_ISDIR(kind), "is not a regular file; expected only files"),
            (name.startswith(("/", "\\")) or name[1:2] == ":", f"is an absolute path; {NAMED}"),
            (".." in name.replace("\\", "/").split("/"), f"leaves its folder by '..'; {NAMED}"),
            (
                "\\" in name or "\0" in name or not name.isprintable(),
                f"has characters that are not allowed in names; {NAMED}",
            ),
            (name.endswith("/"), "is a folder; archive only the files, e.g. `zip -D predictions.zip *.tum`"),
            (
                entry.flag_bits & ENCRYPTED or entry.compress_type not in METHODS,
                "is encrypted or packed in an unusual way; expected deflate or none",
            ),
            (size > most, f"has {size} bytes unpacked; expected at most {most // 1_000_000} MB"),
            (
                not arrays and size > ratio * max(entry.compress_size, 1) + 1000,
                f"unpacks to {size} bytes from {entry.compress_size}; expected at most {ratio:g} times as many",
            ),
        )
        for is_wrong, what in wrong:
            if is_wrong:
                raise Refusal("archive", f"{self.label}: {shown(name)} {what}")

    def read(self, name: str) -> bytes:
        """The bytes of an entry; no more than its size says."""
        entry = self.entries[name]
        try:
            with self._zip.open(entry) as file:
                return file.read(self.limits.file_bytes + 1)[: self.limits.file_bytes + 1]
        except BROKEN as error:
            raise Refusal(
                "archive", f"{self.label}: {shown(name)} cannot be unpacked: {in_one_line(error, 100)}"
            ) from None


def pack(files: Mapping[str, Path | IO[bytes]], target: IO[bytes]) -> None:
    """Write a zip archive of files, by their names in it: the same bytes for the same files, whenever it is made."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o100644 << 16
            file = files[name]
            with (
                open(file, "rb") if isinstance(file, Path) else nullcontext(file) as source,
                archive.open(entry, "w") as place,
            ):
                shutil.copyfileobj(source, place, 1 << 20)


def is_zip(data: bytes) -> bool:
    """Whether a file that begins so is an archive."""
    return data.startswith(ZIP_MAGIC)


def arrays_of(data: bytes, label: str, budget: Budget) -> Archive:
    """The archive of an .npz: nothing but .npy files in it."""
    archive = Archive(io.BytesIO(data), label, budget, arrays=True)
    for name in archive.entries:
        if not name.endswith(".npy"):
            raise Refusal("archive", f"{label}: {shown(name)}: expected only arrays (.npy) in an .npz, no archive")
    return archive


@contextmanager
def in_memory(data: bytes, label: str) -> Iterator[Path]:
    """A path that leads to these bytes, for readers that want one: they stay in memory."""
    descriptor = os.memfd_create(label[:64].encode("ascii", "replace").decode())
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(descriptor, view) :]
        yield Path(f"/proc/self/fd/{descriptor}")
    finally:
        os.close(descriptor)
