"""`oysterbench submit`, and the form in the browser, against a server in a process of its own."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import HubError, NetworkError
from oysterbench.hub.sources import Patience
from oysterbench_leaderboard.submissions.client import Client, Refused
from tests.helpers.browser import CHROMIUM, browsing
from tests.helpers.pool import NAMES, answers, estimate, image_names, steered, tum, zipped
from tests.helpers.served import Server, lay, running


class Site:
    """A server, with the tokens of its teams."""

    def __init__(self, folder, server: Server, tokens: dict[str, str]) -> None:
        self.folder, self.server, self.tokens = folder, server, tokens
        self.url = f"http://127.0.0.1:{server.port}"
        self.token = tokens["reef lab"]


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


def test_what_is_wrong_is_found_before_anything_is_sent(site, estimates):
    (estimates / "pool-02.tum").write_text("1 2 3 4 0 0 0 1\n2 3 4 5 0 0 0\n")
    before = site.server.ask("GET", "/api/submissions", token=site.token)[2]
    sent = submit(site, estimates, "--method", "pike", "--split", "pool-test")
    assert sent.exit_code == 1
    assert "oysterbench: pool-02.tum:2: expected 8 numbers" in sent.stderr
    assert sent.stderr.count("\n") == 1
    assert site.server.ask("GET", "/api/submissions", token=site.token)[2] == before


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


def test_a_run_that_left_no_estimates_is_sent_by_its_results(site, tmp_path):
    """As one of the track steering is, whose commands are not kept."""
    from oysterbench.results.records import ResultRecord, write_results

    rows = [ResultRecord(track="steering", split="pool-steer", sequence=name, method="net") for name in NAMES]
    write_results(tmp_path / "results.json", rows)
    refused = submit(site, tmp_path, "--method", "net")
    assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
    assert "no estimates there, only a results.json; add --results to send that, as reported" in refused.stderr


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
    assert "predictions of 1 sequences, 3 images" in sent.stderr
    assert "no estimate is sent for pool-02: counted as failed there" in sent.stderr
    found = json.loads(sent.stdout)
    assert (found["state"], found["track"]) == ("done", "detection")
    assert found["failures"] == {"pool-02": "no estimate was sent for this sequence"}


@pytest.mark.parametrize(
    ("args", "token", "message", "code"),
    [
        (["--method", "x", "--split", "slam-99"], None, "this leaderboard accepts submissions to pool-masks", 1),
        (["--method", "x"], None, "--split: expected the split that was predicted, one of", 2),
        (["--method", "x" * 90, "--split", "pool-test"], None, "refused: key 'method': expected at most 80", 1),
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
    (tmp_path / "token").write_text(f"{site.token}\n")
    args = ["submit", str(estimates), "--to", site.url, "--method", "filed", "--split", "pool-test", "--no-wait"]
    none = CliRunner().invoke(main, args)
    assert "expected a team's token in --team-token-file FILE or OYSTERBENCH_TOKEN" in none.stderr
    sent = CliRunner().invoke(main, [*args, "--team-token-file", str(tmp_path / "token")])
    assert sent.exit_code == 0, sent.output
    assert site.token not in sent.output


def test_a_server_that_is_not_there_is_a_network_failure(tmp_path):
    quick = Patience(attempts=2, first_wait_s=0.01)
    with pytest.raises(NetworkError, match="nothing answers at this address"):
        Client("http://127.0.0.1:9", "x", quick).splits()
    with pytest.raises(HubError, match="expected the address of a leaderboard"):
        Client("board.example")


def test_a_server_that_has_answered_is_waited_for(site):
    client = Client(site.url, site.token, Patience(attempts=2, first_wait_s=0.01))
    client.splits()
    client._pool = Client("http://127.0.0.1:9", "x")._pool
    client.url = "http://127.0.0.1:9"
    with pytest.raises(NetworkError, match="no answer after 2 attempts"):
        client.splits()


def test_nothing_is_asked_of_a_server_where_there_is_nothing_to_send(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_TOKEN", "x")
    args = ["submit", str(tmp_path / "absent"), "--to", "http://127.0.0.1:9", "--method", "x"]
    sent = CliRunner().invoke(main, args)
    assert (sent.exit_code, "absent: no such file or folder; expected results" in sent.stderr) == (1, True)


def test_a_refusal_is_no_reason_to_try_again(site):
    client = Client(site.url, site.token, Patience(attempts=3, first_wait_s=60))
    with pytest.raises(Refused, match="you have no such submission"):
        client.get("0" * 16)


# The form:


def csrf_in(page: bytes) -> str:
    found = re.search(rb'name="csrf" value="([0-9a-f]{64})"', page)
    assert found
    return found[1].decode()


def test_the_form_takes_a_submission_from_its_sending_to_its_withdrawal(site, tmp_path):
    ask = site.server.ask
    origin = {"Origin": site.url}
    _, headers, page = ask("GET", "/submit/new")
    assert b"Sign in" in page
    cookie = {"Cookie": headers["set-cookie"].split(";")[0]}
    plain = {**origin, "Content-Type": "application/x-www-form-urlencoded"}

    wrong = urlencode({"csrf": csrf_in(page), "token": "oyb_1_2"})
    status, _, again = ask("POST", "/submit/sign-in", wrong, {**plain, **cookie})
    assert status == 401
    assert b"the token is unknown" in again

    right = urlencode({"csrf": csrf_in(page), "token": site.token})
    status, headers, _ = ask("POST", "/submit/sign-in", right, {**plain, **cookie})
    assert (status, headers["location"]) == (303, "/submit/new")
    cookie = {"Cookie": headers["set-cookie"].split(";")[0]}
    page = ask("GET", "/submit/new", headers=cookie)[2]
    assert b"Signed in as <b>reef lab</b>" in page

    def send(files):
        parts = {"csrf": csrf_in(page), "split": "pool-test slam", "method": "by hand", "url": "", "summary": "a <b> c"}
        body = b"".join(
            f'--b\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n'.encode() for k, v in parts.items()
        )
        for name, data in files.items():
            body += f'--b\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n\r\n'.encode() + data
            body += b"\r\n"
        kind = {"Content-Type": "multipart/form-data; boundary=b"}
        return ask("POST", "/submit/new", body + b"--b--\r\n", {**origin, **cookie, **kind})

    status, _, refused = send({"pool-01.tum": b"1 2 3\n"})
    assert status == 422
    assert b'role="alert"' in refused
    assert b'value="by hand"' in refused, "what was typed is still there"
    status, _, refused = send({"pool-01.tum": b"1 2 3 4 5\n", "pool-02.tum": b"x"})
    assert (status, b"pool-01.tum:1: expected 8 numbers" in refused) == (422, True)

    files = {f"{name}.tum": tum(estimate(k, case=3), tmp_path) for k, name in enumerate(NAMES)}
    status, headers, _ = send(files)
    assert status == 303
    place = headers["location"]
    assert send(dict(reversed(files.items())))[1]["location"] == place, "in another order they are the same"
    site.server.wait(site.token, place.rpartition("/")[2])
    page = ask("GET", place, headers=cookie)[2]
    assert b"has been scored, and is private" in page
    small = urlencode({"csrf": csrf_in(page)})
    assert ask("POST", f"{place}/publish", small, {**plain, **cookie})[0] == 303
    page = ask("GET", place, headers=cookie)[2]
    assert b"and is published" in page
    why = urlencode({"csrf": csrf_in(page), "reason": "<i>wrong</i> camera"})
    assert ask("POST", f"{place}/withdraw", why, {**plain, **cookie})[0] == 303
    page = ask("GET", place, headers=cookie)[2]
    assert b"&lt;i&gt;wrong&lt;/i&gt; camera" in page
    out = urlencode({"csrf": csrf_in(ask("GET", "/submit/new", headers=cookie)[2])})
    assert ask("POST", "/submit/sign-out", out, {**plain, **cookie})[0] == 303
    assert ask("GET", place, headers=cookie)[0] == 401


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
def test_a_browser_without_scripts_walks_from_signing_in_to_the_record(site, tmp_path):
    """On a phone. With OYSTERBENCH_PICTURES naming a folder, pictures of the pages are left there."""
    file = tmp_path / "answers.zip"
    file.write_bytes(answers(tmp_path, case=21))

    def fits(name):
        if pictures := os.environ.get("OYSTERBENCH_PICTURES"):
            (Path(pictures) / f"{name}.png").write_bytes(browser.picture())
        assert browser.value("document.documentElement.scrollWidth <= innerWidth"), name

    with browsing() as browser:
        browser.look(390, dark=True, script=False)
        browser.go(f"{site.url}/submit/new")
        fits("submit-sign-in")
        browser.value(f"document.querySelector('#token').value = {site.token!r}")
        browser.follow("document.querySelector('main form button').click()")
        assert "Signed in as reef lab" in browser.value("document.querySelector('main').textContent")
        assert "oysterbench_session" not in browser.value("document.cookie"), "no script can read it"
        fits("submit-new")
        browser.value("document.querySelector('#split').value = 'pool-test slam'")
        browser.value("document.querySelector('#method').value = 'by browser'")
        chosen = browser.call("Runtime.evaluate", expression="document.querySelector('#file')")["result"]["objectId"]
        browser.call("DOM.setFileInputFiles", files=[str(file)], objectId=chosen)
        browser.follow("document.querySelector('form[enctype] button').click()")
        place = browser.value("location.pathname")
        browser.go(f"{site.url}/submit/new")  # its page asks again by itself, which is no good moment to look
        site.server.wait(site.token, place.rpartition("/")[2])
        browser.go(f"{site.url}{place}")
        assert "has been scored, and is private" in browser.value("document.querySelector('main').textContent")
        fits("submit-done")
        browser.follow("document.querySelector('form[action$=publish] button').click()")
        assert "and is published" in browser.value("document.querySelector('main').textContent")
        fits("submit-published")
        browser.follow("document.querySelector('a[href^=\"/records/\"]').click()")
        assert browser.value("document.querySelector('h1').textContent") == "by browser"


def test_a_zip_archive_without_the_command(site, tmp_path):
    """As `curl --data-binary` sends it."""
    status, made = site.server.send(site.token, answers(tmp_path, case=9), method="curl")
    assert status == 201
    assert made["page"] == f"/submit/{made['id']}"
    status, made = site.server.send(site.token, zipped({"pool-01.tum": b"1 2 3 4 0 0 0 1\n"}), method="curl", split="")
    assert (status, made["error"]) == (422, "split")


# Operators:


def test_operators_make_teams_read_the_log_and_try_again(tmp_path):
    def run(*args):
        return CliRunner().invoke(main, ["leaderboard", *args, "--submissions", str(tmp_path / "private")])

    made = run("team", "add", "reef lab")
    assert made.exit_code == 0, made.output
    token = made.stdout.strip()
    assert re.fullmatch(r"oyb_[0-9a-f]{12}_[\w-]{43}", token)
    assert "reef lab" in run("team", "list").stdout
    assert token not in run("team", "list").stdout
    assert json.loads(run("team", "list", "--json").stdout)[0]["id"] == token.split("_")[1]
    assert run("team", "revoke", token.split("_")[1]).stdout.startswith("revoked: ")
    assert "token revoked" in run("submissions", "log").stdout
    assert run("submissions", "list").stdout == ""
    failed = run("submissions", "retry", "0" * 16)
    assert (failed.exit_code, "no submission of that id has failed" in failed.stderr) == (1, True)
