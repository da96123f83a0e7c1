"""`oysterbench submit`, against a server in a process of its own."""

from __future__ import annotations

import hashlib
import http.client
import json
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import HubError, NetworkError
from oysterbench.hub.sources import Patience
from oysterbench_leaderboard.submissions.sending.client import Client, Refused
from tests.helpers.pool import NAMES, answers, estimate, image_names, steered, tum, zipped
from tests.helpers.served import Site, lay, running
from tests.helpers.waiting import until
from tests.helpers.web import Honest, serving


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    tokens = lay(folder)
    with running(folder) as server:
        yield Site(folder, server, tokens)


def submit(site, *args, token=None):
    environment = {"OYSTERBENCH_TOKEN": token or site.token}
    return CliRunner().invoke(main, ["submit", *map(str, args), "--to", site.url], env=environment)


@pytest.fixture
def estimates(tmp_path):
    folder = tmp_path / "estimates"
    folder.mkdir()
    for k, name in enumerate(NAMES):
        (folder / f"{name}.tum").write_bytes(tum(estimate(k), tmp_path))
    return folder


def test_estimates_are_checked_sent_scored_and_published(site, estimates):
    sent = submit(site, estimates, "--method", "carp", "--split", "pool-test", "--url", "https://x.example")
    assert sent.exit_code == 0, sent.output
    assert "checked: poses of 2 sequences, 400 poses" in sent.stderr
    assert "done" in sent.stderr
    assert re.search(r"carp on pool-test: done\n  score: 0\.\d+\n  coverage: 1\n  private until", sent.stdout)
    again = submit(site, estimates, "--method", "carp", "--split", "pool-test", "--publish", "--json")
    assert again.exit_code == 0, again.output
    found = json.loads(again.stdout)
    assert found["id"] in sent.stderr, "the same bytes are the same submission"
    assert found["published"]
    status, _, page = site.server.ask("GET", f"/records/{found['published']}")
    assert status == 200
    assert b"carp" in page


def test_files_that_were_withdrawn_are_answered_with_what_to_do(site, estimates):
    about = (estimates, "--method", "ray", "--split", "pool-test")
    sent = json.loads(submit(site, *about, "--json").stdout)
    assert site.server.ask("POST", f"/api/submissions/{sent['id']}/withdraw", token=site.token)[0] == 200
    again = submit(site, *about)
    assert again.exit_code == 1
    assert "ray on pool-test: withdrawn: withdrawn by the team" in again.stdout
    assert again.stdout.endswith(
        "  these files stay withdrawn under this name: to have them scored again, give another --method\n"
    )


def test_what_is_said_anew_of_files_that_were_sent_before_is_not_taken_and_it_says_so(site, estimates):
    about = ("--method", "tench", "--split", "pool-test", "--no-wait")
    assert "already" not in submit(site, estimates, *about, "--summary", "One.", "--url", "https://x.example").stderr
    assert "already" not in submit(site, estimates, *about, "--summary", " One. ").stderr
    again = submit(site, estimates, *about, "--summary", "Another.", "--url", "https://y.example")
    assert again.exit_code == 0, again.output
    assert re.search(r"were submitted on 2\S+Z already: the summary and address given then are unchanged", again.stderr)
    assert "the address given then is unchanged" in submit(site, estimates, *about, "--url", "https://y.example").stderr


def test_what_is_wrong_is_found_before_anything_is_sent(site, estimates):
    (estimates / "pool-02.tum").write_text("1 2 3 4 0 0 0 1\n2 3 4 5 0 0 0\n")
    before = site.server.ask("GET", "/api/submissions", token=site.token)[2]
    sent = submit(site, estimates, "--method", "pike", "--split", "pool-test")
    assert sent.exit_code == 1
    assert "oysterbench: pool-02.tum:2: expected 8 numbers" in sent.stderr
    assert sent.stderr.count("\n") == 1
    assert site.server.ask("GET", "/api/submissions", token=site.token)[2] == before


