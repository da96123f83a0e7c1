"""How long an index of many records takes: `python -m tests.benchmarks.leaderboard [--records 100000] [--folder DIR]`.

Makes records of a realistic size (eight sequences with all metrics of the evaluator, about 40 kB each) on several
boards, if the folder does not hold them yet; then prints what a rebuild, a refresh and pages take. CPU seconds of the
workers are those of processes that have ended; on a busy machine they say more than the clock.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from oysterbench.core.streams import stream
from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.evaluate.slam.metrics import SLAM
from oysterbench.evaluate.slam.settings import SlamSettings
from oysterbench.hub.canonical import sha256
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore

SEQUENCES = tuple(f"val-{k:02d}" for k in range(1, 9))
BOARDS = 8
"""The first holds half of the records, the next half of the rest, and so on."""

CLIENTS = 50
PAGES = 20  # of each client
CHUNK = 500


@cache
def template(board: int) -> dict[str, Any]:
    """A whole record of a board, as plain values."""
    results = tuple(
        ResultRecord(
            track="slam",
            split=f"split-{board}",
            split_digest=f"{board:064x}",
            sequence=name,
            method="method",
            metrics=dict.fromkeys(SLAM, 1.0),
            conditions=dict.fromkeys(sorted(set(CONDITIONS) - {"disturbance", "strength"}), 1.0),
            settings=SlamSettings().as_dict(),
            info={"settings": {f"option_{i}": float(i) for i in range(60)}, "run": {"limit_s": 600.0}},
            evaluator_version="slam 3",
            hardware={"cpu": "a processor", "cores": 2},
            created="2026-11-20T12:00:00Z",
        )
        for name in SEQUENCES
    )
    return Record(method="method", team="team", tier="scored", results=results).to_dict()


def made(k: int) -> bytes:
    """The record of that number, as canonical JSON: a method of some skill, scored on all sequences."""
    draw = stream(7, b"", "benchmarks", "leaderboard", k)
    values = template(min(BOARDS - 1, (k ^ (k + 1)).bit_length() - 1))
    skill = draw.uniform(0.1, 0.95)
    values |= {"method": f"method {k}", "team": f"team {k % 997}", "created": "2026-11-20T12:00:00Z"}
    for result in values["results"]:
        result["method"] = values["method"]
        result["metrics"] = dict(zip(SLAM, draw.uniform(0, 10, len(SLAM)).tolist(), strict=True))
        result["metrics"]["score"] = float(np.clip(skill + draw.normal(0, 0.08), 0, 1))
        result["metrics"]["coverage"] = float(draw.uniform(0.8, 1))
    return orjson.dumps(values, option=orjson.OPT_SORT_KEYS | orjson.OPT_APPEND_NEWLINE)


def write(job: tuple[Path, int, int]) -> None:
    """Records of some numbers, without waiting for the disk at each."""
    folder, start, end = job
    for k in range(start, end):
        data = made(k)
        (folder / "records" / f"{sha256(data)}.json").write_bytes(data)


def fill(store: RecordStore, count: int) -> None:
    """Make what is missing."""
    (store.folder / "records").mkdir(parents=True, exist_ok=True)
    if len(store.digests()) >= count:
        return
    jobs = [(store.folder, k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
    with ProcessPoolExecutor() as pool:
        for done, _ in enumerate(pool.map(write, jobs), start=1):
            if done % 20 == 0:
                print(f"made {done * CHUNK} of {count} records", file=sys.stderr)


def cpu_s() -> float:
    """Of this process and of children that have ended."""
    return sum(os.times()[:4])


def timed(name: str, action: object) -> None:
    """Print what an action takes by the clock and in CPU seconds."""
    clock, cpu = time.perf_counter(), cpu_s()
    action()  # type: ignore[operator]
    print(f"{name}: {time.perf_counter() - clock:.2f} s, {cpu_s() - cpu:.2f} CPU s", flush=True)


def query_ms(index: BoardIndex, board: str, query: Query, times: int = 20) -> str:
    """Median and 95th percentile of a page, one client."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        index.page(board, query)
        took.append(1e3 * (time.perf_counter() - start))
    return f"{statistics.median(took):.1f} ms, 95 %: {statistics.quantiles(took, n=20)[-1]:.1f} ms"


def clients_ms(index: BoardIndex, board: str) -> str:
    """The same with many clients at once, each asking for page after page."""
    took: list[float] = []

    def ask(client: int) -> None:
        for k in range(PAGES):
            start = time.perf_counter()
            index.page(board, Query(page=1 + (client * PAGES + k) % 1000))
            took.append(1e3 * (time.perf_counter() - start))

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(CLIENTS)]
    start = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    rate = len(took) / (time.perf_counter() - start)
    slow = statistics.quantiles(took, n=20)[-1]
    return f"{statistics.median(took):.0f} ms, 95 %: {slow:.0f} ms, {rate:.0f} pages a second"


def main() -> None:
    """Fill, rebuild, ask."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=100_000)
    parser.add_argument("--folder", type=Path, help="where records are kept between runs")
    parser.add_argument("--index", help="file or URL of the index")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="oysterbench-board-") as temporary:
        store = RecordStore(given.folder or Path(temporary))
        fill(store, given.records)
        size = sum(entry.stat().st_size for entry in os.scandir(store.folder / "records"))
        print(f"{len(store.digests())} records of {size / len(store.digests()) / 1e3:.1f} kB", flush=True)
        index = BoardIndex(given.index or store.folder / "index.sqlite", store)
        timed("rebuild", index.rebuild)
        timed("refresh, nothing new", index.refresh)
        boards = sorted(index.boards(), key=lambda board: -board.entries)
        print("boards of", ", ".join(str(board.entries) for board in boards))
        first, last = boards[0].id, boards[-1].id
        print("page by rank:", query_ms(index, first, Query()))
        print("page 500 by rank:", query_ms(index, first, Query(page=500)))
        print("page by a column:", query_ms(index, first, Query(sort="ate_percent", descending=True)))
        print("search:", query_ms(index, first, Query(text="method 4711")))
        print("page of the smallest board:", query_ms(index, last, Query()))
        print(f"{CLIENTS} clients:", clients_ms(index, first))
        write((store.folder, given.records * 2, given.records * 2 + 1))  # even numbers are on the largest board
        timed("refresh, one record more on the largest board", index.refresh)
        (store.folder / "records" / f"{sha256(made(given.records * 2))}.json").unlink()


if __name__ == "__main__":
    main()
