"""The form for people: sessions that no other site can use, and names that stay text."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import urlencode

import pytest

from tests.helpers.browser import CHROMIUM, browsing
from tests.helpers.pool import NAMES, answers, estimate, tum
from tests.helpers.served import Site, csrf_in, lay, running


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("form")
    tokens = lay(folder)
    with running(folder) as server:
        yield Site(folder, server, tokens)


def test_the_session_is_out_of_reach_of_scripts_and_of_other_sites(site):
    _, headers, _ = site.server.ask("GET", "/submit/new")
    cookie = headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert "path=/submit" in cookie
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["cache-control"] == "no-store"


@pytest.mark.parametrize("path", ["/api/submissions", "/submit/new"])
def test_another_method_is_answered_with_those_that_are_allowed(site, path):
    status, headers, _ = site.server.ask("PUT", path)
    assert status == 405
    assert set(headers["allow"].split(", ")) == {"GET", "HEAD", "POST"}
    assert site.server.ask("HEAD", "/submit/new")[0] == 200


@pytest.mark.parametrize(
    "what",
    ["no csrf", "wrong csrf", "odd csrf", "other origin", "null origin", "odd origin", "no origin", "other session"],
)
def test_a_form_that_is_not_of_this_site_changes_nothing(site, tmp_path, what):
    _, made = site.server.send(site.token, answers(tmp_path, case=88), method="csrf")
    cookie, csrf = site.signed_in()
    fields = {"csrf": {"no csrf": "", "wrong csrf": "0" * 64, "odd csrf": "\u00e9"}.get(what, csrf)}
    if what == "other session":
        fields["csrf"] = site.signed_in(site.tokens["others"])[1]
    origins = {"other origin": "https://evil.example", "null origin": "null", "odd origin": "http://[x"}
    origins["no origin"] = ""
    more = {"Origin": origins[what]} if what in origins else {}
    status, _, page = site.post_form(f"/submit/{made['id']}/withdraw", fields, cookie, **more)
    assert status == 403
    assert b'role="alert"' in page
    assert "origin:" in site.events()[-1]["why"]
    assert site.server.wait(site.token, made["id"])["state"] == "done"


def test_a_form_with_a_file_and_a_wrong_csrf_token_is_refused(site, tmp_path):
    cookie, _ = site.signed_in()
    body = b'--b\r\nContent-Disposition: form-data; name="csrf"\r\n\r\n' + b"0" * 64
    body += b'\r\n--b\r\nContent-Disposition: form-data; name="file"; filename="x.zip"\r\n\r\n' + answers(tmp_path)
    headers = {"Content-Type": "multipart/form-data; boundary=b", "Cookie": cookie}
    headers["Origin"] = f"http://127.0.0.1:{site.server.port}"
    assert site.server.ask("POST", "/submit/new", body + b"\r\n--b--\r\n", headers)[0] == 403


NASTY = "<script>alert(1)</script><img src=x onerror=alert(2)>"


def test_scripts_in_names_are_kept_as_text_and_escaped_on_every_page(site, tmp_path):
    status, made = site.server.send(
        site.token, answers(tmp_path), method=NASTY, summary='"><svg onload=alert(3)>', url="https://x/?<b>'\""
    )
    assert status == 201, made
    cookie, _ = site.signed_in()
    found = site.server.wait(site.token, made["id"])
    for page in ("/submit/new", found["page"]):
        text = site.server.ask("GET", page, headers={"Cookie": cookie})[2].decode()
        assert "&lt;script&gt;alert(1)" in text
        assert "<script>alert" not in text
        assert "<img" not in text
        assert "<svg onload" not in text


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
    assert b"send them under another name" in page
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
