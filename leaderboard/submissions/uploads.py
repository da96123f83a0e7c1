"""Receiving uploads: bytes are counted while they are streamed into files without a name, or with a name of our own.
What the sender claims is never relied upon: length, type and names are checked, not used."""

from __future__ import annotations

import asyncio
import codecs
import os
import secrets
import shutil
import time
from collections.abc import AsyncGenerator, AsyncIterator, Iterator
from contextlib import contextmanager
from encodings import normalize_encoding
from encodings.aliases import aliases
from pathlib import Path
from typing import IO

from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from oysterbench_leaderboard.submissions.estimates import Upload, upload_of
from oysterbench_leaderboard.submissions.reading.archive import is_zip, pack
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import SubmissionSettings

KINDS = {
    "application/zip": "zip",
    "application/x-zip-compressed": "zip",
    "application/json": "json",
    "text/plain": "text",
    "text/csv": "text",
    "application/octet-stream": "",
}
"""Content type of a body that is one file -> kind that its first bytes must have; empty for any."""

FORM = "form"

FIRST = 64
"""Number of leading bytes by which the kind of a file is recognised."""

OVERHEAD = 1_000_000
"""Maximum size of a form besides its files, bytes."""

MOST_FILES, MOST_FIELDS = 100, 20
"""Maximum number of files and fields in a form. Each file above a megabyte is an open file of the server; more files
must be sent in an archive."""

MOST_FIELD = 4000
"""Maximum size of a form field, bytes."""


def too_large(settings: SubmissionSettings) -> Refusal:
    """Refusal of an upload that is larger than allowed."""
    return Refusal("size", f"expected at most {settings.upload_bytes // 1_000_000} MB, got more; nothing was kept")


async def paced(stream: AsyncIterator[bytes], settings: SubmissionSettings, most: int) -> AsyncGenerator[bytes, None]:
    """Yield the chunks of a body. Raises Refusal where there are more than `most` bytes, or they arrive too slowly."""
    size, begun = 0, time.monotonic()
    while True:
        # Counts what has arrived, not the length announced: announcing a large body buys no time.
        due_s = min(settings.upload_s, settings.upload_grace_s + size / settings.upload_bytes_per_s)
        left_s = begun + due_s - time.monotonic()
        if left_s <= 0:
            raise _too_slow(settings, size, time.monotonic() - begun, left_s)
        try:
            # Not wait_for, which in Python 3.11 loses a deadline that `places` may set meanwhile.
            async with asyncio.timeout(min(settings.idle_s, left_s)):
                chunk = await anext(stream)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise _too_slow(settings, size, time.monotonic() - begun, left_s) from None
        size += len(chunk)
        if size > most:
            raise too_large(settings)
        yield chunk


def _too_slow(settings: SubmissionSettings, size: int, took_s: float, left_s: float) -> Refusal:
    """Refusal of a slow body: `size` bytes arrived in `took_s` seconds, with `left_s` left for the next chunk."""
    if settings.idle_s < left_s:
        return Refusal("slow", f"no data arrived for {settings.idle_s:g} s; send it again")
    if took_s >= settings.upload_s:
        return Refusal("slow", f"the upload took longer than {settings.upload_s:g} s; send less, or by a faster line")
    return Refusal(
        "slow",
        f"expected {settings.upload_bytes_per_s / 1000:g} kB/s after the first {settings.upload_grace_s:g} s, got "
        f"{size} bytes in {took_s:.0f} s; send it again, by a faster line",
    )


def check_headers(request: Request, settings: SubmissionSettings) -> None:
    """Refuse at once a body whose headers announce too large a size, or a content encoding; a body that claims to be
    smaller is counted nevertheless. Raises Refusal."""
    length = request.headers.get("content-length", "")
    if length.isascii() and length.isdigit() and int(length[:20]) > settings.upload_bytes + OVERHEAD:
        raise too_large(settings)
    if request.headers.get("content-encoding", "identity") != "identity":
        raise Refusal("type", "expected the plain bytes, got a content encoding")


def announced_kind(request: Request) -> str:
    """Kind of file that a body is by its content type: FORM, or one of KINDS; empty for any. Raises Refusal where it is
    none that is received."""
    content_type = request.headers.get("content-type", "")
    name = content_type.partition(";")[0].strip().lower()
    if name.startswith("multipart/"):
        kind, options = parse_options_header(content_type)
        if kind != b"multipart/form-data" or not 0 < len(options.get(b"boundary", b"")) <= 200:
            raise Refusal("type", f"expected multipart/form-data with a boundary, got {content_type!r:.80}")
        # Names any codec of Python to the parser, also those that fail or make text that no page can show.
        if _codec(options.get(b"charset", b"utf-8")) not in ("utf_8", "ascii"):
            raise Refusal("type", f"expected a form in UTF-8, got {content_type!r:.80}")
        return FORM
    if name not in KINDS:
        raise Refusal(
            "type",
            f"expected multipart/form-data or one of {', '.join(KINDS)}, got the content type {content_type!r:.80}",
        )
    return KINDS[name]


