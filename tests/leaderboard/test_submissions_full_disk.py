"""A full disk: what cannot be kept is answered with the reason."""

from __future__ import annotations

import asyncio
import errno
import json
import sqlite3
from contextlib import closing
from urllib.parse import urlencode

import pytest
from sqlalchemy.exc import OperationalError
from starlette.requests import Request
from starlette.responses import JSONResponse

from oysterbench_leaderboard.submissions.accounts.auth import Auth
from tests.helpers.pool import answers


def full_database(*args) -> None:
    """Raise what SQLAlchemy raises where SQLite has no room."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.execute("PRAGMA max_page_count = 1")
        try:
            connection.execute("CREATE TABLE more (x)")
        except sqlite3.OperationalError as error:
            raise OperationalError("CREATE TABLE more (x)", {}, error) from None


def full_folder(*args) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def broken(*args) -> None:
    raise OSError(errno.EIO, "Input/output error")


def upload(service, body: bytes):
    """Answer to an upload by the team reef lab."""
    auth = Auth(service)
    query = urlencode({"method": "carp", "split": "pool-test"}).encode()
    about = {"type": "http", "method": "POST", "path": "/api/submissions", "query_string": query}

    async def receive():
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(request):
        made, _ = await auth.submit(request, "reef lab")
        return JSONResponse({"id": made.id}, 201)

    async def show(request, refusal):
        return JSONResponse({"error": refusal.kind, "reason": refusal.reason}, refusal.status)

    request = Request({**about, "headers": [(b"content-type", b"application/zip")]}, receive)

    async def answer():
        return await auth.answered(send, show)(request)

    return asyncio.run(answer())


@pytest.mark.parametrize(
    ("place", "fail", "status"),
    [
        ("oysterbench_leaderboard.submissions.uploads.shutil.copyfileobj", full_folder, 507),
        ("oysterbench_leaderboard.submissions.service.log_event", full_database, 507),
        ("oysterbench_leaderboard.submissions.uploads.shutil.copyfileobj", broken, 500),
    ],
    ids=["folder", "database", "broken disk"],
)
def test_an_upload_for_which_there_is_no_room_is_told_so_and_not_counted(
    service, tmp_path, monkeypatch, place, fail, status
):
    with monkeypatch.context() as patch:
        patch.setattr(place, fail)
        answer = upload(service, answers(tmp_path))
    assert (answer.status_code, answer.headers["connection"]) == (status, "close")
    if status == 507:
        reason = "the server's disk is full; try again later, or tell its operators"
        assert json.loads(answer.body) == {"error": "full", "reason": reason}
    assert (service.of_team("reef lab"), list(service.incoming.iterdir())) == ([], [])
    assert upload(service, answers(tmp_path)).status_code == 201
