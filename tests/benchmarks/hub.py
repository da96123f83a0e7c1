"""How fast a download with verification is beside curl, from the same server in the same run; and 50 clients at once.

    .venv/bin/python tests/benchmarks/hub.py
    .venv/bin/python tests/benchmarks/hub.py --size 512 --rounds 5

curl and oysterbench take turns, from `oysterbench serve` and, where it is installed, from nginx; the rounds' median
ratio counts, because what else the machine does falls on both. curl checks nothing; oysterbench hashes every byte and
syncs the file to the disk. Both write to the same disk.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from oysterbench.hub.canonical import sha256
from oysterbench.hub.index import Index
from oysterbench.hub.manifest import FileEntry
from oysterbench.hub.part import Part
from oysterbench.hub.pieces import PIECE
from oysterbench.hub.sign import load_key, make_key
from oysterbench.hub.sources import Patience, open_source
from oysterbench.hub.transfer import Mirror, Transfer

RATIO = 0.8
"""Of curl's throughput, at least."""

CLIENTS = 50
CLIENT_MEGABYTES = 4
"""By which the server may grow for each client, at most."""

NGINX = """
daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/error.log;
events {{ worker_connections 256; }}
http {{ access_log off; client_body_temp_path {folder}/a; proxy_temp_path {folder}/b; fastcgi_temp_path {folder}/c;
  uwsgi_temp_path {folder}/d; scgi_temp_path {folder}/e;
  server {{ listen 127.0.0.1:{port}; root {tree}; sendfile on; gzip off; }} }}
"""


def make_tree(folder: Path, megabytes: int) -> tuple[Path, FileEntry]:
    """A tree with one blob of random bytes, and the blob's entry."""
    generator = random.Random(1)
    data = b"".join(generator.randbytes(1 << 20) for _ in range(megabytes))
    pieces = tuple(sha256(data[k : k + PIECE]) for k in range(0, len(data), PIECE))
    entry = FileEntry("dive-01.mcap", len(data), sha256(data), pieces, {}, {}, 0, PIECE)
    tree = folder / "tree"
    (tree / "blobs").mkdir(parents=True)
    (tree / "blobs" / entry.sha256).write_bytes(data)
    make_key(folder / "key.pem")
    (tree / "index.json").write_bytes(Index().signed_with(load_key(folder / "key.pem")))
    (tree / "index.html").write_text("a page")
    return tree, entry


@contextlib.contextmanager
def running(command: list[str], port: int) -> Iterator[subprocess.Popen[bytes]]:
    """A server, once it answers."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while True:
            if process.poll() is not None:
                raise SystemExit(f"{command} ended with {process.returncode}")
            with contextlib.suppress(ConnectionError):
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            time.sleep(0.02)
        yield process
    finally:
        process.terminate()
        process.wait()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def with_curl(url: str, entry: FileEntry, folder: Path) -> None:
    target = folder / "curl"
    subprocess.run(["curl", "-sS", "-o", target, f"{url}/blobs/{entry.sha256}"], check=True)
    target.unlink()


def with_oysterbench(url: str, entry: FileEntry, folder: Path) -> None:
    part = Part(folder / "file.part", entry)
    mirrors = [Mirror(open_source(url, 4, Patience()))]
    Transfer(part, mirrors, 4, Patience(), lambda n: None).fetch(range(len(entry.pieces)))
    part.install(folder / "file")
    part.close()
    (folder / "file").unlink()


def seconds(rounds: int, *ways: Callable[[], None]) -> tuple[np.ndarray, np.ndarray]:
    """Time of each round (rows) and way (columns), taken in turns: on the clock, and of the processor (the client's
    alone)."""
    wall, cpu = np.zeros((2, rounds, len(ways)))
    for turn in range(rounds):
        for k, way in enumerate(ways):
            start, busy = time.perf_counter(), processor_s()
            way()
            wall[turn, k] = time.perf_counter() - start
            cpu[turn, k] = processor_s() - busy
    return wall, cpu


def processor_s() -> float:
    """Seconds that the processor worked for this process and for its children that have ended."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(usage.ru_utime + usage.ru_stime for usage in map(resource.getrusage, kinds))


def memory_mb(process: int) -> float:
    """Peak resident memory of a process."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    raise SystemExit("the system does not tell a process's memory")


def many_clients(url: str, entry: FileEntry) -> list[str]:
    """What went wrong with 50 clients that read the whole file at once."""
    errors: list[str] = []

    def client() -> None:
        try:
            with urllib.request.urlopen(f"{url}/blobs/{entry.sha256}", timeout=600) as response:
                got = 0
                while data := response.read(1 << 20):
                    got += len(data)
                if got != entry.size:
                    errors.append(f"{got} bytes")
        except OSError as error:
            errors.append(str(error))

    threads = [threading.Thread(target=client) for _ in range(CLIENTS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256, help="MiB of the file")
    parser.add_argument("--rounds", type=int, default=8)
    options = parser.parse_args()
    good = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tree, entry = make_tree(folder, options.size)
        port = free_port()
        servers = {"oysterbench serve": [str(Path(sys.executable).with_name("oysterbench")), "serve", str(tree)]}
        servers["oysterbench serve"] += ["--port", str(port)]
        if nginx := shutil.which("nginx", path=os.environ["PATH"] + ":/usr/sbin"):
            (folder / "nginx.conf").write_text(NGINX.format(folder=folder, port=port, tree=tree))
            folder.chmod(0o755)
            servers["nginx"] = [nginx, "-c", str(folder / "nginx.conf"), "-p", str(folder)]
        for server, command in servers.items():
            with running(command, port) as process:
                url = f"http://127.0.0.1:{port}"
                wall, cpu = seconds(
                    options.rounds,
                    lambda: with_curl(url, entry, folder),  # noqa: B023
                    lambda: with_oysterbench(url, entry, folder),  # noqa: B023
                )
                ratios = wall[:, 0] / wall[:, 1]
                ratio = float(np.median(ratios))
                good &= ratio >= RATIO
                (curl, ours), (curl_cpu, ours_cpu) = np.median(wall, axis=0), np.median(cpu, axis=0)
                rates = f"curl {options.size / curl:6.0f} MiB/s, oysterbench {options.size / ours:6.0f} MiB/s"
                spread = f"{np.min(ratios):.2f} to {np.max(ratios):.2f}"
                print(f"{server:18s} {rates}, {ratio:.2f} of curl ({spread}; at least {RATIO} wanted)")
                print(f"{'':18s} of the processor: curl {curl_cpu:.2f} s, oysterbench {ours_cpu:.2f} s")
                if server != "nginx":
                    before = memory_mb(process.pid)
                    start = time.perf_counter()
                    errors = many_clients(url, entry)
                    rate = CLIENTS * options.size / (time.perf_counter() - start)
                    grown = memory_mb(process.pid) - before
                    good &= not errors and grown <= CLIENTS * CLIENT_MEGABYTES
                    print(
                        f"{CLIENTS} clients at once  {rate:.0f} MiB/s together, {len(errors)} errors, the server's "
                        f"memory grew by {grown:.0f} MB"
                    )
    raise SystemExit(not good)


if __name__ == "__main__":
    main()
