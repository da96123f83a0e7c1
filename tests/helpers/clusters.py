"""A Dask cluster of two workers on this machine, and whose worker a process is."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def two_workers(port: int = 0) -> Iterator[Any]:
    """Each with one thread, in a process of its own, and replaced where it dies. port: of the scheduler"""
    from distributed import LocalCluster

    options = {"scheduler_port": port, "dashboard_address": None}
    with LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster:
        yield cluster


def workers_of(cluster: Any) -> set[int]:
    """Their processes."""
    from distributed import Client

    with Client(cluster.scheduler_address, set_as_default=False) as client:
        return set(client.run(os.getpid).values())


def descends_from(pid: int, cluster: Any) -> int:
    """The worker that started a process, or whose child did."""
    workers = workers_of(cluster)
    while pid not in workers:
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    return pid
