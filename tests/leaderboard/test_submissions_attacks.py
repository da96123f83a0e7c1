"""What is sent to do harm: each is refused with its reason, the reason is logged, and the server lives on."""

from __future__ import annotations

import gzip
import io
import json
import re
import socket
import stat
import zipfile
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from starlette.requests import Request

from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import load_settings
from oysterbench_leaderboard.submissions.uploads import check_headers
from tests.helpers.pool import NAMES, answers, estimate, path, tum, zipped
from tests.helpers.served import Site, lay, running
from tests.helpers.waiting import until


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attacked")
    limits = {"file_bytes": 3_000_000, "upload_bytes": 6_000_000, "unpacked_bytes": 20_000_000, "guesses_of_address": 6}
    tokens = lay(folder, **limits, refusals_of_one=1000, refusals_of_strangers=1000)
    with running(folder) as server:
        yield Site(folder, server, tokens)


def bomb(folder: Path) -> bytes:
    return zipped({"pool-01.tum": b"\0" * 2_900_000})


def many(folder: Path) -> bytes:
    """Far more than may be unpacked, in entries that each are small enough, as overlapping ones would be."""
    return zipped({f"{k}.npy": np.zeros(2_000_000, dtype=np.uint8).tobytes() for k in range(12)})


def link(folder: Path) -> bytes:
    return zipped({"pool-01.tum": b"/etc/passwd"}, external_attr=(stat.S_IFLNK | 0o777) << 16, create_system=3)


def nested(folder: Path) -> bytes:
    return zipped({"pool-01.npz": zipped({"inner.zip": answers(folder)})})


def pickled(folder: Path) -> bytes:
    out = io.BytesIO()
    np.savez(out, stamps_ns=np.array([print], dtype=object), positions=np.zeros((1, 3)), quaternions=np.zeros((1, 4)))
    return zipped({"pool-01.npz": out.getvalue()})


