"""A board under mixed load: `python -m tests.benchmarks.load [--minutes 30]`.

Fifty readers who look at a page for a second, five teams that send, wait and publish, and five attackers, each from an
address of its own. Prints what readers waited, whether a submission was lost or scored otherwise than once, and the
server's memory, descriptors and log over the time.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np

from oysterbench.core.streams import stream
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, find, log, submissions
from oysterbench_leaderboard.submissions.settings import load_settings
from tests.helpers import pool, served

READERS, TEAMS, ATTACKERS = 50, 5, 5
PAUSE_S = 20.0
"""Of a team, between what was published and what it sends next."""

PAGES = ("/boards/slam/pool-test", "/boards/slam/pool-test", "/", "/boards/slam/pool-test?q=carp", "/submit/new")


@dataclass
class Seen:
    """took: of readers' pages, ms, by page; answers: statuses, by who asked; sent: submission -> method, as answered;
    scores: submission -> score; server: (memory MB, descriptors, bytes of the log) every ten seconds"""

    took: dict[str, list[float]] = field(default_factory=dict)
    answers: Counter[tuple[str, int]] = field(default_factory=Counter)
    sent: dict[str, str] = field(default_factory=dict)
    scores: dict[str, str] = field(default_factory=dict)
    server: list[tuple[float, int, int]] = field(default_factory=list)


@dataclass
class Load:
    """Where the server is, until when it is loaded, and what was seen."""

    port: int
    until: float
    folder: Path
    seen: Seen = field(default_factory=Seen)

    def on(self) -> bool:
        return time.monotonic() < self.until

    @contextlib.asynccontextmanager
    async def connection(self, address: str) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port, local_addr=(address, 0))
        try:
            yield reader, writer
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def ask(self, address: str, method: str, path: str, body: bytes = b"", token: str = "") -> tuple[int, bytes]:
        """Status and body of an answer; 0 where the connection was closed."""
        head = [f"{method} {path} HTTP/1.1", "Host: board", "Connection: close", f"Content-Length: {len(body)}"]
        head += [f"Authorization: Bearer {token}"] if token else []
        head += ["Content-Type: application/zip"] if body else []
        try:
            async with self.connection(address) as (reader, writer):
                writer.write("\r\n".join(head).encode() + b"\r\n\r\n" + body)
                answer = await reader.read()
        except OSError:
            return 0, b""
        first, _, content = answer.partition(b"\r\n\r\n")
        return (int(first.split()[1]) if first else 0), content


async def read(load: Load, k: int) -> None:
    """A reader."""
    draw = stream(1, b"", "load", "reader", k)
    while load.on():
        await asyncio.sleep(draw.uniform(0.5, 1.5))
        page = PAGES[draw.integers(len(PAGES))]
        begun = time.perf_counter()
        status, _ = await load.ask(f"127.0.1.{k + 1}", "GET", page)
        load.seen.took.setdefault(page, []).append(1e3 * (time.perf_counter() - begun))
        load.seen.answers["readers", status] += 1


async def send(load: Load, k: int, token: str) -> None:
    """A team: one submission after the other, each published when it is scored."""
    address, number = f"127.0.2.{k + 1}", 0
    while load.on():
        method, number = f"team {k} number {number}", number + 1
        body = pool.answers(load.folder, case=k)  # the same again: its score has to be the same
        query = urlencode({"method": method, "split": "pool-test"})
        status, content = await load.ask(address, "POST", f"/api/submissions?{query}", body, token)
        load.seen.answers["teams", status] += 1
        if status == 201:
            made = json.loads(content)
            load.seen.sent[made["id"]] = method
            while made["state"] in ("queued", "running"):
                await asyncio.sleep(1.0)
                status, content = await load.ask(address, "GET", f"/api/submissions/{made['id']}", token=token)
                made = json.loads(content) if status == 200 else made
            load.seen.scores[made["id"]] = json.dumps(made.get("score"), sort_keys=True)
            await load.ask(address, "POST", f"/api/submissions/{made['id']}/publish", token=token)
        await asyncio.sleep(PAUSE_S)


async def half_open(load: Load, address: str, token: str) -> None:
    """Hundreds of requests whose headers never end."""

    async def one() -> None:
        async with load.connection(address) as (_, writer):
            writer.write(b"GET / HTTP/1.1\r\nHost: board\r\n")
            for letter in range(60):
                writer.write(f"X-{letter}: y\r\n".encode())
                await writer.drain()
                await asyncio.sleep(1.0)

    await asyncio.gather(*(one() for _ in range(100)), return_exceptions=True)


async def trickled(load: Load, address: str, token: str) -> None:
    """Forms of a thousand parts, a part a second, with a token that holds."""

    async def one() -> None:
        head = f"POST /api/submissions HTTP/1.1\r\nHost: board\r\nAuthorization: Bearer {token}\r\n"
        head += "Content-Type: multipart/form-data; boundary=x\r\nContent-Length: 99999999\r\n\r\n"
        async with load.connection(address) as (_, writer):
            writer.write(head.encode())
            for part in range(1000):
                name = f'--x\r\nContent-Disposition: form-data; name="files"; filename="{part}.tum"\r\n\r\n1 2 3\r\n'
                writer.write(name.encode())
                await writer.drain()
                await asyncio.sleep(0.2)

    await asyncio.gather(*(one() for _ in range(20)), return_exceptions=True)


async def guessing(load: Load, address: str, token: str) -> None:
    """Requests with wrong tokens, or none, as fast as they are answered."""
    for k in range(200):
        wrong = token[:-6] + f"{k:06d}" if k % 2 else ""
        status, _ = await load.ask(address, "POST", "/api/submissions?method=a&split=pool-test", b"PK", wrong)
        load.seen.answers["guessing", status] += 1


async def heavy(load: Load, address: str, token: str) -> None:
    """A small archive of a long text, and one that unpacks to what nobody has room for."""
    lines = b"".join(b"%d.5 1 2 3 0 0 0 1\n" % k for k in range(1_500_000))
    for text in (lines, bytes(300_000_000)):
        body = pool.zipped({"pool-01.tum": text})
        path = f"/api/submissions?{urlencode({'method': 'heavy', 'split': 'pool-test'})}"
        status, _ = await load.ask(address, "POST", path, body, token)
        load.seen.answers["heavy", status] += 1
    await asyncio.sleep(5.0)


async def forged(load: Load, address: str, token: str) -> None:
    """Masks with bytes that are no numbers of a class, and arrays that say more than they hold."""
    draw = stream(2, b"", "load", "forged", int(time.monotonic()))
    path = load.folder / "forged.npz"
    names = [name for k in range(len(pool.NAMES)) for name in pool.image_names(k)]
    masks: dict[str, Any] = {name: draw.integers(0, 4, (48, 64)).astype(np.uint8).view(bool) for name in names}
    np.savez(path, **masks)
    query = urlencode({"method": "forged", "split": "pool-masks"})
    status, _ = await load.ask(
        address, "POST", f"/api/submissions?{query}", pool.zipped({"forged.npz": path.read_bytes()}), token
    )
    load.seen.answers["forged", status] += 1
    await asyncio.sleep(5.0)


async def again(load: Load, what: Callable[[Load, str, str], Awaitable[None]], address: str, token: str) -> None:
    """An attacker, who begins anew whenever it was thrown out."""
    while load.on():
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await what(load, address, token)
        await asyncio.sleep(0.5)


async def watch(load: Load, pid: int) -> None:
    """What the server holds."""
    while load.on():
        status = Path(f"/proc/{pid}/status").read_text()
        memory = next(int(line.split()[1]) / 1e3 for line in status.splitlines() if line.startswith("VmRSS"))
        size = sum(p.stat().st_size for p in (load.folder / "private").glob("*") if p.is_file())
        load.seen.server.append((memory, len(os.listdir(f"/proc/{pid}/fd")), size))
        await asyncio.sleep(10.0)


async def run(load: Load, pid: int, tokens: list[str]) -> None:
    """All at once, to the end."""
    attacks = (half_open, trickled, guessing, heavy, forged)
    jobs = [read(load, k) for k in range(READERS)] + [send(load, k, tokens[k]) for k in range(TEAMS)]
    jobs += [watch(load, pid)]
    attackers = [
        asyncio.create_task(again(load, what, f"127.0.3.{k + 1}", tokens[TEAMS + k])) for k, what in enumerate(attacks)
    ]
    await asyncio.gather(*jobs)
    for attacker in attackers:
        attacker.cancel()
    await asyncio.gather(*attackers, return_exceptions=True)


def report(load: Load, database: SubmissionDatabase) -> None:
    """Print what was seen, and what the database holds of it."""
    seen = load.seen
    for page, took in sorted(seen.took.items()):
        p95 = statistics.quantiles(took, n=20)[-1]
        print(f"{page}: {len(took)} times, median {statistics.median(took):.0f} ms, 95 % {p95:.0f} ms")
    for (who, status), count in sorted(seen.answers.items()):
        print(f"{who}: {status or 'closed'}: {count}")
    with database.reading() as connection:
        states = {one.id: one.state for one in find(connection, submissions.c.id != "")}
        done = Counter(event["submission"] for event in log(connection, limit=10**6) if event["what"] == "done")
    lost = [one for one in seen.sent if states.get(one) != "done"]
    twice = [one for one in seen.sent if done[one] > 1]
    scores: dict[str, set[str]] = {}
    for one, score in seen.scores.items():
        scores.setdefault(seen.sent[one].split(" number")[0], set()).add(score)
    print(f"{len(seen.sent)} submissions: {len(lost)} lost, {len(twice)} scored twice; scores by team: {scores}")
    first, last = seen.server[min(6, len(seen.server) - 1)], seen.server[-1]
    most = tuple(max(values) for values in zip(*seen.server, strict=True))
    for what, *values in zip(("memory, MB", "descriptors", "private files, bytes"), first, last, most, strict=True):
        print("{}: {:.0f} after a minute, {:.0f} at the end, {:.0f} at most".format(what, *values))


def main() -> None:
    """Serve, load, look."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="oysterbench-load-") as temporary:
        folder = Path(temporary)
        served.lay(folder)
        database = SubmissionDatabase(load_settings(folder / "private"))
        tokens = [issue(database, f"team {k}") for k in range(TEAMS + ATTACKERS)]
        with served.running(folder) as server:
            load = Load(server.port, time.monotonic() + 60 * given.minutes, folder)
            asyncio.run(run(load, server.process.pid, tokens))
            report(load, database)
        database.close()


if __name__ == "__main__":
    main()
