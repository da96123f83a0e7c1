"""Sources of a tree: a web server or a folder. A source gives bytes and errors; it is never trusted."""

from __future__ import annotations

import contextlib
import email.utils
import os
import re
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

from oysterbench.core.errors import HubError, NetworkError
from oysterbench.version import VERSION

if TYPE_CHECKING:
    from urllib3 import BaseHTTPResponse

READ = 1 << 20
"""Bytes read at a time."""

RETRIED = (408, 425, 429, 500, 502, 503, 504)
"""Status codes after which the same request may succeed."""

HOST = re.compile(r"(?:localhost|[\w-]+(?:\.[\w-]+)+|[\w.-]+(?=:)|\[[0-9a-fA-F:]+\])(?::[0-9]{1,5})?(?:/.*)?")
"""Text that looks like an address without http://: a host with a dot or a port, perhaps a path."""


class Setback(Exception):
    """A request that failed and may be retried; `wait_s`: the delay that the server asks for, s."""

    def __init__(self, message: str, wait_s: float = 0.0) -> None:
        super().__init__(message)
        self.wait_s = wait_s


class Silence(Setback):
    """A server to which no connection could be made, or none to the proxy that leads to it."""


class Refusal(Exception):
    """A request that this source will not fulfil, however often it is retried."""


class Absence(Refusal):
    """A file that this source does not have."""


@dataclass(frozen=True)
class Patience:
    """How long and how often a client tries. Times in seconds."""

    attempts: int = 6  # in a row that yield nothing
    first_contact: int = 3  # attempts to read index and manifest: an absent hub is reported soon
    first_wait_s: float = 0.5  # doubled from attempt to attempt
    longest_wait_s: float = 60.0  # a server that asks for more is given up on
    connect_s: float = 10.0
    idle_s: float = 30.0  # without a byte
    window_s: float = 60.0  # of waiting, in which the headers must arrive, and after that `least_bytes` in each
    least_bytes: int = 1 << 14
    wait: Callable[[threading.Event, float], object] = threading.Event.wait  # this long, or until the transfer stops


class Body(Protocol):
    """Response of a source: bytes from `start` on; the file may be longer or shorter than requested."""

    start: int

    def read(self) -> bytes:
        """The next bytes, at least one; none at the end. Raises Setback."""
        ...


class Source(Protocol):
    """A tree that can be read."""

    name: str
    parallel: bool  # whether several connections are worthwhile

    def open(self, path: str, start: int = 0, end: int | None = None) -> contextlib.AbstractContextManager[Body]:
        """Open the bytes [start, end) of a file of the tree, or all of it where the source cannot do better.

        Raises Setback or Refusal.
        """
        ...


@dataclass
class FileBody:
    """Bytes of an open file, up to `left`."""

    file: IO[bytes]
    start: int
    left: int | None

    def read(self) -> bytes:
        data = self.file.read(READ if self.left is None else min(READ, self.left))
        if self.left is not None:
            self.left -= len(data)
        return data


class Folder:
    """A tree in a folder, on a disk or a network share."""

    parallel = False

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.name = str(folder)

    @contextlib.contextmanager
    def open(self, path: str, start: int = 0, end: int | None = None) -> Iterator[FileBody]:
        try:
            with open(self.folder / path, "rb") as file:
                file.seek(start)
                yield FileBody(file, start, None if end is None else end - start)
        except FileNotFoundError:
            raise Absence(f"{self.folder / path} is not there") from None
        except OSError as error:
            raise Setback(f"{self.folder / path}: {error.strerror or error}") from None


@dataclass
class HttpBody:
    """The body of a response."""

    response: BaseHTTPResponse
    start: int

    def read(self) -> bytes:
        import urllib3

        try:
            return self.response.read1(READ, decode_content=False) or b""
        except (urllib3.exceptions.HTTPError, OSError, ValueError) as error:
            raise Setback(f"the connection broke: {_cause(error)}") from None


class Web:
    """A tree on a web server, which may or may not support ranges."""

    parallel = True

    def __init__(self, url: str, connections: int, patience: Patience) -> None:
        self.url = url.rstrip("/")
        parts = urllib.parse.urlsplit(self.url)
        self.name = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()  # no password in a message
        from oysterbench.hub.pool import open_pool  # urllib3 is loaded only when needed

        self._pool = open_pool(self.url, connections, patience)

    @contextlib.contextmanager
    def open(self, path: str, start: int = 0, end: int | None = None) -> Iterator[HttpBody]:
        import urllib3

        headers = {"User-Agent": f"oysterbench/{VERSION}", "Accept-Encoding": "identity"}
        if end is not None:
            headers["Range"] = f"bytes={start}-{end - 1}"
        try:
            response = self._pool.request("GET", f"{self.url}/{path}", headers=headers, preload_content=False)
        except (urllib3.exceptions.HTTPError, OSError, ValueError) as error:
            reason = getattr(error, "reason", None)
            cause = getattr(reason, "original_error", reason)  # what is wrong with a proxy, where there is one
            silent = isinstance(cause, urllib3.exceptions.ConnectTimeoutError)
            proxy = self._pool.proxy if isinstance(reason, urllib3.exceptions.ProxyError) else None
            behind = f" through the proxy {proxy.netloc}" if proxy else ""
            raise (Silence if silent else Setback)(f"no answer{behind}: {_cause(error)}") from None
        try:
            begins = _check(response, start, end)
            yield HttpBody(response, begins)
        finally:
            # A connection whose response was read to its end is reused; a remainder is not read.
            if response.length_remaining == 0:
                response.release_conn()
            else:
                response.close()


