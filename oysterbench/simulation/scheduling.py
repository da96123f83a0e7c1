"""Where jobs run: in this process, in several of this machine, or on a Dask cluster. Each gives the result of its job.

Only the caller writes files. So a worker needs no disk and no shared folder, one that dies takes nothing along but the
jobs that it was at, and results do not depend on where and in which order they were made.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import uuid
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

from oysterbench.core.errors import OysterbenchError

J = TypeVar("J")
R = TypeVar("R")

AHEAD = 2
"""Jobs handed out per worker: the next is there when one is done, and few results wait for the disk at a time."""

LEAST_AHEAD = 8  # jobs that a cluster is given before it has any worker
DEATHS = 3  # of workers at one job, beyond those that the scheduler forgives by itself, before the job is to blame
CONNECT_S = 15

TERMINATED = 128 + signal.SIGTERM

Results = Generator[tuple[J, R], None, None]
"""Each job, with what it gave, in the order in which they are done."""


class Terminated(OysterbenchError):
    """SIGTERM came while processes were at work."""

    exit_code = TERMINATED


def run_here(task: Callable[[J], R], jobs: Sequence[J]) -> Results[J, R]:
    """Run jobs in this process."""
    for job in jobs:
        yield job, task(job)


def run_in_processes(
    task: Callable[[J], R], jobs: Sequence[J], workers: int, warm_up: Callable[[], None]
) -> Results[J, R]:
    """Run jobs in so many processes; one runs `warm_up` before the others begin.

    Raises OysterbenchError when a process is killed, or this one is told to end.
    """
    with _ended_in_order():
        yield from _run_in_processes(task, jobs, workers, warm_up)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """SIGTERM raises Terminated: processes are ended, and their semaphores freed, on the way out."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminated)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminated(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough
    raise Terminated("terminated; what was finished is kept, and the same command goes on from there")


def _run_in_processes(
    task: Callable[[J], R], jobs: Sequence[J], workers: int, warm_up: Callable[[], None]
) -> Results[J, R]:
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)), mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        pool.submit(warm_up).result()
        pending: dict[Future[R], J] = {}
        queue = iter(jobs)
        while True:
            while len(pending) < AHEAD * workers and (job := next(queue, None)) is not None:
                pending[pool.submit(task, job)] = job
            if not pending:
                break
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                yield pending.pop(future), future.result()
    except BrokenProcessPool:
        raise OysterbenchError(
            "a render worker was killed (out of memory?); the frames that were finished are kept: run the same command "
            "again, with fewer --workers"
        ) from None
    except BaseException:
        for process in list(pool._processes.values()):  # on Ctrl-C do not wait for the frames under way
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    parent = multiprocessing.parent_process()

    def leave_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=leave_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)


def run_on_cluster(task: Callable[[J], R], jobs: Sequence[J], address: str) -> Results[J, R]:
    """Run jobs on the workers of a Dask scheduler, those that come and go meanwhile included; bytes travel back.

    A job whose worker is lost is run by another. Raises OysterbenchError when the scheduler cannot be reached or is
    lost, and when a job kills its workers again and again.
    """
    try:
        dask: Any = import_module("distributed")  # which is not typed
    except ImportError:
        raise OysterbenchError("--scheduler needs Dask: pip install 'oysterbench[cluster]'") from None
    try:
        client = dask.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OysterbenchError(
            f"--scheduler {address}: no Dask scheduler answers ({error}); expected an address as `dask scheduler` "
            "prints it, such as tcp://10.0.0.1:8786"
        ) from None
    deaths: Counter[str] = Counter()
    with client:
        pending: dict[str, J] = {}
        done = dask.as_completed(loop=client.loop)
        queue = iter(jobs)

        def submit(job: J) -> None:
            # A name of its own: Dask's would be made from the arguments, which hold what no log should tell.
            name = f"oysterbench-{uuid.uuid4().hex}"
            pending[name] = job
            future = client.submit(_on_cluster, task, job, key=name, pure=False)
            done.add(future)

        try:
            while True:
                ahead = max(LEAST_AHEAD, AHEAD * sum(client.nthreads().values()))
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
                            f"workers of {address} die again and again at {job} (out of memory?); the frames that were "
                            "finished are kept: run the same command again, on workers with more memory"
                        ) from None
                    submit(job)
                    continue
                future.release()
                yield job, data
        except (dask.comm.CommClosedError, CancelledError, OSError, TimeoutError) as error:
            raise OysterbenchError(
                f"the scheduler {address} was lost ({error}); the frames that were finished are kept: run the same "
                "command again when it is back"
            ) from None


_ONE_AT_A_TIME = threading.Lock()


def _on_cluster(task: Callable[[J], R], job: J) -> R:
    """A job on a cluster's worker, whose threads share what the job is made with: one at a time, as in a process."""
    with _ONE_AT_A_TIME:
        return task(job)
