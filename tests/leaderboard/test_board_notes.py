"""The notes below a board, in the terminal and on the site."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oysterbench_leaderboard.board import Query
from oysterbench_leaderboard.index import open_index
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.store import RecordStore
from oysterbench_leaderboard.tables import board_table
from tests.helpers.records_made import record_made


@pytest.mark.parametrize(
    ("split", "told"),
    [("slam-train", "slam-val."), ("seg-closeup", "seg-val."), ("slam-val", ""), ("slam-mini", ""), ("my-train", "")],
)
def test_a_board_of_pictures_to_learn_on_says_so(split, told, tmp_path):
    store = RecordStore(tmp_path / "board")
    store.add(record_made(split=split, track="segmentation" if split.startswith("seg") else "slam"))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    notes = [note for note in board_page(site, info.track, split).tables[0].notes if "to learn on" in note]
    assert notes == [note for note in board_table(site.index.page(info.id, Query())).notes if "to learn on" in note]
    assert [note.split()[-1] for note in notes] == ([told] if told else [])


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ({"sensors": ["mono", "imu"], "online": True, "paper": "A paper"}, ("mono, imu", "online")),
        ({"sensors": ["stereo"], "online": False}, ("stereo", "offline")),
        ({"sensors": ["<b>all</b>"], "online": "yes"}, ("", "")),
        ("everything", ("", "")),
    ],
)
def test_a_board_says_what_a_method_reads_and_when(said, shown, tmp_path):
    record = record_made()
    results = [replace(result, info={**result.info, "method": said}) for result in record.results]
    store = RecordStore(tmp_path / "board")
    store.add(replace(record, results=tuple(results)))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    (row,) = site.index.page(info.id, Query()).rows
    assert (row.sensors, row.mode) == shown
    table = board_page(site, info.track, info.split).tables[0]
    assert {column.key for _, column in table.shown} >= ({"sensors", "mode"} if shown[0] else set())
    assert ("sensors" in {column.key for _, column in table.shown}) == bool(shown[0])
