"""A board of dives of which some are lost: what it shows of them on its page and in the terminal, and what it folds."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import pytest

from oysterbench.results.records import aggregate
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.boards.memory import MemoryIndex
from oysterbench_leaderboard.boards.tables import board_table, history_table, machines_note
from oysterbench_leaderboard.boards.vehicle import lacks
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.compare_several import several_page
from oysterbench_leaderboard.site.pages.data import split_page
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made
from tests.helpers.site_made import Reading

DIVERGED = {"score": 0.0001, "ate_percent": 34000.0, "ate_rmse_m": 51000.0, "ate_rotation_rmse_deg": 120.0}
SAID = {
    "sensors": ["mono", "imu"],
    "online": True,
    "code": "https://github.com/reef/slam",
    "paper": "A. Bee, C. Dee: Reefs. 2022, doi:10.1109/xy",
}


def said(record: Record, **changes) -> Record:
    """The same of a method that says what it is; changes: of its results."""
    return replace(record, results=tuple(replace(one, info={"method": SAID}, **changes) for one in record.results))


def diverging(record: Record, *sequences: str) -> Record:
    """The same, far off on some sequences."""
    results = [
        replace(one, metrics={**one.metrics, **DIVERGED}) if one.sequence in sequences else one
        for one in record.results
    ]
    return replace(record, results=tuple(results))


RECORDS = {
    "steady": said(record_made("steady_filter", skill=0.8)),
    "brave": said(diverging(record_made("brave_mono[15-options-6dfa4bf9]", skill=0.9, failed=("val-08",)), "val-07")),
    "gap": record_made("gap", skill=0.7, without=("val-06",)),
}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    made = RecordStore(tmp_path_factory.mktemp("board"))
    for record in RECORDS.values():
        made.add(record)
    return made


@pytest.fixture(scope="module")
def site(store, tmp_path_factory):
    return Site(open_index(store, str(tmp_path_factory.mktemp("index") / "index.sqlite")))


def html(page) -> str:
    return render.page_html(page, render.server_links())


def shown(table, name: str) -> dict[str, str]:
    """Column -> text of the row of a method."""
    texts = next(texts for texts in table.texts if any(text.startswith(name) for text in texts))
    return dict(zip([column.key for column in table.columns], texts, strict=True))


def test_what_diverged_failed_or_was_not_answered_is_lost_and_in_no_error(site):
    table = board_page(site, "slam", "slam-val").tables[0]
    assert {name: shown(table, name)["lost"] for name in ("steady", "brave", "gap")} == {
        "steady": "0",
        "brave": "2",
        "gap": "1",
    }
    assert float(shown(table, "brave")["ate_percent"]) < 1.0
    columns = {column.key: column for column in table.columns}
    assert (columns["lost"].unit, columns["ate_percent"].unit) == ("of 8", "% of path, median")
    assert any("score below 0.25 is lost; errors are medians over the others" in note for note in table.notes)


def test_page_terminal_and_what_a_run_prints_say_the_same(site, store):
    (info,) = site.index.boards()
    page = site.index.page(info.id, Query())
    on_page, in_terminal = board_page(site, "slam", "slam-val").tables[0], board_table(page)
    for name, record in RECORDS.items():
        one, other = shown(on_page, name), shown(in_terminal, name)
        for key in ("score", "coverage", "ate_percent", "ate_rotation_rmse_deg", "realtime_factor"):
            assert one[key] == other[key], key
        assert one["lost"] == other["lost"]
        if name != "gap":  # a run is over what it was run on
            row, (printed,) = site.index.row(record.digest), aggregate(record.results)
            assert printed["metrics"]["score"] == row.score
            assert len(printed["lost"]) == row.lost
            assert {key: printed["metrics"][key] for key in row.metrics} == pytest.approx(dict(row.metrics))


def test_both_indices_order_by_what_is_lost(site, store):
    (info,) = site.index.boards()
    for index in (site.index, MemoryIndex(store)):
        rows = index.page(info.id, Query(sort="lost", descending=True)).rows
        assert [(row.method[:5], row.lost) for row in rows] == [("brave", 2), ("gap", 1), ("stead", 0)]
    assert "sort=lost" in html(board_page(site, "slam", "slam-val"))


def test_no_page_shows_an_error_of_what_diverged_but_by_sequence(site):
    brave, steady, gap = (RECORDS[name].digest for name in ("brave", "steady", "gap"))
    metrics = record_page(site, brave).tables[1]
    assert shown(metrics, "ATE")["sequences"] == "6 of 8"
    for table in (
        metrics,
        compare_page(site, brave, steady).tables[1],
        several_page(site, [brave, steady, gap]).tables[0],
    ):
        assert not any("34000" in text or "4857" in text for texts in table.texts for text in texts), table.title
    versus = compare_page(site, brave, steady).tables[1]
    assert shown(versus, "ATE")["shared"] == "6"
    assert "2 of 8" in Reading(html(record_page(site, brave))).text


def test_settings_are_folded_and_only_what_is_not_usual_is_said(site, tmp_path):
    text = Reading(html(board_page(site, "slam", "slam-val"))).text
    assert "slam 3 with its default settings" in text
    before, after = html(board_page(site, "slam", "slam-val")).split("<summary>All settings</summary>")
    assert "velocity_step_s" not in before
    assert "velocity_step_s" in after.split("</details>")[0]
    store = RecordStore(tmp_path / "board")
    usual = RECORDS["steady"]
    store.add(said(usual, settings={**usual.results[0].settings, "align": "sim3"}))
    other = Site(open_index(store, str(tmp_path / "index.sqlite")))
    assert (
        "slam 3, align = sim3, otherwise with its default" in Reading(html(board_page(other, "slam", "slam-val"))).text
    )


def test_code_and_paper_share_a_column_with_a_link_each(site):
    page = html(board_page(site, "slam", "slam-val"))
    assert 'href="https://github.com/reef/slam"' in page
    assert 'href="https://doi.org/10.1109/xy"' in page
    assert "Bee et al. 2022" in page


def test_one_is_not_many(tmp_path):
    store = RecordStore(tmp_path / "board")
    record = record_made()
    store.add(replace(record, results=record.results[:1]))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    texts = [Reading(html(page)).text for page in (home_page(site), board_page(site, "slam", "slam-val"))]
    texts.append(Reading(html(split_page(site, "slam-val"))).text)
    for text in texts:
        assert "1 sequences" not in text
        assert "1 records" not in text
        assert "all 1" not in text
    assert "1 current record," in texts[1]
    assert "1 sequence" in texts[1]


def test_speeds_of_several_machines_are_said_to_be(tmp_path):
    store = RecordStore(tmp_path / "board")
    fast, slow = record_made("fast"), record_made("slow")
    store.add(said(fast, hardware={"cpu": "Big", "cores": 64}))
    store.add(said(slow, hardware={"cpu": "Small", "cores": 1}))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    note = "Speeds are of different machines (Big, 64 cores; Small, 1 core): they do not compare methods."
    (info,) = site.index.boards()
    assert set(board_table(site.index.page(info.id, Query())).notes) >= {note}
    digests = [row.digest for row in site.index.page(info.id, Query()).rows]
    pages = [board_page(site, "slam", "slam-val"), compare_page(site, *digests), several_page(site, digests)]
    assert all(note in Reading(html(page)).text for page in pages)
    rows = site.index.page(info.id, Query()).rows
    assert machines_note(rows, ("score", "realtime_factor")) == note
    assert machines_note(rows, ("iou", "recall")) == "", "no speed is shown"


def test_a_machine_of_a_long_name_is_one_all_the_same(tmp_path):
    store = RecordStore(tmp_path / "board")
    for name, cpu in (("fast", "BUY NOW " * 240), ("slow", "Small")):
        store.add(said(record_made(name), hardware={"cpu": cpu, "cores": 16}))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    (note,) = [note for note in board_table(site.index.page(info.id, Query())).notes if "different machines" in note]
    assert "BUY NOW BUY NOW" in note
    assert "\N{HORIZONTAL ELLIPSIS}" in note
    assert ", 16 cores" in note
    assert len(note) < 250


def few(tmp_path):
    """A site of a board of three sequences, on which two methods have the same scores and one is worse."""
    store = RecordStore(tmp_path / "board")
    lacking = tuple(f"val-0{k}" for k in range(4, 9))
    results = record_made("carp", without=lacking).results
    for name in ("carp", "tench"):
        same = [replace(one, method=name) for one in results]
        store.add(replace(record_made("carp", without=lacking), method=name, results=same))
    store.add(record_made("worse", skill=0.1, without=lacking))
    return Site(open_index(store, str(tmp_path / "index.sqlite")))


def test_places_that_are_shared_are_written_the_same_everywhere_and_are_no_ranks(tmp_path):
    site = few(tmp_path)
    (info,) = site.index.boards()
    page = board_page(site, "slam", "slam-val")
    terminal = board_table(site.index.page(info.id, Query()))
    for table in (page.table, terminal):
        assert [texts[0] for texts in table.texts] == ["(=1)", "(=1)", "(3)"]
    history = history_table(site.index.method("worse", None), {info.id: info})
    assert "(3)" in history.texts[0]
    assert "(=1)" in html(page)
    rows = list(csv.DictReader(io.StringIO(represent(page, ".csv").decode())))
    assert [(row["rank"], row["place"]) for row in rows] == [("", "1"), ("", "1"), ("", "3")]


def test_one_machine_needs_no_word(site):
    assert "different machines" not in html(board_page(site, "slam", "slam-val"))


def test_a_board_says_which_sensors_its_vehicle_lacks(tmp_path):
    store = RecordStore(tmp_path / "board")
    store.add(record_made(split="slam-mini"))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    said_ = "The vehicle of slam-mini has no second camera, DVL, sonar, pressure, compass or altimeter: a method"
    for table in (board_page(site, "slam", "slam-mini").tables[0], board_table(site.index.page(info.id, Query()))):
        assert any(note.startswith(said_) for note in table.notes)
    assert lacks("slam-val", "slam") == "" == lacks("somebody's", "slam") == lacks("seg-val", "segmentation")


def test_a_former_recipe_is_history_on_every_track_of_its_split(tmp_path):
    store = RecordStore(tmp_path / "board")
    before = {"track": "segmentation", "split": "seg-val"}
    old = record_made("old", **before, created="2026-10-01T00:00:00Z")
    boxes = record_made("boxes", track="detection", split="seg-val", created="2026-10-01T00:00:00Z")
    new = record_made("new", **before)
    new = replace(new, results=tuple(replace(one, split_digest="d1" * 32) for one in new.results))
    digests = {record.method: store.add(record) for record in (old, boxes, new)}
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    assert {info.split_digest[:2] for info in site.index.boards() if info.newest} == {"d1"}
    assert sum(info.former for info in site.index.boards()) == 2
    home = Reading(html(home_page(site))).text
    assert "new" in home
    assert "boxes" not in home
    assert "Detection" not in home
    said_ = "The recipe of seg-val has changed since"
    assert said_ in Reading(html(record_page(site, digests["boxes"]))).text
    former = next(info for info in site.index.boards() if info.former)
    assert said_ in Reading(html(board_page(site, former.track, "seg-val", former.id))).text
    table = board_table(site.index.page(former.id, Query()))
    assert "seg-val has another recipe since: this board is history." in table.notes


def test_words_of_water_and_density_are_explained_and_empty_conditions_have_no_column(site):
    table = split_page(site, "slam-mini").tables[0]
    (note,) = table.notes
    assert "clear from a Secchi depth of 4 m" in note
    assert "dense from 15 oysters" in note
    assert all(any(row.cells[i].value for row in table.rows) for i in range(len(table.columns)))


def test_a_command_breaks_between_its_words_alone(site):
    page = html(split_page(site, "slam-mini"))
    assert '<span class="word">oysterbench</span> <span class="word">render</span>' in page


def test_a_record_folds_the_settings_of_its_evaluator_too(site):
    page = html(record_page(site, RECORDS["steady"].digest))
    before, after = page.split("<summary>All settings</summary>")
    assert "velocity_step_s" not in before
    assert "velocity_step_s" in after.split("</details>")[0]


def test_several_side_by_side_say_how_much_each_lost(site):
    table = several_page(site, [record.digest for record in RECORDS.values()]).tables[0]
    assert [shown(table, name)["lost"] for name in ("steady", "brave", "gap")] == ["0", "2", "1"]
