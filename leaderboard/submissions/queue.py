"""The dispatcher: hands queued submissions to threads of this process or to a Dask cluster, and records the outcomes.

The state is in the database. Of all servers that share it, one dispatches, under a lock that is released when it ends;
what a vanished dispatcher had started is started again. Workers know no database: each is given a Task, and answers. An
outcome counts only for the attempt it belongs to: one that arrives late, or twice, changes nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial

from sqlalchemy import Connection, select

from oysterbench.core.cluster import AHEAD, connect, find_withdrawn
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.names import listed
from oysterbench.version import VERSION
from oysterbench_leaderboard.publishing.truths import other_truth
from oysterbench_leaderboard.submissions.database import Submission, change, find, log_event, submissions
from oysterbench_leaderboard.submissions.estimates import Estimates
from oysterbench_leaderboard.submissions.reading.refusals import FAILED
from oysterbench_leaderboard.submissions.sandbox import sandbox
from oysterbench_leaderboard.submissions.sandbox.sandbox import Allowance, Ended, Job, Stopped
from oysterbench_leaderboard.submissions.service import Service

POLL_S = 1.0
"""Interval of looking for submissions queued by another host, and of checking whether another one still dispatches."""


@dataclass(frozen=True)
class Task:
    """One scoring task. job: without the path of the upload, which `estimates` has under its digest."""

    estimates: Estimates
    digest: str
    job: Job
    allowance: Allowance


def perform(task: Task, stopped: Callable[[], bool] = lambda: False) -> Ended:
    """Score a submission in a sandbox on this machine. Raises Stopped where `stopped` returned True first."""
    with task.estimates.opened(task.digest) as path:
        return sandbox.run(replace(task.job, path=str(path)), task.allowance, stopped)


def perform_remotely(task: Task, version: str) -> Ended:
    """Do the same on a worker of a cluster. Raises OysterbenchError where its version is not `version`."""
    if version != VERSION:
        raise OysterbenchError(f"a worker has oysterbench {VERSION}, and was asked by {version}: install one version")
    return perform(task, find_withdrawn())


@dataclass(frozen=True)
class Engine:
    """What tasks are handed to. room: returns the number of tasks that it takes at a time; work: performs one"""

    executor: Executor
    room: Callable[[], int]
    work: Callable[[Task], Ended]


@contextmanager
def in_threads(count: int) -> Iterator[Engine]:
    """Engine of `count` concurrent sandboxes on this machine, which are stopped at the end of the block."""
    ended = threading.Event()
    with ThreadPoolExecutor(count, "worker") as pool:
        try:
            yield Engine(pool, lambda: count, partial(perform, stopped=ended.is_set))
        finally:
            ended.set()


@contextmanager
def on_cluster(address: str) -> Iterator[Engine]:
    """Engine of all workers that a Dask scheduler has at the time."""
    with connect(address) as client:
        executor = client.get_executor(pure=False)
        try:
            yield Engine(
                executor,
                lambda: AHEAD * sum(client.nthreads().values()),
                partial(perform_remotely, version=VERSION),
            )
        finally:
            executor.shutdown(wait=False)


def recover(service: Service, connection: Connection) -> None:
    """Requeue the submissions that a vanished dispatcher had started."""
    with connection.begin():
        # Locked, so that what its team withdraws meanwhile is not queued again.
        for lost in find(connection, submissions.c.state == "running", lock=True):
            change(connection, lost.id, service.now(), state="queued")
            log_event(connection, service.now(), "dispatcher", "queued", lost.id, "its server was gone")


def claim(service: Service, connection: Connection) -> Submission | None:
    """Mark the next queued submission as running and return it; those with the most attempts come last. None where none
    is queued."""
    c, at = submissions.c, service.now()
    with connection.begin():
        waiting = select(submissions).where(c.state == "queued").order_by(c.attempt, c.created_s, c.id).limit(1)
        row = connection.execute(waiting).mappings().first()
        if row is None:
            return None
        mine = Submission(**row)
        mine = replace(mine, state="running", attempt=mine.attempt + 1, updated=at)
        if not change(connection, mine.id, at, c.state == "queued", state="running", attempt=mine.attempt):
            return None
        log_event(connection, at, "dispatcher", "running", mine.id, f"attempt {mine.attempt}")
        return mine


def finish(
    service: Service, connection: Connection, mine: Submission, state: str, record: str = "", reason: str = ""
) -> bool:
    """Record the end of an attempt; return whether that attempt was still the current one."""
    guard = (submissions.c.state == "running", submissions.c.attempt == mine.attempt)
    at = service.now()
    with connection.begin():
        ended = change(connection, mine.id, at, *guard, state=state, record=record, reason=reason)
        if ended:
            log_event(connection, at, "dispatcher", state, mine.id, reason or record)
        return ended


def task_of(service: Service, mine: Submission) -> Task | None:
    """Task that scores a submission; None where its split is no longer served."""
    served = service.catalogue.splits.get(mine.split)
    wanted = None if served is None else served.wanted.get(mine.track)
    if served is None or wanted is None:
        return None
    settings = service.settings
    truth = {name: str(path) for name, path in served.truth.items()}
    job = Job("", wanted, settings.limits, service.hidden, truth, mine.method, mine.created)
    return Task(service.estimates, mine.digest, job, sandbox.scoring(settings))


def outcome_of(service: Service, mine: Submission, ended: Ended) -> dict[str, str]:
    """Outcome of a scoring as values for `finish`: the state, with the record or the reason."""
    if ended.stderr:
        service.log.info("scoring %s, attempt %d: %s", mine.id, mine.attempt, ended.stderr)
    if ended.answer is None:
        if ended.cause == "crash" and mine.attempt < service.settings.attempts:
            return {"state": "queued"}
        return {"state": "failed", "reason": FAILED[ended.cause]}
    reported = mine.kind == "results"
    if "refused" in ended.answer:  # reported results are of public splits: their reasons reveal no hidden ground truth
        return {"state": "failed", "reason": ended.answer["refused"]["reason"] if reported else FAILED["refused"]}
    try:
        record = service.build(mine, ended.answer)
    except OysterbenchError as error:
        service.log.info("scoring %s: %s", mine.id, error)
        return {"state": "failed", "reason": FAILED["crash"]}
    failures = {result.sequence: result.failure for result in record.results if result.failure is not None}
    if len(failures) == len(record.results) and not reported:
        of: dict[str, list[str]] = {}
        for sequence, failure in failures.items():
            of.setdefault(failure, []).append(sequence)
        why = "; ".join(f"{listed(sequences)}: {failure}" for failure, sequences in list(of.items())[:3])
        return {"state": "failed", "reason": FAILED["none"] + why}
    if reported and (odd := other_truth(service.store, [record])):
        return {"state": "failed", "reason": odd}
    return {"state": "done", "record": service.scored.add(record)}


class Dispatcher:
    """A thread that dispatches whenever no other server does, until it is stopped.

    workers: number of concurrent scorings, in threads; scheduler: address of a Dask cluster to use instead
    """

    def __init__(self, service: Service, workers: int | None = None, scheduler: str = "") -> None:
        self.service = service
        address = scheduler or service.settings.scheduler
        count = workers or service.settings.workers
        self._engine = partial(on_cluster, address) if address else partial(in_threads, count)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="dispatcher", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread; submissions being scored go back into the queue."""
        self._stop.set()
        self.service.wake.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                with self.service.database.alone() as connection:
                    if connection is not None:
                        dispatch(self.service, connection, self._engine(), self._stop.is_set)
            except OysterbenchError as error:
                self.service.log.error("the dispatcher: %s", error)
            except Exception:  # from the database or the cluster, which may recover
                self.service.log.exception("the dispatcher failed")
            self._stop.wait(POLL_S)


