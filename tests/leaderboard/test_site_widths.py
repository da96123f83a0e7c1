"""Tables and commands on narrow and wide screens: what fits, and how one sees that there is more."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site.export import export
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.browser import CHROMIUM
from tests.helpers.records_made import record_made

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")

NAMES = ("orb_slam3_mono_inertial", "basalt_mono[15-options-6dfa4bf9]")
SAID = {
    "sensors": ["mono", "imu", "dvl", "sonar", "pressure", "compass", "altimeter"],
    "online": False,
    "code": "https://github.com/HKUST-Aerial-Robotics/VINS-Fusion",
    "paper": "S. Leutenegger, V. Usenko: A platform. 2020, doi:10.1109/LRA.2019.2961227",
}
SHADE = "getComputedStyle(document.querySelector('#board .scroll'), '::after').visibility"
TABLE = "document.querySelector('#board .scroll')"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The site over records as long as those of published systems."""
    store = RecordStore(tmp_path_factory.mktemp("board"))
    for k, name in enumerate(NAMES):
        record = record_made(name, "oysterbench", 0.9 - 0.1 * k, tier="baseline")
        store.add(replace(record, results=tuple(replace(one, info={"method": SAID}) for one in record.results)))
    found = tmp_path_factory.mktemp("site") / "site"
    export(Site(open_index(store, str(tmp_path_factory.mktemp("index") / "index.sqlite"))), found)
    return found


def go(browser, folder, page: str, width: int) -> None:
    browser.look(width)
    browser.go((folder / page / "index.html").as_uri())


def test_a_board_fits_a_screen_of_1280_px_with_all_that_a_visitor_needs(browser, folder):
    go(browser, folder, "boards/slam/slam-val", 1280)
    assert browser.value(f"{TABLE}.scrollWidth <= {TABLE}.clientWidth")
    assert browser.value(SHADE) == "hidden"
    heads = browser.value("[...document.querySelectorAll('#board thead th')].map((th) => th.innerText.split('\\n')[0])")
    assert {"Rank", "Method", "Score", "Coverage", "ATE", "Speed", "Lost", "Sensors", "Code", "Date"} <= set(heads)


def test_a_table_that_goes_on_beside_the_screen_shows_a_shade_there_until_its_end(browser, folder):
    go(browser, folder, "boards/slam/slam-val", 390)
    assert browser.value(f"{TABLE}.scrollWidth > {TABLE}.clientWidth")
    browser.until(f"{SHADE} === 'visible'")
    browser.value(f"{TABLE}.scrollLeft = 100000")
    browser.until(f"{SHADE} === 'hidden'")


def test_the_name_of_a_row_stays_while_its_table_is_scrolled(browser, folder):
    go(browser, folder, "boards/slam/slam-val", 390)
    browser.value(f"{TABLE}.scrollLeft = 100000")
    left = "({}).getBoundingClientRect().left".format
    names = f"[...{TABLE}.querySelectorAll('tbody th, thead th.head')]"
    browser.until(f"{names}.every((th) => Math.abs({left('th')} - {left(TABLE)}) < 3)")
    assert browser.value(f"{names}.every((th) => th.offsetWidth < 0.5 * {TABLE}.clientWidth)")


def test_pictures_of_the_data_stand_side_by_side_on_a_telephone(browser, folder):
    go(browser, folder, ".", 390)
    columns = "getComputedStyle(document.querySelector('.samples')).gridTemplateColumns.split(' ').length"
    assert browser.value(columns) == 2


@pytest.mark.parametrize("page", ["submit", "data/slam-mini", "boards/slam/slam-val"])
def test_no_option_of_a_command_is_broken_into_lines(browser, folder, page):
    go(browser, folder, page, 390)
    words = "[...document.querySelectorAll('code .word')]"
    assert browser.value(f"{words}.length") > 2
    tall = f"{words}.filter((e) => e.offsetHeight > 30).map((e) => e.textContent)"
    assert browser.value(tall) == []
