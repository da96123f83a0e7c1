"""Reports and maps as axe-core sees them, and their width on a telephone."""

from __future__ import annotations

import pytest

from oysterbench.mapping import MapSettings
from oysterbench.report import html_report
from oysterbench.report.density_files import map_page
from tests.helpers.browser import CHROMIUM
from tests.helpers.flat_reef import LANE, FlatReef, scattered
from tests.helpers.pages import LegiblePages
from tests.mapping.test_density_map import map_of
from tests.report.test_report import EVERYTHING, many

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Addresses, by what they show."""
    folder = tmp_path_factory.mktemp("pages")
    found = map_of(FlatReef(LANE[:4], scattered(-0.6, 1.8)), settings=MapSettings(cell_m=0.5))
    texts = {
        "one sequence": html_report(EVERYTHING[:4], "oysterbench eval slam"),
        "several sequences": html_report(many(), "oysterbench eval slam"),
        "map": map_page(found, "oysterbench map", ["grid.csv", "mosaic.png"]),
    }
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: (folder / f"{name}.html").as_uri() for name in texts}


class TestReportsAndMaps(LegiblePages):
    """By the addresses of `pages`."""