def dispatch(
    service: Service, connection: Connection, with_engine: AbstractContextManager[Engine], enough: Callable[[], bool]
) -> None:
    """Hand out queued submissions and record their outcomes, until `enough()`.

    connection: from `SubmissionDatabase.alone`
    """
    recover(service, connection)
    running: dict[Future[Ended], Submission] = {}
    with with_engine as engine:
        while not enough():
            service.wake.clear()
            while len(running) < engine.room() and (mine := claim(service, connection)) is not None:
                task = task_of(service, mine)
                if task is None:
                    finish(service, connection, mine, "failed", reason=FAILED["absent"])
                    continue
                future = engine.executor.submit(engine.work, task)
                running[future] = mine
                future.add_done_callback(lambda _: service.wake.set())
            done = [future for future in running if future.done()]
            for future in done:
                _settle(service, connection, running.pop(future), future)
            if not done:
                service.wake.wait(POLL_S)
    for future, mine in running.items():
        _settle(service, connection, mine, future)


def _settle(service: Service, connection: Connection, mine: Submission, future: Future[Ended]) -> None:
    try:
        outcome = outcome_of(service, mine, future.result()) if future.done() else {"state": "queued"}
    except (Stopped, CancelledError):
        outcome = {"state": "queued"}
    except Exception as error:  # from a worker: it died repeatedly, cannot read the upload, or has another version
        outcome = outcome_of(service, mine, Ended(None, "crash", f"{type(error).__name__}: {error}"))
    finish(service, connection, mine, **outcome)
