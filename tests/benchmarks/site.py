"""How long pages of a large board take with many clients: `python -m tests.benchmarks.site [--records 100000]`.

The board is that of `leaderboard.py`; give both the same --folder, and it is made once. A server in a process of its
own; clients over connections that stay open. Four kinds of load: a mix as visitors make it (the first pages mostly, now
and then a search that nobody asked for before) who read for a second before they ask again; and, of clients that ask
again as soon as they are answered (closed loop), everybody at the first page, the same mix, and only pages that were
never asked for. On a busy machine the server's CPU time
for a request says more than the clock: times the number of clients it is what they wait for where nothing else runs.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from oysterbench.core.streams import stream
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.site.paths import split_path
from oysterbench_leaderboard.storage.store import RecordStore
from tests.benchmarks import leaderboard as made

CLIENTS = 50
REQUESTS = 40
SORTS = ("score", "ate_percent", "coverage", "method", "team", "created")
ASKED = b"GET %s HTTP/1.1\r\nHost: board\r\nAccept-Encoding: gzip\r\n\r\n"


def serve(folder: Path, index: str, ready: Event, port: Any) -> None:
    """The server that `oysterbench leaderboard serve` runs, without its log."""
    import uvicorn

    from oysterbench.hub.connections import server_settings
    from oysterbench_leaderboard.site.running import whole

    app = whole(BoardIndex(index, RecordStore(folder)))
    server = uvicorn.Server(
        uvicorn.Config(**{**server_settings(app, "127.0.0.1", 0, "on"), "log_level": "error", "log_config": None})
    )

    async def run() -> None:
        task = asyncio.create_task(server.serve())
        while not server.started:
            await asyncio.sleep(0.05)
        port.value = server.servers[0].sockets[0].getsockname()[1]
        ready.set()
        await task

    asyncio.run(run())


def first(board: str) -> Iterator[str]:
    """The first page, again and again."""
    while True:
        yield board


def mixed(board: str, client: int) -> Iterator[str]:
    """As visitors ask: of ten, six the first page, three one of the next twenty, one what nobody asked before."""
    draw = stream(3, b"", "benchmarks", "site", client)
    while True:
        kind = int(draw.integers(10))
        if kind < 6:
            yield board
        elif kind < 9:
            yield f"{board}?page={int(draw.integers(2, 22))}"
        else:
            yield f"{board}?q=method+{int(draw.integers(10**6))}"


def never(board: str, client: int) -> Iterator[str]:
    """Pages that nobody has asked for."""
    number = 100 + client * REQUESTS
    while True:
        number += 1
        yield f"{board}?page={number % 900 + 1}&sort={SORTS[number // 900 % len(SORTS)]}"


async def ask(port: int, pages: Iterator[str], requests: int, took: list[float], pauses: Iterator[float]) -> None:
    """One client, who pauses, s, before each request; times in ms."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for _, pause in zip(range(requests), pauses, strict=False):
        await asyncio.sleep(pause)
        start = time.perf_counter()
        writer.write(ASKED % next(pages).encode())
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        await reader.readexactly(int(length.split(b":")[1]))
        took.append(1e3 * (time.perf_counter() - start))
    writer.close()


def reading(client: int) -> Iterator[float]:
    """Pauses, s, of somebody who reads what he asked for."""
    draw = stream(4, b"", "benchmarks", "site", client)
    while True:
        yield float(draw.uniform(0.5, 1.5))


def measure(
    name: str,
    pid: int,
    port: int,
    requests: int,
    pages: Callable[[int], Iterator[str]],
    pauses: Callable[[int], Iterator[float]] = lambda client: itertools.repeat(0.0),
) -> None:
    """Print what clients wait, and what the server works."""
    took: list[float] = []

    async def everybody() -> None:
        await asyncio.gather(*(ask(port, pages(client), requests, took, pauses(client)) for client in range(CLIENTS)))

    cpu, start = cpu_s(pid), time.perf_counter()
    asyncio.run(everybody())
    rate = len(took) / (time.perf_counter() - start)
    work = 1e3 * (cpu_s(pid) - cpu) / len(took)
    slow = statistics.quantiles(took, n=20)[-1]
    print(
        f"{name}: median {statistics.median(took):.0f} ms, 95 %: {slow:.0f} ms, {rate:.0f} pages a second; "
        f"{work:.2f} CPU ms of the server for a page, {CLIENTS * work:.0f} ms for {CLIENTS} clients",
        flush=True,
    )


def cpu_s(pid: int) -> float:
    """CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    line = next(row for row in Path(f"/proc/{pid}/status").read_text().splitlines() if row.startswith("VmRSS"))
    return int(line.split()[1]) / 1e3


def main() -> None:
    """Fill, serve, ask."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=100_000)
    parser.add_argument("--requests", type=int, default=REQUESTS, help="of each client")
    parser.add_argument("--folder", type=Path, help="where records are kept between runs")
    parser.add_argument("--index", help="file or URL of the index; taken as it is where it is there")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="oysterbench-site-") as temporary:
        store = RecordStore(given.folder or Path(temporary))
        url = given.index or str(store.folder / "index.sqlite")
        index = BoardIndex(url, store)
        if not given.index or not Path(given.index).exists():
            made.fill(store, given.records)
            index.refresh()
        board = max(index.boards(), key=lambda info: info.entries)
        path = split_path(board.track, board.split)
        print(f"{board.entries} records on {path}, {sum(info.entries for info in index.boards())} in all", flush=True)
        ready, port = multiprocessing.Event(), multiprocessing.Value("i", 0)
        server = multiprocessing.Process(target=serve, args=(store.folder, url, ready, port), daemon=True)
        server.start()
        try:
            if not ready.wait(300):
                sys.exit("the server did not start")
            pid = server.pid or 0
            measure("readers", pid, port.value, given.requests, lambda client: mixed(path, client), reading)
            measure("the first page", pid, port.value, given.requests, lambda client: first(path))
            measure("a mix", pid, port.value, given.requests, lambda client: mixed(path, client + CLIENTS))
            measure("never asked before", pid, port.value, given.requests, lambda client: never(path, client))
            print(f"the server holds {memory_mb(pid):.0f} MB")
        finally:
            server.terminate()
            server.join()


if __name__ == "__main__":
    main()
