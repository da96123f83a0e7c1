"""Pages of the site as axe-core sees them, and their width on a telephone."""

from __future__ import annotations

import pytest

from oysterbench_leaderboard.site.export import export
from tests.helpers.axe import WHY_NOT, axe_file, violations
from tests.helpers.browser import CHROMIUM, browsing
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
def site(tmp_path_factory):
    """Its pages as files, and the digests of its records."""
    made, digests = make_site(tmp_path_factory.mktemp("board"))
    folder = tmp_path_factory.mktemp("site") / "site"
    export(made, folder)
    return folder, digests


@pytest.fixture(scope="module")
def browser():
    with browsing() as found:
        yield found


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_page_is_wider_than_a_telephone(browser, site, dark):
    folder, digests = site
    browser.look(390, dark)
    for page in PAGES:
        browser.go((folder / page.format(**digests) / "index.html").as_uri())
        root = "document.documentElement"
        assert browser.value(f"{root}.scrollWidth <= {root}.clientWidth"), page


@pytest.mark.skipif(axe_file() is None, reason=WHY_NOT)
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_axe_finds_nothing_wrong(browser, site, width, dark):
    folder, digests = site
    browser.look(width, dark)
    for page in PAGES:
        browser.go((folder / page.format(**digests) / "index.html").as_uri())
        assert violations(browser) == [], page
