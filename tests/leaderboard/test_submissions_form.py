"""The form for people: sessions that no other site can use, and names that stay text."""

from __future__ import annotations

import pytest

from tests.helpers.pool import answers
from tests.helpers.served import Site, lay, running


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


@pytest.mark.parametrize("what", ["no csrf", "wrong csrf", "other origin", "null origin", "no origin", "other session"])
def test_a_form_that_is_not_of_this_site_changes_nothing(site, tmp_path, what):
    _, made = site.server.send(site.token, answers(tmp_path, case=88), method="csrf")
    cookie, csrf = site.signed_in()
    fields = {"csrf": {"no csrf": "", "wrong csrf": "0" * 64}.get(what, csrf)}
    if what == "other session":
        fields["csrf"] = site.signed_in(site.tokens["others"])[1]
    origins = {"other origin": "https://evil.example", "null origin": "null", "no origin": ""}
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
