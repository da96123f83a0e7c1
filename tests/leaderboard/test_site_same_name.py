"""Methods of several teams under one name: none speaks for another's."""

from __future__ import annotations

from typing import Any

import pytest

from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.page import PageError
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.compare_several import several_page
from oysterbench_leaderboard.site.pages.method import method_page
from oysterbench_leaderboard.site.paths import record_path
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made

SQUID: dict[str, Any] = {"summary": "Broken, do not use. Use squid instead.", "url": "https://squid.example/"}


@pytest.fixture
def digests(tmp_path) -> dict[str, str]:
    """Of two methods of one name, the later by another team, and of one that is compared with them."""
    store = RecordStore(tmp_path / "board")
    made = {
        "carp": record_made(summary="A tightly coupled filter.", url="https://reeflab.example/carp"),
        "other": record_made(team="others", skill=0.3, created="2026-11-02T12:00:00Z", **SQUID),
        "eel": record_made("eel", skill=0.7),
    }
    return {name: store.add(record) for name, record in made.items()}


@pytest.fixture
def site(tmp_path, digests) -> Site:
    return Site(open_index(RecordStore(tmp_path / "board"), str(tmp_path / "index.sqlite")))


def test_each_teams_description_stands_by_its_own_name(site):
    text = render.page_html(method_page(site, "carp"), render.server_links())
    head = text[text.index("<h1>") : text.index("<table")]
    assert "2 teams have published under this name" in head
    assert head.index("<li>reef lab") < head.index("<li>others"), "who had the name first stands first"
    for team, summary, url in (
        ("reef lab", "A tightly coupled filter.", "https://reeflab.example/carp"),
        ("others", SQUID["summary"], SQUID["url"]),
    ):
        (line,) = [line for line in head.splitlines() if line.startswith(f"<li>{team}: ")]
        assert summary in line
        assert f'href="{url}"' in line
    alone = render.page_html(method_page(site, "eel"), render.server_links())
    assert "<p>By reef lab.</p>" in alone


def test_a_withdrawn_record_describes_no_method_that_another_team_still_has(tmp_path, digests):
    store = RecordStore(tmp_path / "board")
    store.change_status(digests["other"], "withdrawn", "It speaks of another's method.")
    page = method_page(Site(open_index(store, str(tmp_path / "index.sqlite"))), "carp")
    text = render.page_html(page, render.server_links())
    assert "<p>By reef lab. <a" in text
    assert SQUID["summary"] not in text


def test_a_name_of_several_teams_is_compared_by_no_name(site, digests):
    hints = {record_path(digests[name]) for name in ("carp", "other")}
    for ask in (
        lambda: compare_page(site, "carp", "eel"),
        lambda: compare_page(site, "eel", "carp"),
        lambda: several_page(site, ["eel", "carp"]),
    ):
        with pytest.raises(PageError, match="several teams have a method named carp") as told:
            ask()
        assert told.value.status == 409
        assert set(told.value.hints) == hints
    page = compare_page(site, digests["carp"], "eel")
    assert page.query == {"a": digests["carp"], "b": digests["eel"]}
    assert compare_page(site, digests["other"], digests["carp"]).title.startswith(
        "carp (others) against carp (reef lab)"
    )
