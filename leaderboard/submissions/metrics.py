"""Prometheus metrics of a submission server, at a separate address that is not for the public: how many submissions
wait and for how long, what failed and why, the space on the disks, the sandbox in force, and the memory and open files
of the process. Everything is looked up on request."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector, start_http_server
from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func, select

from oysterbench.core.errors import ResultError
from oysterbench.version import VERSION
from oysterbench_leaderboard.submissions.database import submissions
from oysterbench_leaderboard.submissions.reading.refusals import FAILED
from oysterbench_leaderboard.submissions.sandbox.sandbox import in_force
from oysterbench_leaderboard.submissions.service import Service

CAUSES = {reason: cause for cause, reason in FAILED.items()}
STATES = ("queued", "running", "done", "failed", "withdrawn")


class Numbers(Collector):
    """Metrics of a service."""

    def __init__(self, service: Service) -> None:
        self.service = service

    def collect(self) -> Iterator[Any]:
        """Yield the families of metrics."""
        c = submissions.c
        with self.service.database.reading() as connection:
            counts = connection.execute(select(c.state, func.count()).group_by(c.state))
            states = {state: count for state, count in counts}  # noqa: C416 (a row is no pair for the type checker)
            failed = select(c.reason, func.count()).where(c.state == "failed").group_by(c.reason)
            causes: Counter[str] = Counter()
            for reason, count in connection.execute(failed):
                causes[next((cause for text, cause in CAUSES.items() if reason.startswith(text)), "refused")] += count
            oldest = connection.execute(select(func.min(c.created_s)).where(c.state == "queued")).scalar_one()
        family = GaugeMetricFamily("oysterbench_submissions", "Submissions by state.", labels=["state"])
        for state in STATES:
            family.add_metric([state], states.get(state, 0))
        yield family
        waited = 0.0 if oldest is None else max(0.0, self.service.clock() - oldest)
        yield GaugeMetricFamily(
            "oysterbench_queue_oldest_seconds", "Waiting time of the first submission in the queue.", waited
        )
        family = GaugeMetricFamily("oysterbench_failures", "Submissions that failed, by cause.", labels=["cause"])
        for cause in FAILED:
            family.add_metric([cause], causes[cause])
        yield family
        folders = {"submissions": self.service.settings.folder, "board": self.service.store.folder}
        for name, index in (("total", 0), ("free", 2)):
            family = GaugeMetricFamily(f"oysterbench_disk_{name}_bytes", "Of the disk of a folder.", labels=["folder"])
            for folder, path in folders.items():
                if path.exists():
                    family.add_metric([folder], shutil.disk_usage(path)[index])
            yield family
        yield InfoMetricFamily("oysterbench", "Version and sandbox.", {"version": VERSION, "sandbox": in_force()})


def serve_metrics(service: Service, place: str) -> Callable[[], None]:
    """Serve the metrics at `place`, HOST:PORT; return a function that stops this. Raises ResultError where the address
    is invalid or in use."""
    host, _, port = place.rpartition(":")
    registry = CollectorRegistry(auto_describe=False)
    registry.register(Numbers(service))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    try:
        server, thread = start_http_server(int(port), host or "127.0.0.1", registry)
    except (OSError, ValueError, OverflowError) as error:
        raise ResultError(f"--metrics: expected HOST:PORT that is free, got {place!r}: {error}") from None

    def stop() -> None:
        server.shutdown()
        server.server_close()
        thread.join()

    return stop
