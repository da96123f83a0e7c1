"""Jobs on a Dask cluster (plain hosts, Slurm or Kubernetes), whose results travel back to the caller.

Only the caller writes files. So a worker that dies loses only the jobs that it was running, and results do not depend
on where or in which order they were computed.
"""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError
from importlib import import_module
from typing import Any, TypeVar

from oysterbench.core.errors import OysterbenchError

J = TypeVar("J")
R = TypeVar("R")

AHEAD = 2
"""Jobs submitted per worker thread: the next is ready when one finishes, yet few results wait to be written to disk."""

LEAST_AHEAD = 8  # jobs submitted at least, even before the cluster has any worker
DEATHS = 3  # workers lost to one job, beyond those that the scheduler itself tolerates, before the job is blamed
CONNECT_S = 15

Results = Generator[tuple[J, R], None, None]
"""Each job with its result, in the order of completion."""


def connect(address: str) -> Any:
    """Return a client (`distributed.Client`) of the scheduler at an address, for the caller to close. Raises
    OysterbenchError where none answers, or Dask is not installed."""
    try:
        dask: Any = import_module("distributed")  # untyped
    except ImportError:
        raise OysterbenchError("--scheduler needs Dask: pip install 'oysterbench[cluster]'") from None
    try:
        return dask.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OysterbenchError(
            f"--scheduler {address}: no Dask scheduler answers ({error}); expected an address as `dask scheduler` "
            "prints it, such as tcp://10.0.0.1:8786"
        ) from None


def new_key() -> str:
    """Return a unique key for a task: Dask would derive one from the arguments, which must not leak into logs."""
    return f"oysterbench-{uuid.uuid4().hex}"


def run_on_cluster(task: Callable[[J], R], jobs: Sequence[J], address: str, most: int | None = None) -> Results[J, R]:
    """Run jobs on the workers of a Dask scheduler, including workers that join or leave meanwhile.

    most: limit on jobs submitted at a time. A job whose worker is lost is run by another. Raises OysterbenchError when
    the scheduler cannot be reached or is lost, and when a job kills its workers again and again.
    """
    client = connect(address)
    dask: Any = import_module("distributed")
    deaths: Counter[str] = Counter()
    with client:
        pending: dict[str, J] = {}
        done = dask.as_completed(loop=client.loop)
        queue = iter(jobs)

        def submit(job: J) -> None:
            name = new_key()
            pending[name] = job
            done.add(client.submit(task, job, key=name, pure=False))

        try:
            while True:
                ahead = most or max(LEAST_AHEAD, AHEAD * sum(client.nthreads().values()))
                while len(pending) < ahead and (job := next(queue, None)) is not None:
                    submit(job)
                if not pending:
                    return
                future = next(done)
                job = pending.pop(str(future.key))
                try:
                    data = future.result()
                except dask.KilledWorker:
                    deaths[repr(job)] += 1
                    if deaths[repr(job)] >= DEATHS:
                        raise OysterbenchError(
                            f"workers of {address} keep dying at {job} (out of memory?); finished work is kept: run "
                            "the same command again, on workers with more memory"
                        ) from None
                    submit(job)
                    continue
                future.release()
                yield job, data
        except (dask.comm.CommClosedError, CancelledError, OSError, TimeoutError) as error:
            raise OysterbenchError(
                f"the scheduler {address} was lost ({error}); finished work is kept: run the same command again when "
                "it is back"
            ) from None


def find_withdrawn() -> Callable[[], bool]:
    """On a worker, in the thread of a task: return a function that says, in any thread, whether the task is no longer
    wanted because its caller has cancelled it or is gone."""
    worker: Any = import_module("distributed.worker")
    state, key = worker.get_worker().state, worker.thread_state.key
    return lambda: getattr(state.tasks.get(key), "state", "") != "executing"
