"""Zip archives read in place: nothing is ever extracted to disk, and nothing in an archive is trusted."""

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
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

ZIP_MAGIC = (b"PK\x03\x04", b"PK\x05\x06")
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compression methods that are accepted: others reach far higher ratios."""

BROKEN = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, NotImplementedError, RuntimeError)
"""Exceptions that `zipfile` raises for a file that is not a valid archive."""

ENCRYPTED = 0x1
EPOCH = (1980, 1, 1, 0, 0, 0)
"""Modification time of every file in archives that are written here."""

NAMED = "expected names as `SEQUENCE.tum`"
OF_THE_SYSTEM = (".DS_Store", "Thumbs.db", "desktop.ini")
SHOWN = 80
"""Maximum number of characters of a name in a message."""


@dataclass(frozen=True)
class Limits:
    """Limits on what is read (see `SubmissionSettings`)."""

    file_bytes: int
    results_bytes: int
    entries: int
    unpacked_bytes: int
    ratio: float
    lines: int = 120_000
    annotations: int = 5000


class Budget:
    """Count of what has been unpacked of one submission, over all archives in it, against its limits."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.entries = 0
        self.bytes = 0

    def take(self, entries: int, size: int) -> None:
        """Count these entries and bytes. Raises Refusal where the total exceeds a limit."""
        self.entries += entries
        self.bytes += size
        if self.entries > self.limits.entries:
            raise Refusal("archive", f"expected at most {self.limits.entries} files in an archive, got more")
        if self.bytes > self.limits.unpacked_bytes:
            most = self.limits.unpacked_bytes // 1_000_000
            raise Refusal("archive", f"expected at most {most} MB in all when unpacked, got more")


def shown(name: str) -> str:
    """Form in which an untrusted name appears in a message: ASCII-escaped and truncated."""
    return ascii(name[:SHOWN])


def _is_of_the_system(name: str) -> bool:
    """Whether an entry is one that a desktop system adds to archives by itself. Such entries are never read."""
    return name.startswith("__MACOSX/") or name.rpartition("/")[2] in OF_THE_SYSTEM


class Archive:
    """A zip archive. All its entries are checked before the first is read.

    arrays: whether it is an .npz, whose members may have any compression ratio
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
        # `filename` has been cleaned up by the library; `orig_filename` is what the sender wrote.
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
        """Return the bytes of an entry, `file_bytes` + 1 of them at most."""
        entry = self.entries[name]
        try:
            with self._zip.open(entry) as file:
                return file.read(self.limits.file_bytes + 1)[: self.limits.file_bytes + 1]
        except BROKEN as error:
            raise Refusal(
                "archive", f"{self.label}: {shown(name)} cannot be unpacked: {in_one_line(error, 100)}"
            ) from None


def pack(files: Mapping[str, Path | IO[bytes]], target: IO[bytes]) -> None:
    """Write a zip archive of files, given by their names in it. The same files always give the same bytes."""
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
    """Whether a file that starts with these bytes is a zip archive."""
    return data.startswith(ZIP_MAGIC)


def arrays_of(data: bytes, label: str, budget: Budget) -> Archive:
    """Open an .npz as an archive. Raises Refusal where it holds anything but .npy files."""
    archive = Archive(io.BytesIO(data), label, budget, arrays=True)
    for name in archive.entries:
        if not name.endswith(".npy"):
            raise Refusal("archive", f"{label}: {shown(name)}: expected only arrays (.npy) in an .npz, no archive")
    return archive


@contextmanager
def in_memory(data: bytes, label: str) -> Iterator[Path]:
    """Path to these bytes, for readers that require a path; the bytes stay in memory."""
    descriptor = os.memfd_create(label[:64].encode("ascii", "replace").decode())
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(descriptor, view) :]
        yield Path(f"/proc/self/fd/{descriptor}")
    finally:
        os.close(descriptor)