def _codec(name: bytes) -> str:
    """Python's name of a codec, by any of its names; another name as it is. Not by `codecs.lookup`, which keeps each
    name that it is asked for, and clients may send any number of them."""
    plain = normalize_encoding(name.decode("latin-1")).lower()
    return aliases.get(plain, plain)


async def receive_file(request: Request, file: IO[bytes], settings: SubmissionSettings) -> None:
    """Receive a body that is one file. Raises Refusal where it does not match its content type, is too large, or
    arrives too slowly."""
    content_type, kind, first = request.headers.get("content-type", ""), announced_kind(request), b""
    async for chunk in paced(request.stream(), settings, settings.upload_bytes):
        first += chunk[: FIRST - len(first)]
        file.write(chunk)
    if kind and kind != kind_of(first):
        raise Refusal(
            "type",
            f"the content type says {content_type!r:.60}, but the body is {kind_of(first)}; send a zip archive, JSON "
            "or text in UTF-8, with the type that it is",
        )


def kind_of(first: bytes) -> str:
    r"""Kind of a file, recognised by its first bytes.

    >>> kind_of(b"PK\x03\x04"), kind_of(b' {"a": 1'), kind_of(b"1.0 2.0")
    ('zip', 'json', 'text')
    >>> kind_of(b""), kind_of(b"\x1f\x8b\x08"), kind_of(b"\xff\xfe{\0"), kind_of(b"\0\1\2")
    ('empty', 'gzip', 'UTF-16', 'of no known form')
    """
    if not first:
        return "empty"
    if is_zip(first):
        return "zip"
    if first.startswith(b"\x1f\x8b"):
        return "gzip"
    if first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "UTF-16"
    try:
        text, _ = codecs.utf_8_decode(first, "strict", False)  # not final: the last character may be cut off
    except UnicodeDecodeError:
        return "of no known form"
    if any(c < " " and not c.isspace() for c in text):
        return "of no known form"
    return "json" if text.lstrip()[:1] in ("{", "[") else "text"


class _Parser(MultiPartParser):
    """Parser that notes whether the form was complete (`ended`), and reads no text in another encoding than the form's:
    its parent reads bytes that are none as Latin-1."""

    ended = False

    def on_headers_finished(self) -> None:
        self._check_text(self._current_part.content_disposition or b"")
        super().on_headers_finished()

    def on_part_end(self) -> None:
        if self._current_part.file is None:
            self._check_text(self._current_part.data)
        super().on_part_end()

    def _check_text(self, data: bytes | bytearray) -> None:
        try:
            data.decode(self._charset)
        except UnicodeDecodeError:
            raise MultiPartException(f"expected text in {self._charset.upper()}, got other bytes") from None

    def on_end(self) -> None:
        self.ended = True

    def close(self) -> None:
        """Close all files, also that of a part that has no end."""
        for file in self._files_to_close_on_error:
            file.close()


async def receive_form(request: Request, settings: SubmissionSettings) -> FormData:
    """Receive the fields and files of a form, as `announced_kind` recognises it. Raises Refusal."""
    parser = _Parser(
        request.headers,
        paced(request.stream(), settings, settings.upload_bytes + OVERHEAD),
        max_files=MOST_FILES,
        max_fields=MOST_FIELDS,
        max_part_size=MOST_FIELD,
    )
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise Refusal("request", f"the form cannot be read: {error.message[:100]}") from None
    sizes = [part.size or 0 for _, part in form.multi_items() if isinstance(part, UploadFile)]
    if parser.ended and sum(sizes) <= settings.upload_bytes:
        return form
    parser.close()
    if parser.ended:
        raise too_large(settings)
    raise Refusal("request", "the form is incomplete; send it again")


def texts_of(form: FormData) -> dict[str, str]:
    """Text fields of a form; of several with the same name, the first."""
    return {key: value for key, value in reversed(form.multi_items()) if isinstance(value, str)}


def one_file(form: FormData, whole: IO[bytes]) -> IO[bytes]:
    """Return the files of a form as one file; several are packed into an archive, `whole`, under the names given by the
    sender, which are checked like those of any archive. Raises Refusal."""
    parts = [part for _, part in form.multi_items() if isinstance(part, UploadFile)]
    files = [(part.filename or "", part.file) for part in parts if part.filename or part.size]  # inputs may be empty
    if not files:
        raise Refusal("request", "expected a file, got none")
    if len(files) == 1:
        return files[0][1]
    if any(is_zip(_first(file)) and not name.endswith(".npz") for name, file in files):
        raise Refusal("archive", "expected one archive, or files, got an archive among several files")
    if len(dict(files)) < len(files):
        raise Refusal("name", "two files have one name; expected SEQUENCE.tum, or as the split names them")
    pack(dict(files), whole)
    return whole


def _first(file: IO[bytes]) -> bytes:
    first = file.read(64)
    file.seek(0)
    return first


@contextmanager
def kept(source: IO[bytes], folder: Path) -> Iterator[Upload]:
    """Copy these bytes into a file in the private folder, which is deleted at the end unless it was moved away."""
    path = folder / secrets.token_hex(16)
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            source.seek(0)
            shutil.copyfileobj(source, file, 1 << 20)
        yield upload_of(path)
    finally:
        path.unlink(missing_ok=True)
