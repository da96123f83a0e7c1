"""Runs of methods on the workers of a cluster: each runs as it would here, and its files are brought back.

Only the job is sent to a worker. The worker reads the sequence from the same path as here, on a shared disk or from a
copy, and has the method or program installed.
"""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import write_atomically
from oysterbench.core.cluster import Results, find_withdrawn, run_on_cluster
from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.core.locks import scratch
from oysterbench.methods.inputs import Inputs
from oysterbench.methods.outcomes import OUTCOME, Job, Outcome
from oysterbench.methods.processes import Processes
from oysterbench.methods.runner import run_job

LOOK_S = 1.0
"""Interval at which a worker checks whether its job is still wanted, s."""

NEEDED = "workers need the sequence under the same path, and the same version of the method or program"
Hardware = Callable[[], Mapping[str, Any]]


@dataclass(frozen=True)
class Asked:
    """A job as sent to a worker. identity: the job's identity here, which has to be the same on the worker."""

    job: Job
    identity: Mapping[str, Any]

    def __repr__(self) -> str:
        return self.job.title


def run_remotely(
    jobs: Sequence[Job], root: Path, scheduler: str, most: int | None, hardware: Hardware
) -> Iterator[tuple[Job, Outcome]]:
    """Run jobs on the cluster of a scheduler, at most `most` at a time, and keep what they leave in `root`.

    Raises OysterbenchError where a worker lacks what a job needs, or has another version of it than is here.
    """
    asked = [Asked(job, job.identity) for job in jobs]
    found: Results[Asked, tuple[Outcome, dict[str, bytes]]]
    found = run_on_cluster(partial(run_asked, hardware=hardware), asked, scheduler, most)
    for each, (outcome, files) in found:
        kept = each.job.folder(root)
        shutil.rmtree(kept, ignore_errors=True)
        for name, data in files.items():
            write_atomically(kept / name, data)
        if outcome.finished:
            outcome.write(kept)
        yield each.job, outcome


def run_asked(asked: Asked, hardware: Hardware) -> tuple[Outcome, dict[str, bytes]]:
    """Run a job on a worker. Returns its outcome, and the content of the files that it left, by path in its folder."""
    job = asked.job
    try:
        for place in job.sequence.hidden:
            place.stat()
        here = job.identity
    except (OSError, MethodError) as error:
        raise OysterbenchError(f"worker {socket.gethostname()}: {error}; {NEEDED}") from None
    if here != asked.identity:
        raise OysterbenchError(f"worker {socket.gethostname()}: expected {asked.identity}, got {here}; {NEEDED}")
    with scratch() as folder:
        root, inputs, processes = folder / "results", folder / "inputs", Processes()
        inputs.mkdir()
        with _stopped_when_withdrawn(processes):
            outcome = run_job(job, root, Inputs(inputs, [job], processes), processes, hardware())
        kept = job.folder(root)
        files = [path for path in kept.rglob("*") if path.is_file() and path != kept / OUTCOME]
        return outcome, {str(path.relative_to(kept)): path.read_bytes() for path in files}


@contextmanager
def _stopped_when_withdrawn(processes: Processes) -> Iterator[None]:
    withdrawn, ended = find_withdrawn(), threading.Event()

    def watch() -> None:
        while not ended.wait(LOOK_S):
            if withdrawn():
                processes.stop()
                return

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        ended.set()
        watching.join()
