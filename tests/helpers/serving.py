"""A service of submissions without a server, whose clock is told the time."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import JSONResponse

from oysterbench_leaderboard.submissions.accounts.auth import Auth
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


async def show_json(request, refusal):
    """Show a refusal as the API does."""
    return JSONResponse({"error": refusal.kind, "reason": refusal.reason}, refusal.status)


def upload(service, body: bytes, kind: str = "application/zip", **query: str):
    """Answer to an upload by the team reef lab. kind: content type; query: of the address, besides method and split"""
    auth = Auth(service)
    asked = urlencode({"method": "carp", "split": "pool-test", **query}).encode()
    about = {"type": "http", "method": "POST", "path": "/api/submissions", "query_string": asked}

    async def receive():
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(request):
        request.state.team = "reef lab"
        made, _ = await auth.submit(request, "reef lab")
        return JSONResponse({"id": made.id}, 201)

    request = Request({**about, "headers": [(b"content-type", kind.encode())]}, receive)

    async def answer():
        return await auth.answered(send, show_json)(request)

    return asyncio.run(answer())


def events(service, what=""):
    """The log, or what of a kind is in it."""
    with service.database.reading() as connection:
        return [event for event in log(connection, limit=10_000) if event["what"] == what or not what]


def done(service, tmp_path, case=0, team="reef lab", **form):
    """Name of a submission that is scored."""
    made, _ = send(service, tmp_path, case, replace(FORM, **form), team)
    drain(service)
    return made.id
