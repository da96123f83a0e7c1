"""Connections that are held: by requests that never end, and by one client behind a proxy."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import time
import urllib.parse

import anyio
import anyio.to_thread
import pytest
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from oysterbench.hub import connections
from oysterbench.hub.connections import CLIENTS_OF_ADDRESS, Guarded
from tests.helpers.trees import serving_app
from tests.helpers.waiting import NEVER, PATIENCE_S, until

UNENDED = b"GET / HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n"


async def answered(request):
    return PlainTextResponse("answered")


async def read(request):
    return PlainTextResponse(str(len(await request.body())))


async def large(request):
    return PlainTextResponse("large" * 5_000_000)


APP = Starlette(routes=[Route("/", answered), Route("/large", large), Route("/read", read, methods=["POST"])])


def connected(url):
    place = urllib.parse.urlsplit(url)
    return socket.create_connection((place.hostname, place.port), timeout=PATIENCE_S)


def answer_of(connection, head):
    """Status and body of what comes back."""
    connection.sendall(head)
    answer = http.client.HTTPResponse(connection)
    answer.begin()
    return answer.status, answer.read()


def of_client(address, start="GET / HTTP/1.1", more=""):
    """Headers of a request that a proxy forwards for a client."""
    return f"{start}\r\nHost: x\r\nX-Forwarded-For: {address}\r\n{more}\r\n".encode()


@pytest.mark.parametrize("every_s", [None, 0.05], ids=["silent", "trickling"])
def test_an_answered_request_that_never_ends_holds_no_connection(monkeypatch, every_s):
    with serving_app(APP) as url, connected(url) as connection:
        monkeypatch.setattr(connections, "HEADERS_S", 0.3)
        assert answer_of(connection, UNENDED) == (200, b"answered")
        begun = time.monotonic()
        with contextlib.suppress(ConnectionError):
            connection.sendall(b"x")
            connection.settimeout(every_s or 2.0)
            while time.monotonic() < begun + 2.0:
                with contextlib.suppress(TimeoutError):
                    assert connection.recv(1) == b""
                    break
                connection.sendall(b"x")
        assert time.monotonic() < begun + 2.0


def test_a_request_that_is_completed_after_its_answer_keeps_its_connection():
    with serving_app(APP) as url, connected(url) as connection:
        for _ in range(2):
            assert answer_of(connection, UNENDED) == (200, b"answered")
            connection.sendall(bytes(1000))


def test_an_answer_that_nobody_reads_holds_no_connection(monkeypatch):
    monkeypatch.setattr(connections, "UNREAD_S", 0.2)
    lost, real = threading.Event(), Guarded.connection_lost
    monkeypatch.setattr(Guarded, "connection_lost", lambda self, error: (real(self, error), lost.set()))
    with serving_app(APP) as url, connected(url) as connection:
        connection.sendall(b"GET /large HTTP/1.1\r\nHost: x\r\n\r\n")
        assert lost.wait(PATIENCE_S)
        size = 0
        with contextlib.suppress(ConnectionError):
            while data := connection.recv(1 << 20):
                size += len(data)
        assert 0 < size < 25_000_000


def test_an_answer_that_is_read_slowly_comes_whole(monkeypatch):
    monkeypatch.setattr(connections, "UNREAD_S", 0.4)
    with serving_app(APP) as url, connected(url) as connection:
        connection.sendall(b"GET /large HTTP/1.1\r\nHost: x\r\n\r\n")
        answer = http.client.HTTPResponse(connection)
        answer.begin()
        size = 0
        while data := answer.read(1_000_000):
            size += len(data)
            NEVER.wait(0.05)
        assert size == 25_000_000


def test_one_client_behind_a_proxy_keeps_no_others_out():
    with serving_app(APP, proxies=["127.0.0.1"]) as url, contextlib.ExitStack() as stack:
        begun = of_client("203.0.113.7", "POST /read HTTP/1.1", "Content-Length: 2\r\n") + b"x"
        held = [stack.enter_context(connected(url)) for _ in range(CLIENTS_OF_ADDRESS)]
        for connection in held:
            connection.sendall(begun)

        def answered_to(address):
            with connected(url) as connection:
                return answer_of(connection, of_client(address))

        until(lambda: answered_to("203.0.113.7")[0] == 429, patience_s=10.0)
        line = b"at most 64 requests at a time from one address; send this again when others are answered\n"
        assert answered_to("203.0.113.7") == (429, line)
        assert answered_to("203.0.113.8") == (200, b"answered")
        for connection in held:
            assert answer_of(connection, b"x") == (200, b"2")
        until(lambda: answered_to("203.0.113.7")[0] == 200)


def test_an_ipv6_client_behind_a_proxy_is_its_network():
    with serving_app(APP, proxies=["127.0.0.1"]) as url, contextlib.ExitStack() as stack:
        for k in range(CLIENTS_OF_ADDRESS):
            start = of_client(f"2001:db8::{k:x}", "POST /read HTTP/1.1", "Content-Length: 1\r\n")
            stack.enter_context(connected(url)).sendall(start)

        def status(address):
            with connected(url) as connection:
                return answer_of(connection, of_client(address))[0]

        until(lambda: status("2001:db8::ffff") == 429, patience_s=10.0)
        assert status("2001:db8:0:1::1") == 200


def test_requests_count_until_they_are_answered_even_if_their_connections_are_closed():
    ended = threading.Event()

    async def wait(request):
        await anyio.to_thread.run_sync(ended.wait, limiter=limiter)
        return PlainTextResponse("late")

    limiter = anyio.CapacityLimiter(1)
    with serving_app(Starlette(routes=[Route("/", answered), Route("/wait", wait)])) as url:

        def status(path):
            with connected(url) as connection:
                return answer_of(connection, f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())[0]

        for _ in range(CLIENTS_OF_ADDRESS):
            with connected(url) as connection:
                connection.sendall(b"GET /wait HTTP/1.1\r\nHost: x\r\n\r\n")
        try:
            until(lambda: status("/") == 429, patience_s=10.0)
        finally:
            ended.set()
        until(lambda: status("/") == 200)