def test_only_checking_sends_nothing(site, estimates):
    (estimates / "pool-02.tum").unlink()
    before = posts(site)
    checked = submit(site, estimates, "--method", "tench", "--split", "pool-test", "--check", "--json")
    assert checked.exit_code == 0, checked.output
    found = json.loads(checked.stdout)
    assert found == {"kind": "poses", "sequences": ["pool-01"], "poses": 200, "images": 0, "notes": []}
    assert "no estimate is sent for pool-02" in checked.stderr
    assert checked.stderr.endswith("nothing was sent: the same command without --check sends it\n")
    assert posts(site) == before
    both = submit(site, estimates, "--method", "tench", "--split", "pool-test", "--check", "--publish")
    assert both.exit_code == 2
    assert "--check sends nothing: it cannot be combined with --publish" in both.stderr


def posts(site) -> int:
    """Submissions that the server has been sent, taken or refused."""
    return sum(event["what"] in ("queued", "refused") for event in site.events())


def test_times_of_another_clock_are_found_before_anything_is_sent(site, estimates, tmp_path):
    path = estimate(1)
    relative = replace(path, stamps_ns=path.stamps_ns - path.stamps_ns[0])
    (estimates / "pool-02.tum").write_bytes(tum(relative, tmp_path))
    before = posts(site)
    sent = submit(site, estimates, "--method", "pike", "--split", "pool-test")
    assert (sent.exit_code, sent.stderr.count("\n"), posts(site)) == (1, 1, before)
    assert "oysterbench: pool-02.tum: no pose is at a time of its sequence: they are at 0.000 to" in sent.stderr
    late = replace(path, stamps_ns=path.stamps_ns + 10_000_000_000)
    (estimates / "pool-02.tum").write_bytes(tum(late, tmp_path))
    sent = submit(site, estimates, "--method", "late", "--split", "pool-test", "--no-wait")
    assert sent.exit_code == 0
    assert "pool-02: 98 of 200 poses are before its begin or after its end, and are not scored\n" in sent.stderr


@pytest.mark.parametrize("wrong", ["token", "method"])
def test_a_wrong_token_and_a_name_that_no_page_can_show_are_noticed_before_anything_is_sent(
    site, estimates, monkeypatch, wrong
):
    monkeypatch.setattr(Client, "send", lambda *args: pytest.fail("it was sent"))
    method, token = ("carp", f"{site.token[:-1]}~") if wrong == "token" else ("a\u202eb", site.token)
    sent = submit(site, estimates, "--method", method, "--split", "pool-test", token=token)
    assert (sent.exit_code, sent.stderr.count("\n")) == (1, 1)
    expected = {"token": "the token is unknown or revoked", "method": "key 'method': expected plain text"}
    assert expected[wrong] in sent.stderr


def test_names_that_are_of_no_sequence_are_told_with_what_was_found(site, estimates):
    (estimates / "pool-02.tum").rename(estimates / "pool-2.tum")
    sent = submit(site, estimates, "--method", "named", "--split", "pool-test", "--no-wait")
    assert "no estimate is sent for pool-02: counted as failed there" in sent.stderr
    assert "not sent, as named for no sequence of pool-test: pool-2.tum" in sent.stderr
    one = submit(site, estimates / "pool-2.tum", "--method", "named", "--split", "pool-test")
    assert one.exit_code == 1
    assert "expected SEQUENCE.tum, the sequences being pool-01, pool-02; did you mean pool-02" in one.stderr
    (estimates / "pool-01.tum").rename(estimates / "one.tum")
    none = submit(site, estimates, "--method", "named", "--split", "pool-test")
    assert none.exit_code == 1
    assert none.stderr.endswith("what `oysterbench run` leaves; found one.tum, pool-2.tum\n")


@pytest.mark.slow
def test_commands_are_sent_as_tables_and_scored_in_the_sandbox(site, tmp_path):
    folder = tmp_path / "commands"
    folder.mkdir()
    for k, name in enumerate(NAMES):
        stamps = [image.rpartition("/")[2] for image in image_names(k)]
        rows = [f"{stamp},{y},{p}" for stamp, (y, p) in zip(stamps, steered(k)[0].tolist(), strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["stamp_ns,yaw,pitch", *rows]))
    sent = submit(site, folder, "--method", "expert", "--split", "pool-steer")
    assert sent.exit_code == 0, sent.output
    assert "checked: commands of 2 sequences, 6 images" in sent.stderr
    assert "expert on pool-steer: done\n  skill: 1\n" in sent.stdout
    (folder / "pool-02.csv").write_text("stamp_ns,yaw,pitch\n1,2,9\n")
    wrong = submit(site, folder, "--method", "expert", "--split", "pool-steer")
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (1, 1)
    assert "pool-02.csv:2: pitch: expected a class from 0 to 2, got 9" in wrong.stderr


