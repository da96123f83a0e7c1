"""Submissions over HTTP into PostgreSQL and an S3 store, and scored by two workers of a Dask cluster.

python -m tests.benchmarks.submissions [SENT] [SCORED]

Prints how many submissions a second are taken in, with their reading and without it; the server's processor time for
each; and how fast some of them are scored, and whether the workers ever wait.
"""

from __future__ import annotations

import contextlib
import http.client
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch
from urllib.parse import urlencode

from oysterbench.version import VERSION
from oysterbench_leaderboard.submissions import queue
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.database import change, find, submissions
from oysterbench_leaderboard.submissions.sandbox import sandbox
from tests.helpers import pool, served
from tests.helpers.clusters import two_workers
from tests.helpers.postgres import running_postgres
from tests.helpers.waiting import until

SENDERS = 8
LIMITS: dict[str, Any] = {"per_day": 10**6, "per_split": 10**6, "reads_per_day": 10**6}
AT_ONCE = {"uploads_at_once": SENDERS, "uploads_of_team": SENDERS, "uploads_of_address": SENDERS}


@contextlib.contextmanager
def running_s3() -> Iterator[str]:
    """The URL of a folder in a store that is new, which the environment leads to."""
    port = served.free_port()
    values = {"ENDPOINT_URL": f"http://127.0.0.1:{port}", "ACCESS_KEY_ID": "x", "SECRET_ACCESS_KEY": "x"}
    os.environ.update({f"AWS_{key}": value for key, value in {**values, "DEFAULT_REGION": "us-east-1"}.items()})
    command = [sys.executable, "-m", "moto.server", "-p", str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    import fsspec

    def bucket() -> bool:
        with contextlib.suppress(Exception):  # until it is up
            fsspec.filesystem("s3", skip_instance_cache=True).mkdir("board")
            return True
        return False

    try:
        until(bucket, server)
        yield "s3://board/estimates"
    finally:
        server.terminate()
        server.wait()


def send(server: served.Server, token: str, bodies: list[bytes], method: str) -> float:
    """Submissions a second that are taken in, of so many, by SENDERS connections that stay open."""
    numbers = itertools.count()

    def sender(_: int) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=600)
        while (number := next(numbers)) < len(bodies):
            query = urlencode({"method": method, "split": "pool-test"})
            headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/zip"}
            connection.request("POST", f"/api/submissions?{query}", bodies[number], headers)
            answer = connection.getresponse()
            data = answer.read()
            assert answer.status == 201, data

    begun = time.perf_counter()
    with ThreadPoolExecutor(SENDERS) as pool:
        list(pool.map(sender, range(SENDERS)))
    return len(bodies) / (time.perf_counter() - begun)


def cpu_s(pid: int) -> float:
    """Processor time of a process and of its children, those that it has waited for included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    children = [path.read_text().split() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    own_s = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return own_s + sum(cpu_s(int(child)) for some in children for child in some)


def timed(task: queue.Task, log: Path) -> sandbox.Ended:
    """On a worker: a scoring, and when it began and ended."""
    begun = time.time()
    ended = queue.perform_remotely(task, VERSION)
    with open(log, "a") as file:
        file.write(f"{begun} {time.time()}\n")
    return ended


def score(service: Any, address: str, log: Path) -> tuple[float, float]:
    """Scorings a second of all that waits, and what part of the time the two workers were at it."""

    def enough() -> bool:
        with service.database.reading() as connection:
            return not find(connection, submissions.c.state.in_(("queued", "running")))

    @contextlib.contextmanager
    def engine() -> Iterator[queue.Engine]:
        with queue.on_cluster(address) as found:
            yield replace(found, work=partial(timed, log=log))

    with service.database.alone() as connection:
        queue.dispatch(service, connection, engine(), enough)
    times = [tuple(map(float, line.split())) for line in log.read_text().splitlines()]
    span = max(ended for _, ended in times) - min(begun for begun, _ in times)
    return len(times) / span, sum(ended - begun for begun, ended in times) / (2 * span)


def main(sent: int = 200, scored: int = 16) -> None:
    """Print all."""
    with (
        tempfile.TemporaryDirectory() as place,
        running_postgres() as postgres,
        running_s3() as estimates,
        contextlib.ExitStack() as stack,
    ):
        folder = Path(place)
        settings = {"database": postgres, "estimates": estimates, "scheduler": "tcp://127.0.0.1:9", **LIMITS, **AT_ONCE}
        served.lay(folder, **settings)
        service = stack.enter_context(contextlib.closing(served.make_service(folder)))
        token = issue(service.database, "bench")
        bodies = [pool.answers(folder, case) for case in range(sent)]
        for reading in (False, True):
            server = served.Server(folder)
            os.environ["READING"] = str(int(reading))
            module = [sys.executable, "-m", "tests.benchmarks.submissions", "serve", place, str(server.port)]
            server.process = subprocess.Popen(module)
            until(server.alive, server.process)
            before = cpu_s(server.process.pid)
            rate = send(server, token, bodies, f"reading {reading}")
            cost = (cpu_s(server.process.pid) - before) / sent
            server.stop()
            words = "read, and taken in" if reading else "taken in, unread"
            print(f"{words}: {rate:.1f} a second; {1000 * cost:.0f} ms of processor time each", flush=True)
        with service.database.writing() as connection:
            for one in find(connection, submissions.c.state == "queued")[scored:]:
                change(connection, one.id, service.now(), state="withdrawn")
        with two_workers() as cluster:
            rate, busy = score(service, cluster.scheduler_address, folder / "scorings")
        print(f"scored: {rate:.2f} a second, by two workers that are at it {100 * busy:.0f} % of the time")


def serve(folder: str, port: str) -> None:
    """A server, which with READING=0 takes what it is sent for poses."""
    unread = patch.object(sandbox, "check", lambda *args: {"kind": "poses"})
    with contextlib.nullcontext() if os.environ["READING"] == "1" else unread:
        served.serve(Path(folder), int(port))


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(*sys.argv[2:])
    else:
        main(*map(int, sys.argv[1:]))
