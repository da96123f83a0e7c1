"""The site is built without a warning, and every link in it leads somewhere."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from docs.check import problems
from tests.helpers.browser import CHROMIUM, browsing
from tests.helpers.paths import ROOT


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The site, in some 10 s of processor time."""
    pytest.importorskip("mkdocs", reason="MkDocs is not installed: pip install 'oysterbench[docs]'")
    folder = tmp_path_factory.mktemp("docs") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    quiet = os.environ | {
        "NO_MKDOCS_2_WARNING": "1",
        "http_proxy": "http://127.0.0.1:9",
        "https_proxy": "http://127.0.0.1:9",
    }
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=quiet)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    return folder


@pytest.mark.slow
def test_the_site_is_built_strictly_and_has_no_dead_link(built):
    assert list(problems(built)) == []
    page = (built / "concepts" / "images.html").read_text()
    assert "<math" in page
    assert "arithmatex" not in page


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")
@pytest.mark.parametrize("served", [False, True], ids=["opened as files", "served"])
def test_search_finds_pages(built, served):
    """A browser starts no worker, and reads no JSON, from file://."""
    handler = partial(QuietHandler, directory=str(built))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, browsing() as browser:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}" if served else built.as_uri()
        browser.go(f"{address}/index.html")
        browser.value("document.querySelector('[data-md-component=search-query]').focus()")
        browser.call("Input.insertText", text="alignment")
        browser.call("Input.dispatchKeyEvent", type="keyUp", key="t")
        browser.until("document.querySelectorAll('a.md-search-result__link').length > 3")
        found = browser.value("[...document.querySelectorAll('a.md-search-result__link')].map((link) => link.href)")
        server.shutdown()
    assert found[0].startswith(f"{address}/concepts/alignment.html")


class QuietHandler(SimpleHTTPRequestHandler):
    """Files of a folder, without a line for each request."""

    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.fixture
def site(tmp_path):
    """Two pages with one link of each kind."""
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="https://example.org/x">x</a>'
    )
    (tmp_path / "b.html").write_text('<h1 id="there">B</h1><a href="#there">here</a><a href="a.html">a</a>')
    return tmp_path


def test_a_site_whose_links_lead_somewhere_has_no_problems(site):
    assert list(problems(site)) == []


@pytest.mark.parametrize(
    ("html", "why"),
    [
        ('<a href="c.html">c</a>', "a.html: c.html: no such file"),
        ('<a href="b.html#nowhere">b</a>', "a.html: b.html#nowhere: no such anchor"),
        ('<img src="missing.png">', "a.html: missing.png: no such file"),
        ('<script src="https://cdn.example.org/x.js"></script>', "loaded from outside"),
        ('<link rel="stylesheet" href="//fonts.example.org/x.css">', "loaded from outside"),
        ('<a href="http://no host/">x</a>', "no address of http or https"),
    ],
)
def test_what_is_wrong_with_a_site_is_said_in_a_line(site, html, why):
    (site / "a.html").write_text(html)
    (found,) = problems(site)
    assert found.endswith(why)
