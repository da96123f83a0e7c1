"""A board of single disturbances draws the score against the strength of each; no other board does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.render import page_html, server_links
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made

DIVES = {"val-01": ("none", 0), **{f"val-0{k + 1}": ("silt <b>", k) for k in (1, 2, 3)}}


def stressed(method: str, skill: float) -> Record:
    made = record_made(method, skill=skill)
    results = []
    for result in made.results:
        if result.sequence in DIVES:
            disturbance, strength = DIVES[result.sequence]
            results.append(replace(result, conditions={"disturbance": disturbance, "strength": strength}))
    return replace(made, results=tuple(results))


def page_of(folder: Path, *records: Record) -> Page:
    store = RecordStore(folder / "board")
    for record in records:
        store.add(record)
    return board_page(Site(open_index(store, str(folder / "index.sqlite")), ()), "slam", "slam-val")


def test_a_board_of_disturbances_draws_a_plot_for_each(tmp_path):
    page = page_of(tmp_path, stressed("carp", 0.8), stressed("cod", 0.4))
    (drawing,) = page.context["drawings"]
    assert [card.title for card in drawing.cards] == ["silt <b>"]
    plot = str(drawing.cards[0].plot)
    assert 'data-label="carp"' in plot
    assert 'data-label="cod"' in plot
    html = page_html(page, server_links())
    assert "Individual disturbances" in html
    assert "silt <b>" not in html
    assert "start, " not in str(drawing.legend)


def test_two_records_of_one_method_are_drawn_apart(tmp_path):
    one, two = stressed("carp", 0.8), replace(stressed("carp", 0.5), team="another")
    (drawing,) = page_of(tmp_path, one, two).context["drawings"]
    assert str(drawing.legend).count("<span>carp (") == 2


def test_another_board_draws_nothing(tmp_path):
    page = page_of(tmp_path, record_made("carp"), record_made("cod", skill=0.3))
    assert page.context["drawings"] == []
    assert "Individual disturbances" not in page_html(page, server_links())