def test_a_track_that_cannot_be_submitted_is_refused_before_anything_is_sent(site, estimates, tmp_path):
    refused = submit(site, estimates, "--method", "map", "--split", "pool-val", "--track", "density")
    assert refused.exit_code == 1
    assert "--track: pool-val has slam, got 'density': maps are scored locally" in refused.stderr
    row = {"split": "pool-val", "track": "density", "sequence": "pool-01", "method": "map"}
    (tmp_path / "results.json").write_text(json.dumps({"results": [row]}))
    refused = submit(site, tmp_path / "results.json", "--method", "map")
    assert refused.exit_code == 1
    assert "its track: pool-val has slam, got 'density'" in refused.stderr
    status, answer = site.server.send(site.token, b"x", split="pool-val", track="density")
    assert status in (400, 404, 422)
    assert "the tracks that can be submitted are slam, segmentation, detection, steering" in answer["reason"]


def test_what_a_run_leaves_is_sent_by_the_name_of_its_method(site, tmp_path, estimates):
    """A folder of `oysterbench run`: results.json, SEQUENCE-METHOD.tum and the truth."""
    from oysterbench.results.records import ResultRecord, write_results

    out = tmp_path / "results"
    out.mkdir()
    records = []
    for method in ("carp", "perch"):
        for name in NAMES:
            (out / f"{name}-{method}.tum").write_bytes((estimates / f"{name}.tum").read_bytes())
            (out / f"{name}-truth.tum").write_bytes(b"no business of anybody")
            records.append(ResultRecord(track="slam", split="pool-test", sequence=name, method=method))
    write_results(out / "results.json", records)
    refused = submit(site, out, "--method", "Perch 2", "--no-wait")
    assert "has results of carp, perch; say whose estimates to send (--of NAME)" in refused.stderr
    sent = submit(site, out, "--method", "Perch 2", "--of", "perch", "--no-wait", "--json")
    assert sent.exit_code == 0, sent.output
    found = json.loads(sent.stdout)
    assert (found["state"], found["method"], found["split"]) == ("queued", "Perch 2", "pool-test")
    (out / f"{NAMES[0]}-perch.tum").rename(out / f"{NAMES[0]}-perch-2.tum")
    (out / f"{NAMES[1]}-perch.tum").rename(out / f"{NAMES[1]}-perch-2.tum")
    (out / f"{NAMES[0]}-perch-3.tum").write_bytes((estimates / f"{NAMES[0]}.tum").read_bytes())
    several = [replace(record, run=run) for run in range(3) for record in records if record.method == "perch"]
    write_results(out / "results.json", several)
    refused = submit(site, out, "--method", "Perch 3", "--check")
    assert "no estimates of run 1: it failed, or was not made; expected one of 2, 3 (--run)" in refused.stderr
    checked = submit(site, out, "--method", "Perch 3", "--run", "2", "--check")
    assert checked.exit_code == 0, checked.output
    assert "run 2 alone is sent, not run 3 (--run); `leaderboard add` puts the mean of all" in checked.stderr
    assert "on a board, with run 1, which failed\n" in checked.stderr
    write_results(out / "results.json", [])
    refused = submit(site, out, "--method", "carp", "--split", "pool-test", "--track", "slam")
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
    assert "results.json: expected results of a method, found none" in refused.stderr


def test_a_run_that_left_no_estimates_is_sent_by_its_results(site, tmp_path):
    """As one of the track steering is, whose commands are not kept."""
    from oysterbench.results.records import ResultRecord, write_results

    rows = [ResultRecord(track="steering", split="pool-steer", sequence=name, method="net") for name in NAMES]
    write_results(tmp_path / "results.json", rows)
    refused = submit(site, tmp_path, "--method", "net")
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
    assert "no estimates there as a board reads them (SEQUENCE.tum or .csv, masks as SEQ" in refused.stderr
    assert "only a results.json; add --results to send that, as reported\n" in refused.stderr


