"""Receiving what is sent: bytes are counted while they stream, into a file of the private folder that has a name of
ours. Nothing that the sender says of it decides anything: its length, its kind and its names are looked at, not used.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from oysterbench_leaderboard.submissions.archive import is_zip, pack
from oysterbench_leaderboard.submissions.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Upload, upload_of
from oysterbench_leaderboard.submissions.settings import Settings

KINDS = {
    "application/zip": "zip",
    "application/x-zip-compressed": "zip",
    "application/json": "json",
    "text/plain": "text",
    "text/csv": "text",
    "application/octet-stream": "",
}
"""Content type of a body that is one file -> what its first bytes must then be."""

OVERHEAD = 1_000_000
"""Bytes of a form beside its files."""

MOST_PARTS = 1000
MOST_FIELD = 4000
"""Bytes of a field of a form, and of a part's headers."""


class Draft:
    """A file that is being received, gone when it is not kept."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / secrets.token_hex(16)
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        self.file: IO[bytes] = os.fdopen(descriptor, "wb")
        self.hash = hashlib.sha256()
        self.size = 0
        self.first = b""

    def write(self, data: bytes) -> None:
        """Append."""
        self.first = self.first or bytes(data[:64])
        self.file.write(data)
        self.hash.update(data)
        self.size += len(data)

    def done(self) -> Upload:
        """All is there."""
        self.file.close()
        return Upload(self.path, self.hash.hexdigest(), self.size)

    def drop(self) -> None:
        """It is not needed."""
        self.file.close()
        self.path.unlink(missing_ok=True)


@dataclass
class Received:
    """Fields of a form, and its files under the names that the sender gave them."""

    fields: dict[str, str] = field(default_factory=dict)
    files: list[tuple[str, Draft]] = field(default_factory=list)


@contextmanager
def cleared(received: Received) -> Iterator[None]:
    """Leave no draft behind."""
    try:
        yield
    finally:
        for _, draft in received.files:
            draft.drop()


async def paced(stream: AsyncIterator[bytes], settings: Settings) -> AsyncIterator[bytes]:
    """The chunks of a body. Raises Refusal where there are too many bytes, or they come too slowly."""
    size, begun = 0, time.monotonic()
    most = settings.upload_bytes + OVERHEAD
    while True:
        try:
            chunk = await asyncio.wait_for(anext(stream), settings.idle_s)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise Refusal("request", f"nothing came for {settings.idle_s:g} s; send it again") from None
        size += len(chunk)
        if size > most:
            raise too_large(settings)
        if time.monotonic() - begun > settings.upload_s:
            raise Refusal("request", f"the upload took longer than {settings.upload_s:g} s")
        yield chunk


def too_large(settings: Settings) -> Refusal:
    """For what is longer than is allowed."""
    return Refusal("size", f"expected at most {settings.upload_bytes // 1_000_000} MB, got more; nothing was kept")


def check_length(header: str | None, settings: Settings) -> None:
    """Refuse at once what says itself that it is too long; what says otherwise is counted all the same."""
    if header is not None and header.isdigit() and int(header[:20]) > settings.upload_bytes + OVERHEAD:
        raise too_large(settings)


async def receive_file(
    stream: AsyncIterator[bytes], content_type: str, received: Received, folder: Path, settings: Settings
) -> None:
    """A body that is one file. Raises Refusal where it is not what its type says."""
    kind = KINDS.get(content_type.partition(";")[0].strip().lower())
    if kind is None:
        raise Refusal(
            "type",
            f"expected multipart/form-data or one of {', '.join(KINDS)}, got the content type {content_type!r:.80}",
        )
    draft = Draft(folder)
    received.files.append(("", draft))
    async for chunk in paced(stream, settings):
        if draft.size + len(chunk) > settings.upload_bytes:
            raise too_large(settings)
        draft.write(chunk)
    if kind and kind != kind_of(draft.first):
        raise Refusal(
            "type",
            f"the content type says {content_type!r:.60}, and the bytes are {kind_of(draft.first)}; send as they are",
        )


def kind_of(first: bytes) -> str:
    """What a file is by its first bytes."""
    if is_zip(first):
        return "zip"
    return "json" if first.lstrip()[:1] in (b"{", b"[") else "text"


async def receive_form(
    stream: AsyncIterator[bytes],
    content_type: str,
    received: Received,
    folder: Path,
    settings: Settings,
    before_files: Callable[[dict[str, str]], None] = lambda fields: None,
) -> None:
    """The fields and files of a form (multipart/form-data). before_files: called with the fields before the first file
    is taken in; fields after a file are not looked at. Raises Refusal."""
    kind, options = parse_options_header(content_type)
    boundary = options.get(b"boundary", b"")
    if kind != b"multipart/form-data" or not 0 < len(boundary) <= 200:
        raise Refusal("type", f"expected multipart/form-data with a boundary, got {content_type!r:.80}")
    parts = _Parts(received, folder, settings, before_files)
    parser = MultipartParser(boundary, parts.callbacks)  # type: ignore[arg-type]
    try:
        async for chunk in paced(stream, settings):
            parser.write(chunk)
        parser.finalize()
    except FormParserError as error:
        raise Refusal("request", f"the form cannot be read: {' '.join(str(error).split())[:100]}") from None
    if not parts.ended:
        raise Refusal("request", "the form breaks off before its end; send it again")


class _Parts:
    """What the parser of a form calls."""

    def __init__(
        self, received: Received, folder: Path, settings: Settings, before_files: Callable[[dict[str, str]], None]
    ) -> None:
        self.received, self.folder, self.settings, self.before_files = received, folder, settings, before_files
        self.ended = False
        self._count = 0
        self._size = 0
        self._headers: dict[bytes, bytes] = {}
        self._name, self._value = b"", b""
        self._field = ""
        self._data = b""
        self._draft: Draft | None = None

    @property
    def callbacks(self) -> dict[str, Any]:
        """By the parser's names."""
        names = (
            *("part_begin", "part_data", "part_end"),
            *("header_field", "header_value", "header_end", "headers_finished", "end"),
        )
        return {f"on_{name}": getattr(self, name) for name in names}

    def part_begin(self) -> None:
        self._count += 1
        if self._count > MOST_PARTS:
            raise Refusal("request", f"expected at most {MOST_PARTS} parts of a form, got more")
        self._headers, self._name, self._value, self._field, self._data = {}, b"", b"", "", b""
        self._draft = None

    def header_field(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]
        self._check_field(self._name)

    def header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]
        self._check_field(self._value)

    def header_end(self) -> None:
        if len(self._headers) > 10:
            raise Refusal("request", "a part of the form has too many headers")
        self._headers[self._name.lower()] = self._value
        self._name, self._value = b"", b""

    def headers_finished(self) -> None:
        _, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        self._field = options.get(b"name", b"").decode(errors="replace")
        if b"filename" not in options:
            return
        name = options[b"filename"].decode(errors="replace")
        if not self.received.files:
            self.before_files(self.received.fields)
        self._draft = Draft(self.folder)
        self.received.files.append((name, self._draft))

    def part_data(self, data: bytes, start: int, end: int) -> None:
        if self._draft is None:
            self._data += data[start:end]
            self._check_field(self._data)
            return
        self._size += end - start
        if self._size > self.settings.upload_bytes:
            raise too_large(self.settings)
        self._draft.write(data[start:end])

    def part_end(self) -> None:
        if self._draft is None:
            self.received.fields.setdefault(self._field, self._data.decode(errors="replace"))
        elif not self._draft.size and not self.received.files[-1][0]:  # a form's empty choice of a file
            self.received.files.pop()[1].drop()

    def end(self) -> None:
        self.ended = True

    def _check_field(self, data: bytes) -> None:
        if len(data) > MOST_FIELD:
            raise Refusal("request", f"a field of the form has more than {MOST_FIELD} bytes")


def one_upload(received: Received, folder: Path) -> Upload:
    """What was received, as one file; several are put into an archive, under the names that they came with, which are
    looked at like those of any archive."""
    if not received.files:
        raise Refusal("request", "expected a file, got none")
    if len(received.files) == 1:
        return received.files[0][1].done()
    drafts = list(received.files)
    for _, draft in drafts:
        draft.file.close()
    names = [name for name, _ in drafts]
    if any(is_zip(draft.first) and not name.endswith(".npz") for name, draft in drafts):
        raise Refusal("archive", "expected one archive, or files, got an archive among several files")
    if len(set(names)) < len(names):
        raise Refusal("name", "two files have one name; expected SEQUENCE.tum, or as the split names them")
    whole = Draft(folder)
    received.files.append(("", whole))
    pack({name: draft.path for name, draft in drafts}, whole.file)
    whole.file.close()
    return upload_of(whole.path)