def _check(response: BaseHTTPResponse, start: int, end: int | None) -> int:
    """Offset in the file at which the body starts. Raises Setback or Refusal where it is not what was requested."""
    status = response.status
    if status in RETRIED:
        raise Setback(f"status {status}", retry_after_s(response.headers.get("Retry-After")))
    if status not in (200, 206):
        why = "the file there is shorter than it should be" if status == 416 else (response.reason or "refused")
        kind = Setback if status == 416 else Absence if status == 404 else Refusal
        raise kind(f"status {status} ({why})")
    if response.headers.get("Content-Encoding", "identity") != "identity":
        raise Refusal(f"the answer is compressed ({response.headers['Content-Encoding']!r:.80}), though it must not be")
    if status == 200:
        return 0
    got = response.headers.get("Content-Range", "")
    match = re.fullmatch(r"bytes ([0-9]{1,19})-([0-9]{1,19})/([0-9]+|\*)", got)
    if end is None or match is None or int(match[1]) != start or not start <= int(match[2]) < end:
        raise Setback(
            f"asked for bytes {start} to {-1 if end is None else end - 1}, answered with {got[:80] or 'no range'!r}"
        )
    return start


def retry_after_s(value: str | None) -> float:
    """Delay of a Retry-After header, s, which is a number of seconds or a date; 0 where it is neither."""
    text = (value or "").strip()
    if text.isascii() and text.isdigit():
        return float(text[:9])
    try:
        return max(0.0, email.utils.parsedate_to_datetime(text).timestamp() - time.time())
    except (TypeError, ValueError, OverflowError, LookupError):
        return 0.0


def _cause(error: BaseException) -> str:
    """Innermost reason of an error, in words."""
    import urllib3

    system = error.__cause__
    if isinstance(error, urllib3.exceptions.NewConnectionError) and isinstance(system, OSError) and system.strerror:
        return system.strerror  # without the name of a class and all its values
    if isinstance(error, urllib3.exceptions.SSLError) and "WRONG_VERSION_NUMBER" in str(error):
        return "the server does not speak TLS: is its address http://, and not https://?"
    reasons = (getattr(error, "reason", None), *error.args)
    reason = next((one for one in reasons if isinstance(one, BaseException)), None)
    return str(error) or type(error).__name__ if reason is None else _cause(reason)


def open_source(place: str, connections: int = 4, patience: Patience = Patience()) -> Source:
    """Open a source from what a user gives: an http(s) address, a file:// address or the path of a folder.

    Raises HubError for anything else, and NetworkError for an address while OYSTERBENCH_OFFLINE is set.
    """
    scheme, separator, _ = place.partition("://")
    if separator and scheme.lower() in ("http", "https"):
        if is_offline():
            raise NetworkError(f"{place}: OYSTERBENCH_OFFLINE is set, so no server is asked; unset it or use a folder")
        if not has_host(place):
            raise HubError(f"{place}: expected the address of a hub, such as http://HOST:8000 or http://[::1]:8000")
        return Web(place, connections, patience)
    if separator and scheme.lower() == "file":
        folder = Path(urllib.request.url2pathname(urllib.parse.urlsplit(place).path))
    elif separator:
        raise HubError(f"{place}: expected http://, https://, file:// or a folder, got {scheme}://")
    else:
        folder = Path(place).expanduser()
    if not folder.is_dir():
        meant = f"did you mean http://{place}? " if HOST.fullmatch(place) else ""
        raise HubError(
            f"{place}: no such folder; {meant}expected the address of a hub or a folder with a published tree"
        )
    if not any((folder / name).exists() for name in ("index.json", "blobs")):
        raise HubError(
            f"{place}: this folder holds no published tree: expected index.json and blobs/ in it, as `oysterbench "
            "publish` writes them"
        )
    return Folder(folder)


def has_host(url: str) -> bool:
    """Whether an address has a host and, if any, a port that is a number."""
    try:
        parts = urllib.parse.urlsplit(url)
        return bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        return False


def is_offline() -> bool:
    """Whether OYSTERBENCH_OFFLINE forbids the network."""
    return os.environ.get("OYSTERBENCH_OFFLINE", "").lower() not in ("", "0", "false", "no")
