"""Numbers as pages write them: with the digits that their words stand on."""

from __future__ import annotations

from oysterbench.evaluate.statistics import Comparison, Interval
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.pages.compare import _compared_cells
from oysterbench_leaderboard.site.pages.compare_several import several_page
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.record import metrics_table, record_page
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made
from tests.helpers.site_made import Reading


def test_a_verdict_stands_beside_an_interval_that_shows_it():
    def texts(low, high):
        comparison = Comparison(8, 0.031, Interval(low, high), 6, 0, 2, "better")
        return [cell.text for cell in _compared_cells("score", comparison)[:2]]

    assert texts(0.00012, 0.066) == ["+0.0310", "+0.0001 to +0.0660"]
    assert texts(-0.00012, 0.066) == ["+0.031", "0.000 to +0.066"]


def test_a_record_without_paths_says_why_there_are_none_where_there_could_be_some(tmp_path):
    store = RecordStore(tmp_path)
    digests = {split: store.add(record_made(split=split)) for split in ("slam-val", "slam-test")}
    digests["seg-val"] = store.add(record_made(track="segmentation", split="seg-val"))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    said = {
        split: Reading(render.page_html(record_page(site, digest), render.server_links())).text
        for split, digest in digests.items()
    }
    assert "None to show: the record has no paths." in said["slam-val"]
    assert "None to show: the split is hidden." in said["slam-test"]
    assert "Paths and errors" not in said["seg-val"]


def test_no_two_columns_of_a_records_metrics_have_one_name(tmp_path):
    table = metrics_table(list(record_made().results), "x")
    heads = [column.heading for _, column in table.shown]
    assert len(heads) == len(set(heads))
    assert (heads[2], table.columns[2].unit) == ("Value", "median of errors, else mean")


def test_a_board_without_ranks_is_not_said_to_be_ranked(tmp_path):
    few = ("val-03", "val-04", "val-05", "val-06", "val-07", "val-08")
    said = {}
    for split, without in (("slam-mini", few), ("slam-val", ())):
        store = RecordStore(tmp_path / split)
        digests = [store.add(record_made(name, without=without, split=split)) for name in ("carp", "cod", "dab")]
        site = Site(open_index(store, str(tmp_path / f"{split}.sqlite")))
        pages = (board_page(site, "slam", split), several_page(site, digests), home_page(site))
        said[split] = [Reading(render.page_html(page, render.server_links())).text for page in pages]
    of_board, of_several, of_home = said["slam-mini"]
    assert "3 current records, placed by Score." in of_board
    assert "Placed by Score, as on their board." in of_several
    assert "with 95 % intervals" not in of_home
    of_board, of_several, of_home = said["slam-val"]
    assert "3 current records, ranked by Score." in of_board
    assert "Ranked by Score, as on their board." in of_several
    assert "Score, with 95 % intervals" in of_home
