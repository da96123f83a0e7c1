"""Bodies that trickle: they are answered 408, and their places are free for others."""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import ExitStack, closing
from urllib.parse import urlsplit

import msgspec
import pytest
from starlette.applications import Starlette

from oysterbench_leaderboard.site.render import server_links
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import load_settings
from oysterbench_leaderboard.submissions.uploads import paced
from oysterbench_leaderboard.submissions.web import Submissions
from tests.helpers.pool import answers
from tests.helpers.served import lay, running
from tests.helpers.trees import serving_app
from tests.helpers.waiting import until

RATE = 1_000_000
"""Bytes a second that these tests ask for, which a file on one machine has and a trickle has not."""


def received(settings, chunks, every_s: float) -> int:
    """Bytes that are taken of a body whose chunks come so often."""

    async def body():
        for chunk in chunks:
            await asyncio.sleep(every_s)
            yield chunk

    async def count() -> int:
        return sum([len(chunk) async for chunk in paced(body(), settings, settings.upload_bytes)])

    return asyncio.run(count())


def test_a_body_is_given_time_by_what_has_come_of_it(tmp_path):
    settings = load_settings(tmp_path, upload_grace_s=0.3, upload_bytes_per_s=RATE)
    assert received(settings, [b"a" * RATE] * 6, 0.1) == 6 * RATE
    begun = time.monotonic()
    with pytest.raises(
        Refusal, match=r"^expected 1000 kB/s after the first 0\.3 s, got \d+ bytes in 0 s; send it"
    ) as slow:
        received(settings, [b"a"] * 1000, 0.05)
    assert slow.value.status == 408
    assert time.monotonic() - begun < 10.0


def test_silence_and_a_whole_time_have_their_limits_too(tmp_path):
    silent = load_settings(tmp_path, idle_s=0.05)
    with pytest.raises(Refusal, match=r"no data arrived for 0\.05 s; send it again"):
        received(silent, [b"a"], 30.0)
    long = load_settings(tmp_path, upload_s=0.2)
    with pytest.raises(Refusal, match=r"the upload took longer than 0\.2 s"):
        received(long, [b"a" * RATE] * 1000, 0.05)


@pytest.mark.parametrize(
    "path", ["/submit/sign-in", "/submit/sign-out", "/submit/0123456789abcdef/withdraw", "/api/submissions/0/withdraw"]
)
def test_a_small_body_that_never_ends_is_answered_all_the_same(service, path):
    service.settings = msgspec.structs.replace(service.settings, idle_s=0.1)
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-www-form-urlencoded\r\n"
    head += f"Authorization: Bearer {issue(service.database, 'third')}\r\nContent-Length: 3000\r\n\r\ncsrf=0"
    app = Starlette(routes=Submissions(service, server_links()).routes())
    with serving_app(app) as url, closing(socket.create_connection(("127.0.0.1", urlsplit(url).port))) as connection:
        connection.settimeout(3.0)
        connection.sendall(head.encode())
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"expected the whole request within 0.1 s, got 6 bytes of it; send it again" in answer


@pytest.mark.slow
def test_trickles_leave_their_places_to_others_and_are_counted_as_reads(tmp_path):
    tokens = lay(
        tmp_path,
        uploads_at_once=2,
        uploads_of_team=2,
        upload_grace_s=1.0,
        upload_bytes_per_s=RATE,
        reads_per_day=2,
        idle_s=20.0,
    )
    head = "POST /api/submissions?method=slow&split=pool-test HTTP/1.1\r\nHost: x\r\nContent-Type: application/zip\r\n"
    head += f"Authorization: Bearer {tokens['others']}\r\nContent-Length: 100000000\r\n\r\nPK\x03\x04"
    with running(tmp_path) as server, ExitStack() as stack:
        slow = [stack.enter_context(closing(socket.create_connection(("127.0.0.1", server.port)))) for _ in range(2)]
        said = [b"", b""]
        for connection in slow:
            connection.sendall(head.encode())
            connection.settimeout(0.05)

        def all_answered() -> bool:
            for k, connection in enumerate(slow):
                try:
                    said[k] = said[k] or connection.recv(4000)
                    connection.sendall(b"a")
                except OSError:  # nothing yet, or closed
                    continue
            return all(said)

        until(all_answered)
        assert all(answer.startswith(b"HTTP/1.1 408 ") for answer in said), said
        assert server.send(tokens["reef lab"], answers(tmp_path))[0] == 201
        status, answer = server.send(tokens["others"], answers(tmp_path))
        assert (status, answer["error"]) == (429, "quota"), "each of the two was an upload of the day"


@pytest.mark.slow
def test_an_upload_that_is_fast_enough_gives_its_place_to_a_team_that_has_had_less_time(tmp_path):
    tokens = lay(tmp_path, uploads_at_once=1, upload_safe_s=0)
    head = "POST /api/submissions?method=slow&split=pool-test HTTP/1.1\r\nHost: x\r\nContent-Type: application/zip\r\n"
    head += f"Authorization: Bearer {tokens['others']}\r\nContent-Length: 100000000\r\n\r\nPK\x03\x04"
    with running(tmp_path) as server, closing(socket.create_connection(("127.0.0.1", server.port))) as slow:
        slow.sendall(head.encode())
        until(lambda: server.send(tokens["others"], b"a", "image/png")[0] == 503)  # as a team sends one at a time
        assert server.send(tokens["reef lab"], answers(tmp_path))[0] == 201
        slow.settimeout(20.0)
        said = slow.recv(4000).decode()
        assert said.startswith("HTTP/1.1 503 "), said
        assert "retry-after: 60" in said.lower()
        slow.close()
        assert server.send(tokens["others"], answers(tmp_path))[0] == 201
