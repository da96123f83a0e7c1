"""A server of submissions that is killed at random moments, again and again, while others send to it.

python -m tests.helpers.kills [KILLS]    in a new folder; prints what happened
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from oysterbench.core.streams import stream
from oysterbench_leaderboard.submissions.database import Submission, find, log, submissions
from oysterbench_leaderboard.submissions.sandbox import sandbox, sandbox_worker
from tests.helpers.pool import answers
from tests.helpers.served import Server, lay, make_service
from tests.helpers.waiting import NEVER, run_for

SENDERS = 2


@dataclass
class Outcome:
    """What was there in the end.

    sent:       submission -> method, as servers had answered before they were killed
    states:     submission -> state
    scored:     submission -> how often the log says that it was scored
    records:    submission -> digest of its record; again: of the one that scoring it once more gives
    board:      digests of published records on the board; published: those that the database calls so
    killed_at:  stage of the submissions at each kill
    """

    kills: int = 0
    attempts: int = 0
    sent: dict[str, str] = field(default_factory=dict)
    states: dict[str, str] = field(default_factory=dict)
    scored: dict[str, int] = field(default_factory=dict)
    records: dict[str, str] = field(default_factory=dict)
    again: dict[str, str] = field(default_factory=dict)
    board: list[str] = field(default_factory=list)
    published: list[str] = field(default_factory=list)
    killed_at: list[str] = field(default_factory=list)


def run(folder: Path, kills: int, seed: int = 1) -> Outcome:
    """Kill a server so many times, and let the last one finish its work.

    The moments are random over the time that a start and the life of a submission take here, as a first server shows.
    """
    token = lay(folder)["reef lab"]
    rng = stream(seed, b"", "kills")
    server, outcome, enough = Server(folder), Outcome(), threading.Event()
    longest_s = _life(server, folder, token, outcome)
    senders = [threading.Thread(target=_send, args=(server, folder, token, k, outcome, enough)) for k in range(SENDERS)]
    for sender in senders:
        sender.start()
    try:
        while outcome.kills < kills:
            # Some die while they start, most while they receive, check, score or publish.
            begun = server.begin()
            run_for(begun, rng.uniform(0.0, longest_s))
            outcome.killed_at.append(_stages(folder))
            os.killpg(begun.pid, signal.SIGKILL)
            begun.wait()
            outcome.kills += 1
        enough.set()
        server.start()
        for sender in senders:
            sender.join()
    finally:
        enough.set()
        server.stop()
    _look(folder, outcome)
    return outcome


def _life(server: Server, folder: Path, token: str, outcome: Outcome) -> float:
    """Seconds that a server takes to start, and to receive, check and score one submission."""
    begun = time.monotonic()
    server.start()
    status, made = server.send(token, answers(folder, case=9999), method="the first")
    assert status == 201, made
    server.wait(token, made["id"])
    assert server.ask("POST", f"/api/submissions/{made['id']}/publish", token=token)[0] == 200
    outcome.sent[made["id"]] = "the first"
    took = time.monotonic() - begun
    server.stop()
    return took


def _stages(folder: Path) -> str:
    """What the database held at a moment."""
    import sqlite3

    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(
            sqlite3.connect(f"file:{folder / 'private' / 'submissions.sqlite'}?mode=ro", uri=True, timeout=5)
        ) as connection,
    ):
        rows = connection.execute("SELECT state, count(*) FROM submissions GROUP BY state").fetchall()
        return ", ".join(f"{count} {state}" for state, count in sorted(rows)) or "nothing"
    return "unknown"


def _send(server: Server, folder: Path, token: str, sender: int, outcome: Outcome, enough: threading.Event) -> None:
    """Send one submission after the other, each until it was answered, and publish each when it is scored."""
    own = folder / f"sender-{sender}"
    own.mkdir()
    number = 0
    while number == 0 or not enough.is_set():
        method, data = f"sender {sender}, number {number}", answers(own, case=100 * sender + number)
        number += 1
        made = _until(server, "POST", _query(method), data, token, (200, 201))
        outcome.sent[made["id"]] = method
        found = made
        while found["state"] in ("queued", "running"):
            NEVER.wait(0.2)
            found = _until(server, "GET", f"/api/submissions/{made['id']}", None, token, (200,))
        _until(server, "POST", f"/api/submissions/{made['id']}/publish", None, token, (200,))


def _query(method: str) -> str:
    from urllib.parse import urlencode

    return f"/api/submissions?{urlencode({'method': method, 'split': 'pool-test'})}"


def _until(server: Server, method: str, path: str, body: Any, token: str, good: tuple[int, ...]) -> dict[str, Any]:
    """The answer to a request that is made until a server lives to answer it."""
    end = time.monotonic() + 1200
    while time.monotonic() < end:
        try:
            status, _, data = server.ask(method, path, body, {"Content-Type": "application/zip"}, token)
        except (OSError, http.client.HTTPException):
            NEVER.wait(0.1)  # until another server is there
            continue
        if status == 503:  # another upload of the team is being received
            NEVER.wait(0.1)
            continue
        assert status in good, (status, data)
        return json.loads(data)
    raise AssertionError("no server has answered")


def _look(folder: Path, outcome: Outcome) -> None:
    """At the database, the log and the board; and score all once more."""
    service = make_service(folder)
    with service.database.reading() as connection:
        found = find(connection, submissions.c.id != "")
        events = log(connection, limit=100_000)
    done = Counter(event["submission"] for event in events if event["what"] == "done")
    for one in found:
        outcome.states[one.id] = one.state
        outcome.scored[one.id] = done[one.id]
        outcome.records[one.id] = one.record
        outcome.attempts += one.attempt
        outcome.again[one.id] = scored_again(service, one)
    outcome.board = service.store.digests()
    outcome.published = sorted(one.published for one in found if one.published)
    service.close()


def scored_again(service: Any, one: Submission) -> str:
    """Digest of the record that scoring a submission once more gives, in this process."""
    served = service.catalogue.splits[one.split]
    wanted = served.wanted[one.track]
    truth = {name: str(path) for name, path in served.truth.items()}
    with service.estimates.opened(one.digest) as path:
        job = sandbox.Job(str(path), wanted, service.settings.limits, (), truth, one.method, one.created)
        return service.build(one, sandbox_worker.do(job)).digest


def check(outcome: Outcome, kills: int) -> None:
    """Nothing lost, nothing scored twice, the same scores."""
    assert outcome.kills == kills
    assert outcome.sent, "somebody was answered"
    assert set(outcome.sent) == set(outcome.states), "what was answered is there, and nothing else"
    assert set(outcome.states.values()) == {"done"}
    assert set(outcome.scored.values()) == {1}
    assert outcome.records == outcome.again
    assert outcome.published == outcome.board
    assert len(outcome.board) == len(outcome.sent)


if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    with tempfile.TemporaryDirectory() as made:
        begun = time.monotonic()
        result = run(Path(made), wanted)
        print(f"{result.kills} kills in {time.monotonic() - begun:.0f} s, {len(result.sent)} submissions sent")
        print(f"{result.attempts} attempts to score them; killed while there were:")
        for line, count in Counter(result.killed_at).most_common():
            print(f"  {count} x {line}")
        check(result, wanted)
        print("nothing lost, nothing scored twice, the same records")
