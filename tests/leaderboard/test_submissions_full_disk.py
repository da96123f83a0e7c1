"""A full disk: what cannot be kept is answered with the reason."""

from __future__ import annotations

import asyncio
import errno
import json
import sqlite3
from contextlib import closing

import pytest
from sqlalchemy.exc import OperationalError
from starlette.requests import Request

from oysterbench_leaderboard.submissions.accounts.auth import FULL, Auth
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from tests.helpers.pool import answers
from tests.helpers.serving import events, upload


def full_database(*args, **named) -> None:
    """Raise what SQLAlchemy raises where SQLite has no room."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.execute("PRAGMA max_page_count = 1")
        try:
            connection.execute("CREATE TABLE more (x)")
        except sqlite3.OperationalError as error:
            raise OperationalError("CREATE TABLE more (x)", {}, error) from None


def full_folder(*args) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def broken(*args, **named) -> None:
    raise OSError(errno.EIO, "Input/output error")


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


@pytest.mark.parametrize("fail", [full_database, broken], ids=["full", "broken"])
def test_a_refusal_that_cannot_be_logged_is_answered_all_the_same(service, monkeypatch, fail):
    monkeypatch.setattr("oysterbench_leaderboard.submissions.service.log_event", fail)
    answer = upload(service, b"1 2 3")
    assert (answer.status_code, answer.headers["connection"]) == (415, "close")
    assert "the body is text" in json.loads(answer.body)["reason"]
    told = (service.settings.folder / "private.log").read_text()
    assert "a refusal was not logged: POST /api/submissions: " in told
    assert "Traceback" not in told


def test_a_page_that_fails_while_a_refusal_is_shown_is_a_failure_that_says_so(service):
    async def refuse(request):
        raise Refusal("state", "no")

    async def show(request, refusal):
        full_database()

    request = Request({"type": "http", "method": "GET", "path": "/submit/new", "query_string": b"", "headers": []})
    answer = asyncio.run(Auth(service).answered(refuse, show)(request))
    assert (answer.status_code, answer.body) == (507, FULL.reason.encode())
    assert events(service, "refused")[-1]["why"] == "GET /submit/new: state: no"
