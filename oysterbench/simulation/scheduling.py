"""Where jobs run: in this process, in several processes of this machine, or on a cluster (`core.cluster`). Each yields
the results of its jobs; only the caller writes files."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import ModuleType
from typing import TypeVar

from oysterbench.core.cluster import AHEAD, Results
from oysterbench.core.errors import OysterbenchError

J = TypeVar("J")
R = TypeVar("R")

TERMINATED = 128 + signal.SIGTERM


class Terminated(OysterbenchError):
    """Raised on SIGTERM while worker processes are running."""

    exit_code = TERMINATED


def run_here(task: Callable[[J], R], jobs: Sequence[J]) -> Results[J, R]:
    """Run jobs in this process."""
    for job in jobs:
        yield job, task(job)


def run_in_processes(
    task: Callable[[J], R], jobs: Sequence[J], workers: int, warm_up: Callable[[], None]
) -> Results[J, R]:
    """Run jobs in several processes; one runs `warm_up` before the jobs start.

    Raises OysterbenchError when a worker is killed, or this process receives SIGTERM.
    """
    with _ended_in_order():
        yield from _run_in_processes(task, jobs, workers, warm_up)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Make SIGTERM raise Terminated, so that workers are ended, and their semaphores freed, on the way out."""
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
    raise Terminated("terminated; finished work is kept, and the same command resumes from there")


def _run_in_processes(
    task: Callable[[J], R], jobs: Sequence[J], workers: int, warm_up: Callable[[], None]
) -> Results[J, R]:
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)), mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    try:
        with _scripts_left_out():
            warm = pool.submit(warm_up)
        warm.result()
        pending: dict[Future[R], J] = {}
        queue = iter(jobs)
        while True:
            with _scripts_left_out():
                while len(pending) < AHEAD * workers and (job := next(queue, None)) is not None:
                    pending[pool.submit(task, job)] = job
            if not pending:
                break
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                yield pending.pop(future), future.result()
    except BrokenProcessPool:
        raise OysterbenchError(
            "a render worker was killed (out of memory?); finished frames are kept: run the same command "
            "again, with fewer --workers"
        ) from None
    except BaseException:
        for process in list(pool._processes.values()):  # on Ctrl-C do not wait for the frames under way
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _scripts_left_out() -> Iterator[None]:
    """Keep new processes from running the user's script again, which would start processes in turn: jobs need nothing
    from it. So a script may render without `if __name__ == "__main__"`."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


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


_ONE_AT_A_TIME = threading.Lock()


def run_alone(task: Callable[[J], R], job: J) -> R:
    """Run a job on a cluster's worker, one at a time: its threads share state that jobs need for themselves."""
    with _ONE_AT_A_TIME:
        return task(job)
