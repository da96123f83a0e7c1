"""A service of submissions without a server, whose clock is told the time."""

from __future__ import annotations

from dataclasses import replace

from oysterbench_leaderboard.submissions.database import log
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.pool import answers
from tests.helpers.served import drain

FORM = Form("carp", "pool-test")


class Clock:
    """Time that passes when it is told to."""

    def __init__(self) -> None:
        self.now = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now


def send(service, tmp_path, case=0, form=FORM, team="reef lab"):
    """Take in an archive of estimates, another one for each case: the submission, and whether it is new."""
    file = service.incoming / f"x{case}"
    file.write_bytes(answers(tmp_path, case))
    return service.submit(team, form, upload_of(file))


def events(service, what=""):
    """The log, or what of a kind is in it."""
    with service.database.reading() as connection:
        return [event for event in log(connection, limit=10_000) if event["what"] == what or not what]


def done(service, tmp_path, case=0, team="reef lab", **form):
    """Name of a submission that is scored."""
    made, _ = send(service, tmp_path, case, replace(FORM, **form), team)
    drain(service)
    return made.id
