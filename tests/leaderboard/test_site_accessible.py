"""Pages of the site as axe-core sees them, and their width on a telephone."""

from __future__ import annotations

import pytest

from oysterbench_leaderboard.site.export import export
from tests.helpers.axe import WHY_NOT, axe_file
from tests.helpers.browser import CHROMIUM
from tests.helpers.pages import faults, too_wide
from tests.helpers.site_made import make_site

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")

PAGES = (
    "",
    "boards/slam/slam-val",
    "boards/steering/steer-val",
    "literature",
    "data/slam-val",
    "records/{carp2}",
    "about",
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Addresses, by where they are on the site."""
    made, digests = make_site(tmp_path_factory.mktemp("board"))
    folder = tmp_path_factory.mktemp("site") / "site"
    export(made, folder)
    return {page: (folder / page.format(**digests) / "index.html").as_uri() for page in PAGES}


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_page_is_wider_than_a_telephone(browser, pages, dark):
    assert too_wide(browser, pages, dark=dark) == []


@pytest.mark.skipif(axe_file() is None, reason=WHY_NOT)
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_axe_finds_nothing_wrong(browser, pages, width, dark):
    assert faults(browser, pages, width, dark=dark) == {}
