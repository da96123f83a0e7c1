"""A real browser walks the site: board, record, comparison, submission; on a phone, in the dark, without scripts.

With OYSTERBENCH_PICTURES naming a folder, pictures of every page are left there to be looked at.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from oysterbench.hub.connections import server_settings
from oysterbench_leaderboard.site.export import export
from oysterbench_leaderboard.site.running import whole
from tests.helpers.browser import CHROMIUM
from tests.helpers.site_made import make_site

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")

CONTRAST = """
(() => {
  const light = ([r, g, b]) => {
    const linear = [r, g, b].map((c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
  };
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgb = (colour) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const behind = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour[3] > 200) return colour;
    }
    return [255, 255, 255, 255];
  };
  const wrong = [];
  for (const element of document.querySelectorAll("body *")) {
    const text = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!text || !element.checkVisibility() || element.closest(".skip, .unseen, title")) continue;
    const style = getComputedStyle(element);
    const ink = rgb(element instanceof SVGElement ? style.fill : style.color);
    const [a, b] = [light(ink), light(behind(element))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) wrong.push(`${element.tagName} ${element.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return wrong;
})()
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("board"))


@pytest.fixture(scope="module")
def address(made, tmp_path_factory):
    """Of a server that takes submissions."""
    import uvicorn

    site, _ = made
    app = whole(site.index, tmp_path_factory.mktemp("private"), workers=1)
    server = uvicorn.Server(uvicorn.Config(**{**server_settings(app, "127.0.0.1", 0, "on"), "log_config": None}))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        thread.join(0.05)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


def test_from_the_first_page_to_board_record_comparison_and_submission(browser, address):
    browser.look(1280)
    browser.messages.clear()
    browser.go(f"{address}/")
    browser.follow("document.querySelector('.boards h3 a').click()")
    assert browser.value("location.pathname") == "/boards/slam/slam-val"
    browser.follow("document.querySelector('tbody th a').click()")
    assert browser.value("document.querySelector('h1').textContent") == "carp"
    assert browser.value("document.querySelectorAll('svg.plot').length") == 32
    browser.follow("document.querySelector('a[href*=\"/compare?\"]').click()")
    assert browser.value("document.querySelector('h1').textContent") == "carp against cod"
    browser.follow("[...document.querySelectorAll('nav a')].find((a) => a.textContent === 'Submit').click()")
    browser.follow("document.querySelector('main a.button').click()")
    assert browser.value("location.pathname") == "/submit/new"
    assert browser.value("document.querySelector('main form input[type=password]') !== null")
    assert browser.messages == []


def test_two_ticked_records_are_compared_without_scripts(browser, address):
    browser.look(1280, script=False)
    browser.go(f"{address}/boards/slam/slam-val")
    # The protocol still clicks where scripts of the page do not run.
    for i in (0, 2):
        browser.value(f"document.querySelectorAll('td.choose input')[{i}].click()")
    browser.follow("document.querySelector('#compare button').click()")
    assert browser.value("document.querySelector('h1').textContent") == "carp against gap"
    browser.go(f"{address}/boards/slam/slam-val")
    browser.follow("[...document.querySelectorAll('thead a')].find((a) => a.textContent === 'Method').click()")
    assert browser.value("location.search") == "?sort=method"
    browser.look(1280)


def test_a_board_is_sorted_in_place_where_there_are_scripts(browser, address):
    browser.look(1280)
    browser.go(f"{address}/boards/slam/slam-val")
    browser.value("window.same = true")
    browser.value("[...document.querySelectorAll('thead a')].find((a) => a.textContent === 'Method').click()")
    browser.until("location.search === '?sort=method'")
    browser.until("document.querySelector('thead th[aria-sort]')?.textContent.trim().startsWith('Method')")
    assert browser.value("window.same")  # no new page was loaded
    browser.value("history.back()")
    browser.until("location.search === '' && document.querySelector('tbody td.rank').textContent.trim() === '=1'")
    assert browser.value("window.same")


def test_names_run_nothing(browser, address, made):
    browser.look(1280)
    browser.messages.clear()
    for path in ("/boards/slam/slam-val", f"/records/{made[1]['nasty0']}", f"/compare?a=carp&b={made[1]['nasty0']}"):
        browser.go(f"{address}{path}")
        assert browser.value("document.querySelectorAll('main script, main img').length") == 0
        assert "<script>alert(1)</script>" in browser.value("document.querySelector('main').textContent")
    assert browser.messages == []


def test_files_sort_and_link_from_the_disk(browser, made, tmp_path):
    export(made[0], tmp_path / "site")
    browser.look(1280)
    browser.messages.clear()
    browser.go((tmp_path / "site" / "index.html").as_uri())
    browser.follow("document.querySelector('.boards h3 a').click()")
    assert browser.value("document.querySelector('form')") is None
    methods = "[...document.querySelectorAll('#board tbody th a')].map((a) => a.textContent)"
    before = browser.value(methods)
    score = "[...document.querySelectorAll('thead button')].find((b) => b.textContent.trim() === 'Score')"
    browser.value(f"{score}.click()")
    assert browser.value(methods) == before[::-1]
    assert browser.value(f"{score}.closest('th').getAttribute('aria-sort')") == "ascending"
    browser.follow("document.querySelector('tbody th a').click()")
    browser.follow("document.querySelector('main a[href*=compare]').click()")
    assert " against " in browser.value("document.querySelector('h1').textContent")
    assert browser.messages == []


PAGES = {
    "home": "/",
    "board": "/boards/slam/slam-val",
    "record": "/records/{carp2}",
    "nasty": "/records/{nasty0}",
    "compare": "/compare?a={carp2}&b={cod}",
    "method": "/methods/carp",
    "data": "/data",
    "split": "/data/slam-val",
    "literature": "/literature",
    "submit": "/submit",
    "form": "/submit/new",
    "log": "/log",
    "about": "/about",
    "missing": "/nothing",
}


@pytest.mark.parametrize(
    ("width", "dark"),
    [
        (360, True),
        (1280, False),
        *(pytest.param(*look, marks=pytest.mark.slow) for look in ((360, False), (1280, True))),
    ],
)
def test_pages_fit_the_screen_and_can_be_read(browser, address, made, width, dark):
    browser.look(width, dark)
    pictures = os.environ.get("OYSTERBENCH_PICTURES")
    for name, path in PAGES.items():
        browser.go(address + path.format(**made[1]))
        assert browser.value("document.documentElement.scrollWidth") <= width, name
        assert browser.value(CONTRAST) == [], name
        small = "[...document.querySelectorAll('nav a, button, .button')].filter((e) => e.checkVisibility() && "
        small += "e.getBoundingClientRect().height < 24 && !e.closest('th, .legend')).map((e) => e.textContent)"
        assert browser.value(small) == [], name
        if pictures:
            Path(pictures, f"{name}-{width}-{'dark' if dark else 'light'}.png").write_bytes(browser.picture())


def test_the_keyboard_reaches_the_content_and_shows_where_it_is(browser, address):
    browser.look(1280)
    browser.go(f"{address}/boards/slam/slam-val")

    def press(key: str, code: int) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    press("Tab", 9)
    assert browser.value("document.activeElement.className") == "skip"
    assert browser.value("document.activeElement.getBoundingClientRect().left") >= 0
    browser.value("document.getElementById('board').dataset.kept = 'yes'")
    browser.value("document.activeElement.click()")
    press("Tab", 9)
    assert browser.value("document.activeElement.closest('main') !== null")
    seen = []
    for _ in range(30):
        press("Tab", 9)
        focus = "(() => { const e = document.activeElement, s = getComputedStyle(e); return [e.tagName, "
        seen.append(browser.value(focus + "parseFloat(s.outlineWidth) > 0 && s.outlineStyle !== 'none'] })()"))
    assert all(outlined for _, outlined in seen), str(seen)
    assert {"A", "INPUT", "BUTTON"} <= {tag for tag, _ in seen}
    assert browser.value("document.getElementById('board').dataset.kept") == "yes"  # else focus would have been lost
