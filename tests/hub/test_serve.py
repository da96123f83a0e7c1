"""The server, over real sockets: ranges, conditions, and what is refused."""

from __future__ import annotations

import contextlib
import http.client
import json
import logging
import re
import resource
import socket
import threading
import urllib.parse

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub import connections
from oysterbench.hub.connections import CLIENTS_OF_ADDRESS, LARGEST_HEADERS
from tests.helpers.browser import CHROMIUM
from tests.helpers.command import run
from tests.helpers.trees import a_key, oysterbench_serve, publish_split, write_split
from tests.helpers.waiting import until


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Address of a server, the folder of its tree, and the manifest."""
    folder = tmp_path_factory.mktemp("hub")
    key, _ = a_key(folder)
    manifest = publish_split(folder / "tree", write_split(folder / "data"), key)
    (folder / "secret").write_text("the truth")
    with oysterbench_serve(folder / "tree") as url:
        yield url, folder / "tree", manifest


WHOLE = b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n"


def ask(url, path, method="GET", **headers):
    """Status, headers and body."""
    place = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(place.hostname, place.port, timeout=10)
    with contextlib.closing(connection):
        connection.request(method, path, headers={key.replace("_", "-"): value for key, value in headers.items()})
        response = connection.getresponse()
        return response.status, response.headers, response.read()


def raw(url, data):
    """What comes back for raw bytes."""
    place = urllib.parse.urlsplit(url)
    with socket.create_connection((place.hostname, place.port), timeout=10) as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(data)
        found = b""
        with contextlib.suppress(ConnectionError):
            while more := connection.recv(65536):
                found += more
        return found


@pytest.fixture
def blob(site):
    """Path, bytes and entity tag of a blob."""
    _, tree, manifest = site
    entry = manifest.files[0]
    return f"/blobs/{entry.sha256}", (tree / "blobs" / entry.sha256).read_bytes(), f'"{entry.sha256}"'


def test_a_blob_comes_whole_with_its_hash_as_tag(site, blob):
    path, data, tag = blob
    status, headers, body = ask(site[0], path, Accept_Encoding="gzip, br")
    assert (status, body) == (200, data)
    assert headers["ETag"] == tag
    assert headers["Accept-Ranges"] == "bytes"
    assert headers["Content-Length"] == str(len(data))
    assert "immutable" in headers["Cache-Control"]
    assert headers["Content-Encoding"] is None
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    ("header", "span"),
    [
        ("bytes=0-0", (0, 1)),
        ("bytes=10-19", (10, 20)),
        ("bytes=1000-", (1000, None)),
        ("bytes=-5", (-5, None)),
        ("bytes=0-99999999999", (0, None)),
        ("bytes=-99999999999", (0, None)),
        ("BYTES=3-4", (3, 5)),
    ],
)
def test_a_range_gives_206_and_says_which(site, blob, header, span):
    path, data, _ = blob
    status, headers, body = ask(site[0], path, Range=header)
    assert status == 206
    assert body == data[slice(*span)]
    first = data.index(body) if len(body) > 20 else slice(*span).indices(len(data))[0]
    assert headers["Content-Range"] == f"bytes {first}-{first + len(body) - 1}/{len(data)}"
    assert headers["Content-Length"] == str(len(body))


@pytest.mark.parametrize("header", ["bytes=99999999-", "bytes=99999999-100000000", "bytes=-0"])
def test_a_range_outside_gives_416_with_the_size(site, blob, header):
    path, data, _ = blob
    status, headers, _ = ask(site[0], path, Range=header)
    assert status == 416
    assert headers["Content-Range"] == f"bytes */{len(data)}"


@pytest.mark.parametrize(
    "header",
    [
        "bytes=0-1,3-4",
        "bytes=0-,0-,0-,0-",
        "bytes=" + ",".join(f"{k}-" for k in range(1000)),
        "bytes=5-2",
        "bytes=-",
        "bytes=a-b",
        "lines=1-2",
        "bytes=" + "9" * 400 + "-",
        "bytes=٣-٤".encode().decode("latin-1"),
    ],
)
def test_other_ranges_are_answered_with_the_whole(site, blob, header):
    path, data, _ = blob
    status, headers, body = ask(site[0], path, Range=header)
    assert (status, body) == (200, data)
    assert headers["Content-Range"] is None


def test_conditions(site, blob):
    path, data, tag = blob
    url = site[0]
    for known in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        status, headers, body = ask(url, path, If_None_Match=known, Range="bytes=0-1")
        assert (status, body, headers["ETag"]) == (304, b"", tag)
    assert ask(url, path, If_None_Match='"other"')[0] == 200
    assert ask(url, path, Range="bytes=0-1", If_Range=tag)[0] == 206
    for other in ('"other"', f"W/{tag}", "Fri, 31 Dec 1999 23:59:59 GMT"):
        status, _, body = ask(url, path, Range="bytes=0-1", If_Range=other)
        assert (status, body) == (200, data)
    assert ask(url, path, If_Match='"other"')[0] == 412
    assert ask(url, path, If_Match=f"W/{tag}")[0] == 412
    assert ask(url, path, If_Match=tag)[0] == 200


def test_head_says_what_get_would_without_a_body(site, blob):
    path, data, tag = blob
    status, headers, body = ask(site[0], path, "HEAD", Range="bytes=0-1")
    assert (status, body) == (200, b"")
    assert headers["Content-Length"] == str(len(data))
    assert headers["ETag"] == tag


def test_a_script_on_another_site_may_read_ranges(site, blob):
    path = blob[0]
    _, headers, _ = ask(site[0], path, Range="bytes=0-1", Origin="https://app.foxglove.dev")
    assert headers["Access-Control-Allow-Origin"] == "*"
    exposed = {name.strip() for name in headers["Access-Control-Expose-Headers"].split(",")}
    assert {"Content-Range", "ETag", "Accept-Ranges"} <= exposed
    status, headers, _ = ask(
        site[0],
        path,
        "OPTIONS",
        Origin="https://app.foxglove.dev",
        Access_Control_Request_Method="GET",
        Access_Control_Request_Headers="range",
    )
    assert status == 200
    assert "range" in headers["Access-Control-Allow-Headers"].lower()


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
def test_the_command_on_the_page_has_its_own_address(site, browser):
    url, tree, _ = site
    command = "[...document.querySelectorAll('pre')].pop().innerText.split('\\n')[0]"
    for page in (f"{url}/", f"{url}/index.html"):
        browser.go(page)
        assert browser.value(command) == f"export OYSTERBENCH_HUB='{url}/'"
    browser.go((tree / "index.html").as_uri())
    assert browser.value(command) == "export OYSTERBENCH_HUB='ADDRESS OF THIS PAGE'"


def test_page_index_and_health(site):
    url, tree, _ = site
    status, headers, page = ask(url, "/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["Cache-Control"] == "no-cache"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    for link in re.findall(r'(?:href|src)="([^"]+)"', page.decode()):
        assert ask(url, f"/{link}")[0] == 200, link
    assert b"fake-val 1.0" in page
    status, headers, body = ask(url, "/index.json")
    assert body == (tree / "index.json").read_bytes()
    assert ask(url, "/index.json", If_None_Match=headers["ETag"])[0] == 304
    assert json.loads(ask(url, "/health")[2])["status"] == "ok"


HASH = "0" * 64
REFUSED = [
    "/../secret",
    "/blobs/../../secret",
    "/blobs/%2e%2e/%2e%2e/secret",
    "/blobs/..%2f..%2fsecret",
    "/blobs/%2e%2e%5c%2e%2e%5csecret",
    "/blobs/%252e%252e%252fsecret",
    "//etc/passwd",
    "/blobs//etc/passwd",
    "/blobs/%2fetc%2fpasswd",
    f"/blobs/{HASH}%00",
    f"/blobs/{HASH}%0a",
    f"/blobs/{HASH}/../../index.json",
    f"/blobs/{HASH.replace('0', 'A')}",
    f"/blobs/{HASH}0",
    f"/blobs/{HASH[:-1]}",
    f"/blobs/{HASH}",
    f"/manifests/{HASH}",
    f"/manifests/{HASH}.json.bak",
    "/blobs/",
    "/blobs",
    "/.lock",
    "/secret",
    "/blobs/" + "a" * 8000,
    "/blobs/%ff%fe",
    "/blobs/%",
    "/index.json/",
]


@pytest.mark.parametrize("path", REFUSED)
def test_paths_that_lead_elsewhere_are_refused_and_logged(site, path, caplog):
    log = logging.getLogger("uvicorn.access")
    log.addHandler(caplog.handler)
    try:
        answer = raw(site[0], f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
    finally:
        log.removeHandler(caplog.handler)
    assert re.match(rb"HTTP/1.1 (404|400|307) ", answer), answer[:200]
    assert b"the truth" not in answer
    assert b"root:" not in answer
    assert any(re.search(r"40[04]|307", record.getMessage()) for record in caplog.records)
    assert ask(site[0], "/health")[0] == 200


@pytest.mark.parametrize(
    "data",
    [
        b"GET /blobs/\0 HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\r\nX: " + b"a" * (2 * LARGEST_HEADERS) + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\r\n" + b"X: y\r\n" * LARGEST_HEADERS + b"\r\n",
        b"\x16\x03\x01\x02\x00\x01" * 50,
        b"POST /blobs/x HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n",
        b"\r\n\r\n\r\n\r\nnonsense\r\n\r\n",
    ],
    ids=["nul", "long header", "many headers", "tls", "negative length", "nonsense"],
)
def test_nonsense_and_floods_are_refused_and_the_server_lives(site, data):
    answer = raw(site[0], data)
    assert answer == b"" or re.match(rb"HTTP/1.1 4\d\d ", answer), answer[:200]
    assert ask(site[0], "/health")[0] == 200


@pytest.mark.parametrize("begun", [b"", b"GET / HTT", b"GET / HTTP/1.1\r\nHost: x\r\n", WHOLE + b"GET /"])
def test_who_never_says_what_it_wants_is_sent_away(site, monkeypatch, begun):
    monkeypatch.setattr(connections, "HEADERS_S", 0.2)
    answer = raw(site[0], begun)  # until the server closes
    assert answer.startswith(b"HTTP/1.1 200") if begun.startswith(WHOLE) else answer == b""


def test_no_address_keeps_all_others_out(tmp_path, site):
    place = urllib.parse.urlsplit(site[0])
    with contextlib.ExitStack() as stack:
        for _ in range(CLIENTS_OF_ADDRESS):
            stack.enter_context(socket.create_connection((place.hostname, place.port), timeout=10))
        assert raw(site[0], b"").startswith(b"HTTP/1.1 429 ")
    until(lambda: ask(site[0], "/health")[0] == 200)


def test_a_proxy_has_the_connections_of_many(site):
    with oysterbench_serve(site[1], proxies=["127.0.0.1"]) as url, contextlib.ExitStack() as stack:
        place = urllib.parse.urlsplit(url)
        for _ in range(CLIENTS_OF_ADDRESS):
            stack.enter_context(socket.create_connection((place.hostname, place.port), timeout=10))
        assert ask(url, "/health")[0] == 200


def test_nothing_can_be_written(site, blob):
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert ask(site[0], blob[0], method)[0] == 405
    assert ask(site[0], blob[0])[2] == blob[1]


def test_a_link_out_of_the_tree_is_not_followed(site):
    url, tree, _ = site
    (tree / "blobs" / HASH).symlink_to(tree.parent / "secret")
    try:
        answer = ask(url, f"/blobs/{HASH}")
        assert answer[0] in (404, 500)
        assert b"the truth" not in answer[2]
    finally:
        (tree / "blobs" / HASH).unlink()


def test_fifty_clients_at_once(site, blob):
    path, data, _ = blob
    answers, barrier = [], threading.Barrier(50)

    def client(k):
        barrier.wait()
        start = 1000 * k
        status, _, body = ask(site[0], path, Range=f"bytes={start}-")
        answers.append((status, body == data[start:]))

    threads = [threading.Thread(target=client, args=(k,)) for k in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [(206, True)] * 50


def test_clients_that_do_not_read_cost_little_memory(site, tmp_path):
    url, tree, _ = site
    large = tree / "blobs" / ("f" * 64)
    with open(large, "wb") as file:
        file.truncate(1 << 30)
    place = urllib.parse.urlsplit(url)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    connections = []
    try:
        for _ in range(40):
            connection = socket.create_connection((place.hostname, place.port))
            connection.sendall(f"GET /blobs/{large.name} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
            connections.append(connection)
        for connection in connections:
            assert connection.recv(10) == b"HTTP/1.1 2"
        assert ask(url, "/health")[0] == 200
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        assert grown < 40 * 4, f"{grown} MB for 40 clients of a file of 1 GiB"
    finally:
        for connection in connections:
            connection.close()
        large.unlink()


def test_an_address_that_is_taken_is_one_line_and_nothing_is_started():
    with connections.listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        wrong = f"cannot serve at 127.0.0.1:{port}: address already in use; give another --port, or --host"
        with pytest.raises(HubError, match=wrong):
            connections.listen("127.0.0.1", port)
    with pytest.raises(HubError, match=r"cannot serve at no\.such\.host\.invalid:1: "):
        connections.listen("no.such.host.invalid", 1)


def test_it_says_where_it_serves_with_the_port_that_it_has(site, monkeypatch):
    ports = []

    def run_once(app, listening, **options):
        ports.append(listening.getsockname()[1])
        listening.close()

    monkeypatch.setattr("oysterbench.hub.serve.run", run_once)
    done = run("serve", site[1], "--port", 0)
    assert done.returncode == 0
    assert f"serving http://127.0.0.1:{ports[0]}/ (stop with Ctrl-C)\n" in done.stderr
    assert ports[0] > 0


def test_an_address_of_ipv6_stands_in_brackets():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        assert connections.address("::1", listening, "/board") == f"http://[::1]:{port}/board/"