def claims(folder: Path) -> bytes:
    """An array whose header claims to be larger than any memory."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    header += b" " * (118 - len(header) - 1) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    return zipped({"pool-01.npz": zipped({"stamps_ns.npy": array})})


def nan(folder: Path) -> bytes:
    lines = tum(estimate(0), folder).split(b"\n")
    fields = lines[7].split()
    fields[2] = b"nan"
    lines[7] = b" ".join(fields)
    return zipped({"pool-01.tum": b"\n".join(lines)})


def twice(folder: Path) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("pool-01.tum", b"1 2 3 4 5 6 7 8")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("pool-01.tum", b"1 2 3 4 5 6 7 8")
    return out.getvalue()


def named(name: str) -> Callable[[Path], bytes]:
    return lambda folder: zipped({name: b"1 2 3 4 0 0 0 1\n"})


XML = b"<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><x>&a;</x>"

FILES: dict[str, tuple[Callable[[Path], bytes], int, str]] = {
    "zip bomb": (bomb, 422, "unpacks to 2900000 bytes from"),
    "many arrays": (many, 422, "expected at most 20 MB in all when unpacked"),
    "symbolic link": (link, 422, r"'pool-01\.tum' is a symbolic link"),
    "nested archive": (nested, 422, r"'inner\.zip': expected only arrays \(\.npy\) in an \.npz, no archive"),
    "pickle": (pickled, 422, r"not an \.npz of plain arrays: Object arrays cannot be loaded"),
    "huge header": (claims, 422, r"pool-01\.npz"),
    "NaN pose": (nan, 422, r"pool-01\.tum:8: expected finite numbers, got y = nan"),
    "one name twice": (twice, 422, "is there twice"),
    "parent folder": (named("../../pool-01.tum"), 422, r"'\.\./\.\./pool-01\.tum' leaves its folder by '\.\.'"),
    "windows parent": (named("..\\pool-01.tum"), 422, "leaves its folder"),
    "absolute path": (named("/etc/cron.d/pool-01.tum"), 422, "is an absolute path"),
    "drive": (named("C:/pool-01.tum"), 422, "is an absolute path"),
    "folder around": (named("mine/pool-01.tum"), 422, r"is no name of pool-test; expected SEQUENCE\.tum"),
    "script in a name": (named("<script>alert(1)</script>.tum"), 422, r"'<script>alert\(1\)</script>\.tum' is no"),
    "XML": (lambda folder: XML, 415, "the body is text; send a zip archive, JSON or text in UTF-8"),
    "gzip": (lambda folder: gzip.compress(b"1 2 3 4"), 415, "the body is gzip; send a zip archive, JSON or text"),
    "UTF-16": (lambda folder: "1 2 3".encode("utf-16"), 415, "the body is UTF-16; send a zip archive, JSON or text"),
    "random bytes": (lambda folder: bytes(range(254, 0, -1)), 415, "the body is of no known form; send a zip archive"),
    "truncated archive": (lambda folder: answers(folder)[:-30], 422, "not a complete zip archive"),
    "empty": (lambda folder: b"", 415, "the body is empty; send a zip archive, JSON or text in UTF-8"),
}  # fmt: skip
"""What is sent as a zip archive -> status and reason."""


@pytest.mark.parametrize("attack", FILES)
def test_a_file_that_does_harm_is_refused_with_its_reason(site, tmp_path, attack):
    make, status, reason = FILES[attack]
    before = site.count()
    got, answer = site.server.send(site.token, make(tmp_path), method=f"attack {attack}")
    assert got == status, answer
    assert re.search(reason, answer["reason"]), answer
    assert "\n" not in answer["reason"]
    assert str(site.folder) not in answer["reason"]
    last = site.events()[-1]
    assert (last["what"], last["who"]) == ("refused", "reef lab")
    assert re.search(reason, last["why"])
    assert site.count() == before, "it costs no quota"
    assert site.server.alive()
    assert list((site.folder / "private" / "incoming").iterdir()) == []


def test_what_a_desktop_puts_into_archives_is_passed_over(site, tmp_path):
    """As the archives of Finder and Explorer have it."""
    files = {f"{name}.tum": tum(estimate(k), tmp_path) for k, name in enumerate(NAMES)}
    beside = {"__MACOSX/._pool-01.tum": b"\0\5\26\7", ".DS_Store": b"x", "Thumbs.db": b"x"}
    status, made = site.server.send(site.token, zipped({**beside, **files}), method="desktop")
    assert status == 201, made
    assert site.server.wait(site.token, made["id"])["state"] == "done"
    status, answer = site.server.send(site.token, zipped(beside), method="desktop")
    assert (status, answer["reason"]) == (422, "the archive holds no file")


def test_an_upload_that_breaks_off_leaves_nothing_and_is_no_failure_of_the_server(site, tmp_path):
    data = answers(tmp_path)
    query = urlencode({"method": "cut", "split": "pool-test"})
    head = f"POST /api/submissions?{query} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {site.token}\r\n"
    head += f"Content-Type: application/zip\r\nContent-Length: {len(data)}\r\n\r\n"
    before = site.count()
    for _ in range(2):
        with closing(socket.create_connection(("127.0.0.1", site.server.port), timeout=60)) as connection:
            connection.sendall(head.encode() + data[: len(data) // 2])
            connection.shutdown(socket.SHUT_WR)
            assert not connection.recv(1000).startswith(b"HTTP/1.1 2")
    until(lambda: not list((site.folder / "private" / "incoming").iterdir()))
    assert site.count() == before
    assert "Traceback" not in (site.folder / "server.log").read_text()


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("image/png", "got the content type 'image/png'"),
        ("", "got the content type ''"),
        ("text/plain", "the content type says 'text/plain', but the body is zip"),
        ("application/json", "but the body is zip"),
        ("multipart/form-data", "expected multipart/form-data with a boundary"),
    ],
)
def test_a_wrong_content_type_is_refused(site, tmp_path, kind, reason):
    status, answer = site.server.send(site.token, answers(tmp_path), kind)
    assert (status, answer["error"]) == (415, "type")
    assert reason in answer["reason"]
    assert reason in site.events()[-1]["why"]


def pour(site: Site, headers: str, chunks: bool) -> tuple[int, bytes]:
    """Send without end: bytes that the server took, and what it answered."""
    query = urlencode({"method": "flood", "split": "pool-test"})
    head = f"POST /api/submissions?{query} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {site.token}\r\n"
    block = b"\1" * 65536
    framed = f"{len(block):x}\r\n".encode() + block + b"\r\n" if chunks else block
    sent = 0
    with closing(socket.create_connection(("127.0.0.1", site.server.port), timeout=60)) as connection:
        connection.sendall((head + headers + "Content-Type: application/octet-stream\r\n\r\n").encode())
        try:
            while sent < 10_000_000_000:
                connection.sendall(framed)
                sent += len(block)
        except OSError:
            pass
        answer = b""
        try:
            while data := connection.recv(65536):
                answer += data
        except OSError:
            pass
    return sent, answer


@pytest.mark.parametrize(
    ("headers", "chunks"),
    [("Content-Length: 10000000000\r\n", False), ("Transfer-Encoding: chunked\r\n", True)],
    ids=["says so", "says nothing"],
)
def test_ten_gigabytes_are_stopped_at_the_cap(site, headers, chunks):
    sent, _ = pour(site, headers, chunks)
    assert sent < 40_000_000, "the cap of 7 MB, and what the system holds on the way"
    assert "size: expected at most 6 MB" in site.events()[-1]["why"]
    assert site.server.alive()
    assert list((site.folder / "private" / "incoming").iterdir()) == []


def test_a_body_that_is_longer_than_it_said_is_no_more_than_it_said(site, tmp_path):
    data = answers(tmp_path)
    query = urlencode({"method": "short", "split": "pool-test"})
    head = f"POST /api/submissions?{query} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {site.token}\r\n"
    head += "Content-Type: application/zip\r\nContent-Length: 100\r\n\r\n"
    with closing(socket.create_connection(("127.0.0.1", site.server.port), timeout=60)) as connection:
        connection.sendall(head.encode() + data)
        assert connection.recv(65536).startswith(b"HTTP/1.1 422")
    assert site.server.alive()


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        ({"method": "a\u202eb"}, "expected plain text in one line"),
        ({"method": "x" * 81}, "expected at most 80 characters"),
        ({"method": " "}, "expected the name of the method"),
        ({"url": "javascript:alert(1)"}, "expected https://"),
        ({"url": "http://"}, "key 'url': expected https://... with the name of a host, or nothing, got 'http://'"),
        ({"url": "https://a b"}, "key 'url': expected https://... with the name of a host"),
        ({"split": "../../etc"}, "submissions to '../../etc' are not accepted here"),
        ({"track": "segmentation"}, "pool-test has the tracks slam"),
    ],
)
def test_what_is_said_of_a_submission_is_checked_before_it_is_read(site, tmp_path, asked, reason):
    status, answer = site.server.send(site.token, answers(tmp_path), **asked)
    assert status == 422
    assert reason in answer["reason"]


def test_a_submission_of_others_is_not_there(site, tmp_path):
    _, made = site.server.send(site.token, answers(tmp_path, case=77), method="mine")
    other = site.tokens["others"]
    for method, path_ in (("GET", ""), ("POST", "/publish"), ("POST", "/withdraw")):
        status, _, data = site.server.ask(method, f"/api/submissions/{made['id']}{path_}", token=other)
        assert (status, json.loads(data)["error"]) == (404, "absent")
        absent = site.server.ask(method, f"/api/submissions/{'0' * 16}{path_}", token=other)
        assert absent[2] == data, "as if it did not exist"
    assert json.loads(site.server.ask("GET", "/api/submissions", token=other)[2])["submissions"] == []
    assert site.server.ask("GET", f"/api/submissions/{made['id']}", token=site.token)[0] == 200


ELSEWHERE = {
    "at other times": (lambda e: replace(e, stamps_ns=e.stamps_ns + 10**15), "no pose is at a time of its sequence"),
    "in millimetres": (lambda e: replace(e, positions=1000 * e.positions), "its positions are not in metres"),
    "standing still": (lambda e: replace(e, positions=0 * e.positions), ""),
    "too few": (lambda e: e.select(np.arange(3)), "the path cannot be aligned with the ground truth"),
    "of a camera": (lambda e: replace(e, quaternions=turned(e.quaternions)), ""),
}
"""What makes a scorer that sees the truth say something -> what it may say."""


def turned(quaternions: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(quaternions) * Rotation.from_euler("zyx", [-1.57, 0, -1.57])).as_quat()


def test_nothing_that_is_served_holds_the_truth(site, tmp_path):
    """Whatever was answered in all these tests, published, or logged where others read: no number, pose or path of the
    truth is in it, however an estimate provokes the scorer."""
    for what, (change, message) in ELSEWHERE.items():
        files = {f"{name}.tum": tum(change(estimate(k)), tmp_path) for k, name in enumerate(NAMES)}
        status, made = site.server.send(site.token, zipped(files), method=what)
        found = site.server.wait(site.token, made["id"]) if status == 201 else {"state": "failed", **made}
        told = found["reason"] + " ".join(found.get("failures", {}).values())
        assert message in told
        assert bool(told) == (found["state"] == "failed" or bool(found.get("failures")))
    _, made = site.server.send(site.token, answers(tmp_path, case=5), method="published")
    site.server.wait(site.token, made["id"])
    answer = site.server.ask("POST", f"/api/submissions/{made['id']}/publish", token=site.token)
    digest = json.loads(answer[2])["published"]
    for page in ("/", "/boards/slam/pool-test", f"/records/{digest}", f"/records/{digest}/record"):
        for suffix in ("", ".json"):
            site.server.ask("GET", f"{page}{suffix}" if page != "/" else f"/index{suffix}")
    assert site.server.ask("GET", f"/records/{digest}/curves.json")[0] == 404
    cookie, _ = site.signed_in()
    for page in ("/submit/new", f"/submit/{made['id']}"):
        assert site.server.ask("GET", page, headers={"Cookie": cookie})[0] == 200
    shown = bytes(site.server.seen) + json.dumps(site.events()).encode() + (site.folder / "server.log").read_bytes()
    shown += b"".join(file.read_bytes() for file in (site.folder / "board").rglob("*.json"))
    assert digest.encode() in shown
    for needle in needles(site.folder):
        assert needle not in shown, needle


def needles(folder: Path) -> list[bytes]:
    """What would give the truth away: its positions and attitudes, the length of its path, where its files lie. Numbers
    with seven decimals, which no other number shares by chance."""
    found = [str(folder / "splits").encode(), b"-truth.", b".mcap"]
    for k in range(len(NAMES)):
        true = path(k)
        for value in np.concatenate([true.positions[::7].ravel(), true.quaternions[::11].ravel(), [true.path_length]]):
            found.append(f"{abs(value):.9f}"[:9].encode())
    return found


def test_tokens_cannot_be_guessed(site):
    """Last here: this address has to wait after it."""
    wrong = [site.token[:-1] + "~", "oyb_000000000000_x", site.token.replace("oyb", "xyz"), "x" * 5000, "<b>", "é"]
    seen = []
    for token in [*wrong, *wrong]:
        status, headers, data = site.server.ask(
            "GET", "/api/submissions", token=token.encode("latin-1").decode("latin-1")
        )
        seen.append(status)
        assert site.token not in data.decode()
    assert seen[:6] == [401] * 6
    assert set(seen[6:]) == {429}
    assert int(headers["retry-after"]) > 0
    whys = [event["why"] for event in site.events()[-20:]]
    assert any("guessing: too many wrong tokens" in why for why in whys)
    assert site.server.ask("GET", "/api/submissions", token=site.token)[0] == 429, (
        "a right one is not told from a wrong"
    )
    assert site.server.ask("GET", "/api/submissions/splits")[0] == 200


@pytest.mark.parametrize(("length", "refused"), [(b"\xb2", False), (b"", False), (b"9" * 5000, True)])
def test_a_length_that_makes_no_sense_is_counted_instead(tmp_path, length, refused):
    request = Request({"type": "http", "headers": [(b"content-length", length)]})
    with pytest.raises(Refusal) if refused else nullcontext():
        check_headers(request, load_settings(tmp_path))
