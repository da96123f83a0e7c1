"""The page on how to submit: the splits that this board accepts, and no others."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.prose import submit_page
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.submissions.catalogue import Catalogue
from tests.helpers.site_made import Reading, make_site


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Site:
    return make_site(tmp_path_factory.mktemp("board"))[0]


def text(page: Page) -> str:
    return Reading(render.page_html(page, render.server_links())).text


def test_a_board_lists_the_splits_that_it_accepts(site, served):
    accepted = Catalogue(served.values()).public()
    accepted.append({"split": "slam-mini", "tracks": ["slam"], "hidden": False, "takes": ["results"]})
    page = submit_page(replace(site, form="/submit/new", accepted=accepted))
    sent = {row.cells[1].value: row.cells[3].value for row in page.table.rows}
    assert set(sent) == {*served, "slam-mini"}
    assert sent["pool-val"].startswith("a TUM file for each sequence")
    assert sent["slam-mini"].startswith("a results.json of oysterbench run, marked as reported")
    assert "They are scored here" in text(page)
    assert page.table.rows[-1].cells[1].value == "slam-mini"  # after those whose estimates are scored
    assert "oysterbench download pool-val" in text(page)


def test_a_site_that_accepts_none_says_so(site):
    shown = text(submit_page(site))
    assert "This site accepts none" in shown
    assert "They are scored here" not in shown
    assert "slam-test" in shown
    assert "oysterbench download slam-val" in shown
