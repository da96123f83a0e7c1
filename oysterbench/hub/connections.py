"""Connections to our servers: how many a client may have, and how long it may take to send a request."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
from collections import Counter
from collections.abc import Sequence
from typing import Any

import h11
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from oysterbench.core.errors import HubError
from oysterbench.hub.addresses import network

LARGEST_HEADERS = 16 << 10
MOST_HEADERS = 100
CLIENTS = 512
"""Limits on the size in bytes and number of a request's headers, and on concurrent clients, beyond which it is
refused."""

BACKLOG = 2048
"""Length of the queue of connections waiting to be accepted."""

CLIENTS_OF_ADDRESS = 64
"""Connections that one address may hold, and requests that it may have running: an eighth of all, so that nobody alone
can lock out all others."""

HEADERS_S = 20.0
"""Time limit from the connection, or the previous response, to the last byte of a request's headers. What is left of
the previous request's body has to arrive within it, too."""

UNREAD_S = 60.0
"""Time within which a client has to take something of its answer."""

REFUSED = b"HTTP/1.1 429 Too Many Requests\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
TOO_MANY = (
    f"at most {CLIENTS_OF_ADDRESS} requests at a time from one address; send this again when others are answered\n"
)

LOGGING = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"plain": {"format": "%(asctime)s %(levelname)s %(message)s"}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "plain", "stream": "ext://sys.stderr"}},
    "loggers": {"uvicorn": {"handlers": ["stderr"], "level": "INFO", "propagate": False}},
}


class Guarded(H11Protocol):
    """Uvicorn's HTTP/1.1 protocol with a deadline for requests that are never completed, answered ones included, and
    for answers that are not read, and a limit per address."""

    _deadline: asyncio.TimerHandle | None = None
    _look: asyncio.TimerHandle | None = None
    _unread = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._look = self.loop.call_later(UNREAD_S, self._look_at_unread)
        if self._of_address() > CLIENTS_OF_ADDRESS:
            transport.write(REFUSED)
            transport.close()
            return
        self._watch()

    def data_received(self, data: bytes) -> None:
        if not self.transport.is_closing():  # ignore whatever a refused connection still sends
            super().data_received(data)
            self._watch()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._watch()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._unread = 0

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget()
        if self._look is not None:
            self._look.cancel()
        super().connection_lost(exc)

    def _of_address(self) -> int:
        """Number of connections of this client; 0 for a trusted proxy, which stands for many clients."""
        if self.client is None or self.client[0] in trusted(self.config.forwarded_allow_ips):
            return 0
        mine = network(self.client[0])
        clients = [getattr(other, "client", None) for other in self.connections]
        return sum(client is not None and network(client[0]) == mine for client in clients)

    def _watch(self) -> None:
        """Start the deadline where the client has to send something before it gets an answer, and cancel it once the
        headers of a request are complete. A body that is still arriving after its answer does not cancel it."""
        if self.conn.their_state is not h11.IDLE and self.conn.our_state is not h11.DONE:
            self._forget()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEADERS_S, self.transport.close)

    def _look_at_unread(self) -> None:
        """Cut the connection where the client has taken nothing since the last look; it may be closing already, which
        waits for the client as well."""
        unread = self.transport.get_write_buffer_size()
        if 0 < self._unread <= unread:
            self.transport.abort()
            return
        self._unread = unread
        self._look = self.loop.call_later(UNREAD_S, self._look_at_unread)

    def _forget(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class RequestLimit:
    """Middleware that refuses requests of a client while CLIENTS_OF_ADDRESS others of it are running: also those whose
    connections are closed already, or are a proxy's, which are those of many. Requests for which the proxy names no
    client count as its own."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._running: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        host, _ = scope["client"] or ("", 0)
        client = network(host)
        if self._running[client] >= CLIENTS_OF_ADDRESS:
            await PlainTextResponse(TOO_MANY, 429, {"Connection": "close"})(scope, receive, send)
            return
        self._running[client] += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._running[client] -= 1
            if not self._running[client]:
                del self._running[client]


def trusted(proxies: str | Sequence[str]) -> set[str]:
    """Addresses of the proxies in front of a server, from uvicorn's setting."""
    return {part.strip() for part in (proxies.split(",") if isinstance(proxies, str) else proxies)}


def server_settings(
    app: Any, host: str, port: int, lifespan: str = "off", proxies: Sequence[str] = ()
) -> dict[str, Any]:
    """Settings for uvicorn to serve an application; raises the limit on open files to its maximum.

    proxies: addresses trusted to state the client that they forward for
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # connections and files are limited elsewhere
    return {
        "app": RequestLimit(app),
        "host": host,
        "port": port,
        "http": Guarded,
        "ws": "none",
        "lifespan": lifespan,
        "server_header": False,
        "h11_max_incomplete_event_size": LARGEST_HEADERS,
        "limit_concurrency": CLIENTS,
        "timeout_keep_alive": int(HEADERS_S),
        "proxy_headers": bool(proxies),
        "forwarded_allow_ips": list(proxies),
        "log_config": LOGGING,
    }


def listen(host: str, port: int) -> socket.socket:
    """Listen at an address before anything is started for it. Raises HubError where that is impossible, for example
    because another program listens there. Port 0 takes a free one."""
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server((host, port), family=family, backlog=BACKLOG)
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None) or 0
        # For an unknown host name, the number is of another kind, below 0.
        reason = os.strerror(number) if number > 0 else str(getattr(error, "strerror", None) or error)
        raise HubError(f"cannot serve at {host}:{port}: {reason.lower()}; give another --port, or --host") from None


def address(host: str, listening: socket.socket, root: str = "") -> str:
    """URL at which a browser finds what is served there. root: prefix of all paths"""
    return f"http://{f'[{host}]' if ':' in host else host}:{listening.getsockname()[1]}{root}/"


def run(app: Any, listening: socket.socket, lifespan: str = "off", proxies: Sequence[str] = ()) -> None:
    """Serve an application until interrupted; every request is logged on stderr. Raises HubError where it does
    not start."""
    import uvicorn

    host, port, *_ = listening.getsockname()
    server = uvicorn.Server(uvicorn.Config(**server_settings(app, host, port, lifespan, proxies)))
    with contextlib.suppress(KeyboardInterrupt):  # uvicorn raises it again once everything is closed
        server.run(sockets=[listening])
    if not server.started:
        raise HubError(f"the server at {host}:{port} did not start; what it logged above says why")
