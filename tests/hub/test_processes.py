"""Downloads by several processes, and by processes that are killed."""

from __future__ import annotations

import random
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from oysterbench.hub.download import part_path
from oysterbench.hub.part import Part
from tests.helpers.blobs import beginnings
from tests.helpers.paths import HELPERS
from tests.helpers.trees import PIECE, SIZE, Big, tree_bytes
from tests.helpers.waiting import NEVER, until
from tests.helpers.web import Honest, serving

PROGRAM = HELPERS / "one_download.py"


class Slow(Honest):
    """A server that takes a second or so for the file, and can be held."""

    going = threading.Event()
    going.set()

    def pause(self):
        NEVER.wait(0.006)
        self.going.wait(30)

    def setup(self):
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 14)
        super().setup()


@pytest.fixture(scope="module")
def big(tmp_path_factory):
    return Big(tmp_path_factory.mktemp("big"))


@pytest.fixture(autouse=True)
def _own_home(home):
    """Processes remember indexes in a home of this test."""


def start(url, big, folder, *options):
    return subprocess.Popen(
        [sys.executable, PROGRAM, url, big.public, str(folder), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def kill_and_go_on(big, folder, fraction):
    """Kill a download when that share of the bytes was sent; finish it. Bytes of pieces that were sent twice, but for
    those that the system had not handed over."""
    target, part = folder / "dive-01.mcap", part_path(folder, big.entry)
    reached, going = threading.Event(), threading.Event()
    going.set()
    with serving(Slow, big.files, going=going) as site:
        first = start(site.url, big, folder)
        while first.poll() is None and not reached.wait(0.001):
            if site.sent >= fraction * SIZE:
                reached.set()
        going.clear()
        first.send_signal(signal.SIGSTOP)
        NEVER.wait(0.05)  # answers that were under way have arrived
        underway = underway_bytes(site)
        first.kill()
        first.communicate()
        going.set()
        assert not target.exists() or target.read_bytes() == big.data
        kept = 0
        if part.is_file():
            opened = Part(part, big.entry)
            kept = sum(big.entry.length(k) for k in range(len(big.entry.pieces)) if opened.is_right(k))
            opened.close()
            begun, wrong = beginnings(part, big.entry, big.data)
            assert not wrong
            kept += begun
        until(lambda: not site.connections)  # what was under way notices that nobody listens
        first_sent = site.sent
    done = target.exists()
    with serving(Honest, big.files) as site:
        second = start(site.url, big, folder)
        out, errors = second.communicate()
        assert second.returncode == 0, errors
        assert out.strip() == str(target)
        blob_bytes = sum(end - start for path, start, end in site.requests if path == big.blob)
    assert target.read_bytes() == big.data
    assert {path.name for path in folder.iterdir() if path.suffix != ".lock"} == {target.name, "manifest.json"}
    assert blob_bytes == (0 if done else SIZE - kept)
    documents = sum(len(data) for path, data in big.files.items() if path != big.blob)
    return first_sent - documents + blob_bytes - SIZE - underway


def underway_bytes(site):
    """Bytes from a server that its clients have not read, headers included: many where the machine is busy.

    As proc_net_tcp(5): in each line local and remote address, state, and bytes to send and to read, in hexadecimal.
    """
    port, found = int(site.url.rpartition(":")[2]), 0
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, local, remote, _, queues, *_ = line.split()
        to_send, to_read = (int(number, 16) for number in queues.split(":"))
        found += to_send * (int(local.rpartition(":")[2], 16) == port)
        found += to_read * (int(remote.rpartition(":")[2], 16) == port)
    return found


def check_killed(big, tmp_path, fractions):
    twice = [kill_and_go_on(big, tmp_path / str(k), fraction) for k, fraction in enumerate(fractions)]
    # The second time only what part and drafts lack is asked for. Of what was handed over the first time, each
    # connection loses what it had in hand: less than a piece together.
    assert max(twice) <= PIECE, twice
    return twice


def test_a_killed_download_goes_on_from_its_pieces(big, tmp_path):
    check_killed(big, tmp_path, (0.1, 0.7))


@pytest.mark.slow
def test_a_download_killed_at_50_random_moments(big, tmp_path):
    generator = random.Random(3)
    twice = check_killed(big, tmp_path, [generator.random() for _ in range(50)])
    print(f"bytes sent twice, in pieces of {PIECE}: mean {sum(twice) / 50 / PIECE:.2f}, most {max(twice) / PIECE:.2f}")


def test_ctrl_c_is_one_line_with_130_and_the_download_goes_on(big, tmp_path):
    command = [Path(sys.executable).with_name("oysterbench"), "download", "big", "--key", big.public, "--out", tmp_path]
    interrupted = threading.Event()

    def pause():
        """Slow at first; then nothing comes until the client is gone, however long that takes on a busy machine."""
        NEVER.wait(0.006)
        if site.sent >= SIZE // 2:
            interrupted.wait(30)

    with serving(Slow, big.files, pause=staticmethod(pause)) as site:
        process = subprocess.Popen([*command, "--from", site.url], stderr=subprocess.PIPE, text=True)
        until(lambda: site.sent >= SIZE // 4, process)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
        interrupted.set()
    assert process.returncode == 130
    assert errors.splitlines()[-1].startswith("oysterbench: interrupted; downloaded data is kept, and")
    assert "Traceback" not in errors
    with serving(Honest, big.files) as site:
        done = subprocess.run([*command, "--from", site.url], capture_output=True, text=True, check=True)
        assert sum(end - start for path, start, end in site.requests if path == big.blob) < SIZE
    assert Path(done.stdout.strip()).read_bytes() == big.data


def all_at_once(big, folder, *options):
    with serving(Slow, big.files) as site:
        processes = [start(site.url, big, folder, *options) for _ in range(8)]
        for process in processes:
            out, errors = process.communicate()
            assert process.returncode == 0, errors
            assert out.strip() == str(folder / "dive-01.mcap")
        sent = sum(end - start for path, start, end in site.requests if path == big.blob)
    found = {name: data for name, data in tree_bytes(folder).items() if not name.endswith(".lock")}
    assert set(found) == {"dive-01.mcap", "manifest.json"}
    assert found["dive-01.mcap"] == big.data
    return sent


def test_eight_processes_download_one_copy(big, tmp_path):
    assert all_at_once(big, tmp_path / "here") == SIZE


def test_eight_processes_need_no_locks_to_be_right(big, tmp_path):
    assert all_at_once(big, tmp_path / "here", "no-locks") >= SIZE
