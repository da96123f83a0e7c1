"""Pages of the site as axe-core sees them, and their width on a telephone."""

from __future__ import annotations

import pytest

from oysterbench_leaderboard.site.export import export
from tests.helpers.browser import CHROMIUM
from tests.helpers.pages import LegiblePages
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


class TestSite(LegiblePages):
    """By the addresses of `pages`."""
