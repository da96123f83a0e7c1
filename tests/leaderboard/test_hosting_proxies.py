"""The proxies that may stand in front, with the very files that we hand out: only names, ports and times are others."""

from __future__ import annotations

import http.client
import json
import shutil
import socket
import ssl
import subprocess
import threading
from contextlib import ExitStack, contextmanager

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.responses import JSONResponse
from starlette.routing import Route

from oysterbench.hub.connections import CLIENTS_OF_ADDRESS, server_settings
from oysterbench_leaderboard.submissions.accounts.auth import address_of
from tests.helpers.paths import ROOT
from tests.helpers.served import free_port
from tests.helpers.waiting import PATIENCE_S, until

FILES = ROOT / "leaderboard" / "hosting"
AROUND_NGINX = """
daemon off; master_process off; pid {folder}/pid; error_log {folder}/error.log;
events {{ worker_connections 256; }}
http {{
  access_log off; client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
  uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
  include {folder}/board.conf;
}}
"""
HOST = "board.example"
SPOOFED = {"X-Forwarded-For": "203.0.113.9", "X-Real-IP": "203.0.113.9", "Forwarded": "for=203.0.113.9"}


class Board:
    """What stands for the board: says whom it takes its client for, and that bytes have come."""

    def __init__(self, proxies):
        self.arrived = threading.Event()
        app = Starlette(routes=[Route("/", self.answer, methods=["GET", "POST"])])
        self.server = uvicorn.Server(uvicorn.Config(**server_settings(app, "127.0.0.1", 0, proxies=proxies)))

    async def answer(self, request):
        size = 0
        async for chunk in request.stream():
            size += len(chunk)
            if chunk:
                self.arrived.set()
        about = {"client": address_of(request), "scheme": request.url.scheme, "host": request.headers["host"]}
        return JSONResponse({**about, "size": size})


@contextmanager
def running(proxies):
    board = Board(proxies)
    thread = threading.Thread(target=board.server.run)
    thread.start()
    until(lambda: board.server.started)
    board.port = board.server.servers[0].sockets[0].getsockname()[1]
    try:
        yield board
    finally:
        board.server.should_exit = True
        thread.join()


def command(kind, folder, port, board):
    """Of a proxy with our file."""
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    if kind == "nginx":
        program = shutil.which("nginx", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
        text = (FILES / "nginx.conf").read_text()
        changes = {
            "listen 443": f"listen 127.0.0.1:{port}",
            "/etc/ssl/board/fullchain.pem": str(certificate),
            "/etc/ssl/board/privkey.pem": str(key),
            "127.0.0.1:8000": f"127.0.0.1:{board}",
            "client_header_timeout 20s": "client_header_timeout 1s",
            "257m": "1m",
        }
    else:
        program = shutil.which("caddy")
        text = (FILES / "Caddyfile").read_text()
        changes = {
            "{\n\tservers": "{\n\tadmin off\n\tauto_https disable_redirects\n\tservers",
            "board.example {": f"https://{HOST}:{port} {{\n\ttls {certificate} {key}",
            "127.0.0.1:8000": f"127.0.0.1:{board}",
            "read_header 20s": "read_header 1s",
            "257MB": "1MB",
        }
    if program is None:
        pytest.skip(f"{kind} is not installed (Debian: apt-get install {kind})")
    for before, after in changes.items():
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    (folder / "board.conf").write_text(text)
    if kind == "nginx":
        (folder / "nginx.conf").write_text(AROUND_NGINX.format(folder=folder))
        return [program, "-c", str(folder / "nginx.conf"), "-p", str(folder)]
    return [program, "run", "--adapter", "caddyfile", "--config", str(folder / "board.conf")]


@pytest.fixture(scope="module", params=["nginx", "caddy"])
def proxied(request, tmp_path_factory):
    """A proxy in front of a board that believes it; its port, its certificate, and the board."""
    folder = tmp_path_factory.mktemp(request.param)
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={HOST}"]
    made += ["-addext", f"subjectAltName=DNS:{HOST}", "-keyout", folder / "key.pem", "-out", folder / "certificate.pem"]
    subprocess.run(made, check=True, capture_output=True)
    with running(["127.0.0.1"]) as board:
        port = free_port()
        environment = {"HOME": str(folder), "PATH": "/usr/bin:/bin"}
        with open(folder / "log", "wb") as log:
            process = subprocess.Popen(command(request.param, folder, port, board.port), stderr=log, env=environment)
        try:
            until(lambda: listens(port), process)
            yield port, folder / "certificate.pem", board
        finally:
            process.terminate()
            process.wait()


def listens(port):
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except ConnectionError:
        return False
    return True


def connected(proxied, source="127.0.0.2"):
    """A connection over TLS, whose certificate is checked, from an address that is not the proxy's."""
    port, certificate, _ = proxied
    plain = socket.create_connection(("127.0.0.1", port), PATIENCE_S, source_address=(source, 0))
    return ssl.create_default_context(cafile=certificate).wrap_socket(plain, server_hostname=HOST)


def asked(stream, head, body=b""):
    """Status and JSON, or text, of an answer."""
    stream.sendall(head + body)
    answer = http.client.HTTPResponse(stream)
    answer.begin()
    data = answer.read()
    return answer.status, json.loads(data) if answer.status == 200 else data


def head_of(method="GET", **headers):
    lines = {"Host": HOST, "Connection": "close", **headers}
    told = "".join(f"{key}: {value}\r\n" for key, value in lines.items())
    return f"{method} / HTTP/1.1\r\n{told}\r\n".encode()


def test_the_board_learns_the_clients_address_whatever_the_client_says(proxied):
    with connected(proxied) as stream:
        status, told = asked(stream, head_of(**SPOOFED))
    assert (status, told["client"], told["scheme"], told["host"]) == (200, "127.0.0.2", "https", HOST)


@pytest.mark.parametrize(("proxies", "client"), [(["127.0.0.9"], "127.0.0.2"), ([], "127.0.0.2")])
def test_nobody_else_is_believed(proxies, client):
    with running(proxies) as board:
        plain = socket.create_connection(("127.0.0.1", board.port), PATIENCE_S, source_address=("127.0.0.2", 0))
        with plain as stream:
            assert asked(stream, head_of(**SPOOFED))[1]["client"] == client


def test_a_body_goes_through_as_it_comes(proxied):
    _, _, board = proxied
    board.arrived.clear()
    with connected(proxied) as stream:
        stream.sendall(head_of("POST", **{"Content-Length": "200000"}) + bytes(100_000))
        assert board.arrived.wait(PATIENCE_S), "the rest was not sent, and the first half is there"
        assert asked(stream, bytes(100_000))[1]["size"] == 200_000


def test_a_body_that_is_too_large_is_refused(proxied):
    with connected(proxied) as stream:
        head = head_of("POST", **{"Content-Length": "3000000"})
        status, _ = asked(stream, head, bytes(1_200_000))
    assert status in (413, 502)


def test_a_client_that_never_ends_its_headers_is_cut(proxied):
    with connected(proxied) as stream:
        stream.sendall(head_of()[:-4])
        assert b"200 OK" not in b"".join(iter(lambda: stream.recv(4096), b""))


def test_one_client_keeps_no_others_out(proxied):
    def status(source):
        with connected(proxied, source) as stream:
            return asked(stream, head_of())[0]

    with ExitStack() as stack:
        for _ in range(CLIENTS_OF_ADDRESS):
            stack.enter_context(connected(proxied)).sendall(head_of("POST", **{"Content-Length": "2"}) + b"x")
        until(lambda: status("127.0.0.2") == 429)
        assert status("127.0.0.3") == 200