@pytest.mark.slow
def test_masks_in_a_folder_are_sent_as_they_lie(site, tmp_path):
    import cv2

    for name in image_names(0):
        file = tmp_path / "masks" / f"{name}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(file), np.full((48, 64), 255, np.uint8))
    sent = submit(
        site, tmp_path / "masks", "--method", "net", "--split", "pool-masks", "--track", "detection", "--json"
    )
    assert sent.exit_code == 0, sent.output
    assert "predictions of 1 sequence, 3 images" in sent.stderr
    assert "no estimate is sent for pool-02: counted as failed there" in sent.stderr
    found = json.loads(sent.stdout)
    assert (found["state"], found["track"]) == ("done", "detection")
    assert found["failures"] == {"pool-02": "no estimate was sent for this sequence"}


@pytest.mark.parametrize(
    ("args", "token", "message", "code"),
    [
        (["--method", "x", "--split", "slam-99"], None, "this leaderboard accepts submissions to pool-masks", 1),
        (["--method", "x"], None, "--split: expected the split that was predicted, one of", 2),
        (["--method", "x" * 90, "--split", "pool-test"], None, "oysterbench: key 'method': expected at most 80", 1),
        (["--method", "x", "--split", "pool-test"], "oyb_0_wrong", "refused: the token is unknown", 1),
        (["--method", "x", "--split", "pool-test", "--track", "detection"], None, "--track: pool-test has slam", 1),
        (["--method", "x", "--publish", "--no-wait"], None, "it cannot be combined with --no-wait", 2),
    ],
)
def test_what_cannot_be_is_said_in_one_line(site, estimates, args, token, message, code):
    sent = submit(site, estimates, *args, token=token)
    assert sent.exit_code == code
    assert message in sent.stderr


def test_a_token_is_read_from_a_file_and_shown_nowhere(site, estimates, tmp_path, monkeypatch):
    monkeypatch.delenv("OYSTERBENCH_TOKEN", raising=False)
    (tmp_path / "token").touch(0o600)
    (tmp_path / "token").write_text(f"{site.token}\n")
    args = ["submit", str(estimates), "--to", site.url, "--method", "filed", "--split", "pool-test", "--no-wait"]
    none = CliRunner().invoke(main, args)
    said = "token in --team-token-file FILE or OYSTERBENCH_TOKEN; the operators of the board give one"
    assert f"expected a team's {said}" in none.stderr
    sent = CliRunner().invoke(main, [*args, "--team-token-file", str(tmp_path / "token")])
    assert sent.exit_code == 0, sent.output
    assert site.token not in sent.output
    assert "chmod" not in sent.stderr
    (tmp_path / "token").chmod(0o644)
    shared = CliRunner().invoke(main, [*args, "--team-token-file", str(tmp_path / "token")])
    assert f"{tmp_path / 'token'}: others on this machine may read this token; `chmod 600" in shared.stderr
    absent = CliRunner().invoke(main, [*args, "--team-token-file", str(tmp_path / "none")])
    assert (
        absent.stderr
        == f"oysterbench: --team-token-file: {tmp_path / 'none'}: No such file or directory; expected a team's {said}\n"
    )


def test_a_server_that_is_not_there_is_a_network_failure(tmp_path):
    quick = Patience(attempts=2, first_wait_s=0.01)
    with pytest.raises(NetworkError, match="nothing answers at this address"):
        Client("http://127.0.0.1:9", "x", quick, starting_s=0).splits()
    with pytest.raises(NetworkError, match="nothing answers at this address"):
        Client("http://no-such-board.invalid", "x", quick).splits()  # at once: it is not starting
    with pytest.raises(HubError, match="expected the address of a leaderboard"):
        Client("board.example")


@pytest.mark.parametrize("page", [None, b"<!doctype html><p>our lab"])
def test_an_address_of_something_else_is_called_that(page):
    found = {} if page is None else {"api/submissions/splits": page}
    with serving(Honest, found) as other:
        client = Client(other.url, "x", Patience(attempts=1))
        with pytest.raises(HubError, match="no leaderboard that takes submissions is there"):
            client.splits()


