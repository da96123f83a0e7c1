"""Monitored connections to web servers: one that only trickles, in headers or body, counts as dead as a silent one."""

from __future__ import annotations

import http.client
import io
import socket
import time
import urllib.parse
import urllib.request
from functools import partial
from typing import TYPE_CHECKING, Any

import urllib3
from urllib3.connection import HTTPConnection, HTTPSConnection

from oysterbench.core.errors import HubError

if TYPE_CHECKING:
    from oysterbench.hub.sources import Patience

REDIRECTS = 5
MOST_HEADERS = 1 << 20
"""Size limit of the headers of a response, bytes, with any interim responses (1xx) before it, which may not end."""


class _Watched(io.RawIOBase):
    """Input from a socket. Raises ConnectionError where fewer than `least` bytes arrive in a window of waiting, or
    headers do not end."""

    def __init__(self, file: io.BufferedReader, sock: socket.socket, patience: Patience) -> None:
        self._file = file  # keeps the socket open until it is closed
        self._socket = sock
        self._patience = patience
        self._begin(least=None)

    def _begin(self, least: int | None) -> None:
        self._least, self._got, self._waited_s = least, 0, 0.0

    def body(self) -> None:
        """Switch to the body: the headers, which had to arrive within one window, are there."""
        self._begin(self._patience.least_bytes)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while True:
            begun = time.monotonic()
            wait_s = min(self._patience.idle_s, self._patience.window_s - self._waited_s)
            self._socket.settimeout(wait_s)
            try:
                n = self._socket.recv_into(buffer)
                self._got += n
                if self._least is None and self._got > MOST_HEADERS:
                    raise ConnectionError(f"the headers did not end within {MOST_HEADERS >> 20} MiB")
                return n
            except TimeoutError:
                if wait_s == self._patience.idle_s:
                    raise
            finally:
                self._socket.settimeout(self._patience.idle_s)
                self._waited_s += time.monotonic() - begun
                if self._waited_s >= self._patience.window_s:
                    self._turn()

    def _turn(self) -> None:
        if self._least is None:
            raise ConnectionError(f"the headers did not come within {self._patience.window_s:g} s")
        if self._got < self._least:
            raise ConnectionError(f"only {self._got} bytes in {self._waited_s:.0f} s")
        self._begin(self._least)

    def close(self) -> None:
        self._file.close()
        super().close()


class _Response(http.client.HTTPResponse):
    """A response whose every byte is monitored, including those of a proxy's response to CONNECT."""

    def __init__(self, patience: Patience, sock: socket.socket, *arguments: Any, **options: Any) -> None:
        super().__init__(sock, *arguments, **options)
        self._watched = _Watched(self.fp, sock, patience)
        self.fp = io.BufferedReader(self._watched)

    def begin(self) -> None:
        super().begin()
        self._watched.body()


def open_pool(url: str, connections: int, patience: Patience) -> urllib3.PoolManager:
    """Open a pool of connections to a server, through a proxy where the environment names one."""
    parts = urllib.parse.urlsplit(url)
    # Only redirects are followed here: what to retry, and when, is decided where it is known what is missing.
    retries = urllib3.Retry(
        total=None, connect=0, read=0, status=0, other=0, redirect=REDIRECTS, respect_retry_after_header=False
    )
    timeout = urllib3.Timeout(connect=patience.connect_s, read=patience.idle_s)
    proxy = urllib.request.getproxies().get(parts.scheme)
    if proxy and not urllib.request.proxy_bypass(parts.hostname or ""):
        address = proxy if "://" in proxy else f"http://{proxy}"  # as curl reads it
        try:
            manager: urllib3.PoolManager = urllib3.ProxyManager(
                address, maxsize=connections, retries=retries, timeout=timeout
            )
        except (urllib3.exceptions.HTTPError, ValueError):
            raise HubError(
                f"{parts.scheme}_proxy: expected the address of an HTTP proxy, such as http://127.0.0.1:3128, got "
                f"{proxy.rpartition('@')[2]!r}; correct or unset it"
            ) from None
    else:
        manager = urllib3.PoolManager(maxsize=connections, retries=retries, timeout=timeout)
    response = staticmethod(partial(_Response, patience))  # as methods are, from Python 3.14 on, without
    plain = type("Plain", (HTTPConnection,), {"response_class": response})
    secure = type("Secure", (HTTPSConnection,), {"response_class": response})
    manager.pool_classes_by_scheme = {
        "http": type("PlainPool", (urllib3.HTTPConnectionPool,), {"ConnectionCls": plain}),
        "https": type("SecurePool", (urllib3.HTTPSConnectionPool,), {"ConnectionCls": secure}),
    }
    return manager
