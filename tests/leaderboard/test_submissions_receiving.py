"""Bodies that are received: each is counted, once, whatever becomes of it; and odd words in addresses."""

from __future__ import annotations

import asyncio
import encodings
import json
import shutil

import msgspec
import pytest
from starlette.requests import Request

from oysterbench.hub.canonical import sha256
from oysterbench_leaderboard.submissions.accounts.auth import Auth
from oysterbench_leaderboard.submissions.accounts.rates import DailyReads
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from tests.helpers.pool import answers
from tests.helpers.served import FAST, make_service
from tests.helpers.serving import events, show_json, upload

FORM_KIND = "multipart/form-data; boundary=b"


def form_body(**fields):
    """A form with a file, whose last fields are these."""
    head = '--b\r\nContent-Disposition: form-data; name="{}"{}\r\n\r\n{}\r\n'
    parts = [head.format("file", '; filename="a.tum"', "1 2 3"), *(head.format(*(k, "", v)) for k, v in fields.items())]
    return ("".join(parts) + "--b--\r\n").encode()


@pytest.mark.parametrize(
    ("body", "kind", "status"),
    [
        (b"1 2 3\n", "text/plain", 422),
        (b"PK\x03\x04 1 2 3", "application/zip", 422),
        (b"1 2 3\n", "application/zip", 415),
        (b"1 2 3\n" * 100, "text/plain", 413),
        (form_body(method=""), FORM_KIND, 422),
        (form_body(split="nowhere"), FORM_KIND, 422),
        (form_body()[:-4], FORM_KIND, 400),
        (b"--b\r\nnonsense", FORM_KIND, 400),
    ],
    ids=["name", "archive", "another kind", "too large", "no method", "no split", "incomplete", "nonsense"],
)
def test_what_is_refused_is_read_so_often_a_day_and_no_more(service, tmp_path, body, kind, status):
    service.reads = DailyReads(3, service.clock)
    limits, service.settings = service.settings, msgspec.structs.replace(service.settings, upload_bytes=500)
    assert [upload(service, body, kind).status_code for _ in range(4)] == [status] * 3 + [429]
    service.clock.now += 86_401
    service.settings = limits
    assert upload(service, answers(tmp_path)).status_code == 201


def test_a_body_whose_reading_fails_is_counted(service, monkeypatch):
    async def fails(*_):
        raise UnicodeError("not foreseen")

    service.reads = DailyReads(1, service.clock)
    monkeypatch.setattr("oysterbench_leaderboard.submissions.accounts.auth.receive_form", fails)
    assert [upload(service, form_body(), FORM_KIND).status_code for _ in range(2)] == [500, 429]


def test_names_of_encodings_that_do_not_exist_are_not_remembered(service):
    """`codecs.lookup` keeps each of them for ever."""
    before = len(encodings._cache)
    for number in range(20):
        answer = upload(service, form_body(), f"{FORM_KIND}; charset=none-{number}")
        assert answer.status_code == 415
    assert len(encodings._cache) == before


@pytest.mark.parametrize("charset", ["punycode", "undefined", "unicode_escape", "utf-16"])
def test_a_form_in_another_encoding_is_not_read(service, charset):
    answer = upload(service, form_body(**{"method-": "\\ud800"}), f"{FORM_KIND}; charset={charset}")
    assert (answer.status_code, json.loads(answer.body)["reason"].split(",")[0]) == (415, "expected a form in UTF-8")
    for same in ("UTF-8", "us-ascii", "utf8", '"UTF_8"'):
        assert upload(service, form_body(method=""), f"{FORM_KIND}; charset={same}").status_code == 422


@pytest.mark.parametrize(
    ("charset", "name", "method"),
    [("utf-8", b"method", b"\xff\xfe"), ("us-ascii", b"method", "\u00e9".encode()), ("utf-8", b"m\xff", b"cod")],
)
def test_a_form_with_bytes_that_are_no_text_of_its_encoding_is_not_read(service, charset, name, method):
    body = form_body(method="METHOD").replace(b'"method"', b'"' + name + b'"').replace(b"METHOD", method)
    answer = upload(service, body, f"{FORM_KIND}; charset={charset}")
    assert answer.status_code == 400
    assert "the form cannot be read: expected text in " in json.loads(answer.body)["reason"]


def test_what_is_received_is_counted_once_and_what_is_not_received_is_not(service, tmp_path):
    service.reads, bodies = DailyReads(3, service.clock), [answers(tmp_path, case) for case in range(2)]
    assert upload(service, bodies[0], "image/png").status_code == 415
    assert upload(service, bodies[0], "multipart/mixed").status_code == 415
    assert upload(service, bodies[0], method="").status_code == 422
    assert upload(service, bodies[0]).status_code == 201
    assert upload(service, bodies[0], digest=sha256(bodies[0]).upper()).status_code == 201, (
        "known: its body is not read"
    )
    assert upload(service, bodies[0]).status_code == 201, "known, too, but it was read"
    assert upload(service, bodies[1]).status_code == 201
    assert upload(service, bodies[1]).status_code == 429


def test_an_odd_digest_or_name_is_refused_and_logged_in_postgresql(laid, tmp_path, here, postgres):
    shutil.copytree(laid / "splits", tmp_path / "splits")
    service = make_service(tmp_path, database=postgres.replace("+psycopg", ""), **FAST)
    auth = Auth(service)
    for digest in ("\0", "\ud800", "0" * 63, "g" * 64):
        answer = upload(service, b"1", digest=digest.encode(errors="replace"))
        assert (answer.status_code, json.loads(answer.body)["error"]) == (400, "request"), digest
    assert upload(service, b"1", split="\0").status_code == 422

    async def refuse(request):
        raise Refusal("token", "no")

    about = {"type": "http", "method": "GET", "path": "/api/submissions/\0", "query_string": b"", "headers": []}
    answer = asyncio.run(auth.answered(refuse, show_json)(Request(about)))
    assert answer.status_code == 401
    assert events(service, "refused")[-1]["why"].startswith("GET /api/submissions/\\u0000: token")
    for odd in ("\0", "0123", "0123456789abcdeg"):
        with pytest.raises(Refusal, match="you have no such submission"):
            service.get("reef lab", odd)
    assert "Traceback" not in (tmp_path / "private" / "private.log").read_text()
    service.close()