@pytest.mark.parametrize("given", [{"sequences": ["../private"]}, {"sequences": ["/private"]}, {"split": "/own.toml"}])
def test_no_name_that_a_server_gives_leads_out_of_the_folder_that_is_sent(estimates, given):
    (estimates.parent / "private.tum").write_bytes((estimates / "pool-01.tum").read_bytes())
    offered = {"split": "x", "tracks": ["slam"], "hidden": True, "takes": ["estimates"], "sequences": ["x"], **given}
    answer = json.dumps({"splits": [offered], "limits": {"upload_bytes": 1 << 20, "file_bytes": 1 << 20}})
    with serving(Honest, {"api/submissions/splits": answer.encode()}) as board:
        args = ["submit", str(estimates), "--to", board.url, "--method", "x", "--split", "x", "--check"]
        sent = CliRunner().invoke(main, args, env={"OYSTERBENCH_TOKEN": "x"})
    assert sent.exit_code == 1
    assert sent.stderr.startswith(
        f"oysterbench: {board.url}: expected names of splits and sequences of letters, digits"
    )


def test_a_split_that_is_misspelled_is_told_with_the_one_that_was_meant(site, estimates):
    sent = submit(site, estimates, "--method", "x", "--split", "pool-tset")
    assert "pool-val; did you mean pool-test" in sent.stderr


def test_a_server_that_has_answered_is_waited_for(site):
    client = Client(site.url, site.token, Patience(attempts=2, first_wait_s=0.01))
    client.splits()
    client._pool = Client("http://127.0.0.1:9", "x")._pool
    client.url = "http://127.0.0.1:9"
    with pytest.raises(NetworkError, match="no answer after 2 attempts"):
        client.splits()


def test_a_server_that_is_starting_is_waited_for():
    told = []
    found = {"api/submissions/splits": b'{"splits": [], "limits": {}}'}
    with serving(Honest, found) as there:
        port = int(there.url.rsplit(":", 1)[1])
    client = Client(f"http://127.0.0.1:{port}", "x", Patience(attempts=1), notify=told.append)
    with ThreadPoolExecutor() as pool:
        asked = pool.submit(client.splits)
        until(lambda: bool(told))
        with serving(Honest, found, port):
            assert asked.result(30) == {"splits": [], "limits": {}}
    assert told == [f"http://127.0.0.1:{port}: nothing answers yet; trying for 60 s"]


def test_nothing_is_asked_of_a_server_where_there_is_nothing_to_send(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_TOKEN", "x")
    args = ["submit", str(tmp_path / "absent"), "--to", "http://127.0.0.1:9", "--method", "x"]
    sent = CliRunner().invoke(main, args)
    assert (sent.exit_code, "absent: no such file or folder; expected results" in sent.stderr) == (1, True)


def test_what_is_there_is_answered_while_nothing_of_it_was_sent(site, tmp_path):
    body = answers(tmp_path, case=11)
    first = site.server.send(site.token, body, method="twice")
    query = urlencode({"method": "twice", "split": "pool-test", "digest": hashlib.sha256(body).hexdigest()})
    with closing(http.client.HTTPConnection("127.0.0.1", site.server.port, timeout=30)) as connection:
        connection.putrequest("POST", f"/api/submissions?{query}")
        connection.putheader("Authorization", f"Bearer {site.token}")
        connection.putheader("Content-Type", "application/zip")
        connection.putheader("Content-Length", str(len(body)))
        connection.endheaders()
        answer = connection.getresponse()
        assert (first[0], answer.status, answer.getheader("Connection")) == (201, 200, "close")
        assert json.loads(answer.read())["id"] == first[1]["id"]


def test_a_refusal_is_no_reason_to_try_again(site):
    client = Client(site.url, site.token, Patience(attempts=3, first_wait_s=60))
    with pytest.raises(Refused, match="you have no such submission"):
        client.get("0" * 16)


def test_a_zip_archive_without_the_command(site, tmp_path):
    """As `curl --data-binary` sends it."""
    status, made = site.server.send(site.token, answers(tmp_path, case=9), method="curl")
    assert status == 201
    assert made["page"] == f"/submit/{made['id']}"
    status, made = site.server.send(site.token, zipped({"pool-01.tum": b"1 2 3 4 0 0 0 1\n"}), method="curl", split="")
    assert (status, made["error"]) == (422, "split")
