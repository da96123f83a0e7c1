"""The tree behind servers that know nothing of it: Python's, which ignores ranges, and nginx."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import urllib.request
from contextlib import contextmanager

import pytest

from oysterbench.hub.download import Hub, download, part_path
from tests.helpers.blobs import CALM
from tests.helpers.trees import Big, a_key, publish_split, tree_bytes, write_split
from tests.helpers.waiting import until


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A tree with a real split in it and one large file; its folder, public key and files."""
    folder = tmp_path_factory.mktemp("hub")
    big = Big(folder)
    for name, data in big.files.items():
        path = folder / "big" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    (folder / "other").mkdir()
    key, public = a_key(folder / "other")
    publish_split(folder / "dives", write_split(folder / "data"), key)
    return folder, big, public


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(port):
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except ConnectionError:
        return False
    return True


@contextmanager
def running(command, port):
    """A server process, once it answers."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: answers(port), process)
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def check(url, tree, tmp_path):
    """Both splits come right; a part is gone on with; pictures and page are there for browsers."""
    folder, big, public = tree
    hub = Hub.at([f"{url}/dives"], public, patience=CALM)
    files = download(hub, hub.manifest("fake-val"), tmp_path / "dives")
    assert {path.name: path.read_bytes() for path in files.values()} == {
        name: data for name, data in tree_bytes(folder / "data").items() if name.endswith(".mcap")
    }
    hub = Hub.at([f"{url}/big"], big.public, patience=CALM)
    part = part_path(tmp_path / "big", big.entry)
    part.parent.mkdir()
    part.write_bytes(big.data[: big.entry.size // 2])
    files = download(hub, hub.manifest("big"), tmp_path / "big")
    assert files["dive-01"].read_bytes() == big.data
    with urllib.request.urlopen(f"{url}/dives/") as page:
        assert b"fake-val 1.0" in page.read()
    return hub


def test_pythons_own_server(tree, tmp_path):
    port = free_port()
    command = [sys.executable, "-m", "http.server", str(port), "--bind", "127.0.0.1", "--directory", str(tree[0])]
    with running(command, port) as url:
        hub = check(url, tree, tmp_path)
    assert hub.mirrors[0].whole


NGINX = """
daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/error.log;
events {{ worker_connections 256; }}
http {{
  access_log off; client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
  uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
  types {{ text/html html; image/jpeg jpg; application/json json; }}
  server {{ listen 127.0.0.1:{port}; root {root}; sendfile on; gzip off; }}
}}
"""


def test_nginx(tree, tmp_path):
    program = shutil.which("nginx", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
    if program is None:
        pytest.skip("nginx is not installed (Debian: apt-get install nginx-light)")
    port = free_port()
    settings = tmp_path / "nginx.conf"
    settings.write_text(NGINX.format(folder=tmp_path, port=port, root=tree[0]))
    tree[0].chmod(0o755)
    with running([program, "-c", str(settings), "-p", str(tmp_path)], port) as url:
        hub = check(url, tree, tmp_path)
    assert not hub.mirrors[0].whole
