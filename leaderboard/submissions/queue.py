"""Workers that score what is queued. One is claimed in one transaction, with a lease, and finished in another, guarded
by the number of the attempt: whoever was thought dead and comes back late changes nothing."""

from __future__ import annotations

import threading
from dataclasses import replace

from sqlalchemy import and_, or_, select

from oysterbench.core.errors import OysterbenchError
from oysterbench_leaderboard.submissions import sandbox
from oysterbench_leaderboard.submissions.database import Submission, change, log_event, submissions
from oysterbench_leaderboard.submissions.refusals import FAILED
from oysterbench_leaderboard.submissions.sandbox import Job
from oysterbench_leaderboard.submissions.service import Service

POLL_S = 1.0
"""How often a worker looks for what another host has queued."""


def claim(service: Service) -> Submission | None:
    """The next submission, which is this worker's until its lease ends; what was begun most often comes last."""
    c = submissions.c
    now = service.clock()
    waiting = or_(c.state == "queued", and_(c.state == "running", c.lease < now))
    with service.database.writing() as connection:
        oldest = select(submissions).where(waiting).order_by(c.attempt, c.created_s, c.id).limit(1)
        row = connection.execute(oldest.with_for_update(skip_locked=True)).mappings().first()
        if row is None:
            return None
        mine, at = Submission(**row), service.now()
        attempt, lease = mine.attempt + 1, now + service.settings.lease_s
        guard = c.attempt == mine.attempt
        if not change(connection, mine.id, at, guard, state="running", attempt=attempt, lease=lease):
            return None
        log_event(connection, at, "worker", "running", mine.id, f"attempt {attempt}")
        return replace(mine, state="running", attempt=attempt, lease=lease, updated=at)


def renew(service: Service, mine: Submission) -> bool:
    """Go on with a lease; whether it is still this worker's."""
    c = submissions.c
    guard = (c.state == "running", c.attempt == mine.attempt)
    with service.database.writing() as connection:
        lease = service.clock() + service.settings.lease_s
        return change(connection, mine.id, service.now(), *guard, lease=lease)


def finish(service: Service, mine: Submission, state: str, record: str = "", reason: str = "") -> bool:
    """End an attempt; whether it was still this worker's to end."""
    c = submissions.c
    guard = (c.state == "running", c.attempt == mine.attempt)
    at = service.now()
    with service.database.writing() as connection:
        ended = change(connection, mine.id, at, *guard, state=state, record=record, reason=reason, lease=0.0)
        if ended:
            log_event(connection, at, "worker", state, mine.id, reason or record)
        return ended


def score(service: Service, mine: Submission, stop: threading.Event) -> None:
    """Score what was claimed and say so; where it is stopped, or another worker has it meanwhile, say nothing."""
    served = service.catalogue.splits.get(mine.split)
    wanted = None if served is None else served.wanted.get(mine.track)
    if served is None or wanted is None:
        finish(service, mine, "failed", reason=FAILED["absent"])
        return
    settings = service.settings
    path, truth = service.estimates / mine.digest, {name: str(path) for name, path in served.truth.items()}
    job = Job(str(path), wanted, settings.limits, service.hidden, truth, mine.method, mine.created)
    try:
        allowance, beat_s = sandbox.scoring(settings), settings.lease_s / 3
        ended = sandbox.run(job, allowance, stop, lambda: renew(service, mine), beat_s)
    except sandbox.Stopped:
        if stop.is_set():
            finish(service, mine, "queued")
        return
    if ended.stderr:
        service.log.info("scoring %s, attempt %d: %s", mine.id, mine.attempt, ended.stderr)
    if ended.answer is None:
        if ended.cause == "crash" and mine.attempt < settings.attempts:
            finish(service, mine, "queued", reason="")
        else:
            finish(service, mine, "failed", reason=FAILED[ended.cause])
        return
    if "refused" in ended.answer:
        reported = mine.kind == "results"  # of a public split: no reason tells of a truth that is kept back
        finish(service, mine, "failed", reason=ended.answer["refused"]["reason"] if reported else FAILED["refused"])
        return
    try:
        record = service.build(mine, ended.answer)
    except OysterbenchError as error:
        service.log.info("scoring %s: %s", mine.id, error)
        finish(service, mine, "failed", reason=FAILED["crash"])
        return
    failures = {result.sequence: result.failure for result in record.results if result.failure is not None}
    if len(failures) == len(record.results) and mine.kind != "results":
        stderr = "; ".join(f"{sequence}: {failure}" for sequence, failure in list(failures.items())[:3])
        finish(service, mine, "failed", reason=FAILED["none"] + stderr)
        return
    finish(service, mine, "done", record=service.scored.add(record))


class Workers:
    """Threads that score until they are stopped."""

    def __init__(self, service: Service, count: int | None = None) -> None:
        self.service = service
        self._stop = threading.Event()
        n = service.settings.workers if count is None else count
        self._threads = [threading.Thread(target=self._work, name=f"worker-{k}", daemon=True) for k in range(n)]

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End; what is being scored goes back into the queue."""
        self._stop.set()
        self.service.wake.set()
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                mine = claim(self.service)
                if mine is not None:
                    score(self.service, mine, self._stop)
                    continue
            except Exception:  # a worker that is gone is missed by nobody: it says why, and goes on
                self.service.log.exception("a worker failed")
            self.service.wake.wait(POLL_S)
            self.service.wake.clear()


def drain(service: Service) -> int:
    """Score all that waits, and return how many that was."""
    stop, count = threading.Event(), 0
    while (mine := claim(service)) is not None:
        score(service, mine, stop)
        count += 1
    return count
