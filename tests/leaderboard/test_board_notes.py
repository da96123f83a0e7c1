"""The notes below a board, in the terminal and on the site."""

from __future__ import annotations

from dataclasses import replace

import pytest

from oysterbench.report.renderers import html_table
from oysterbench.report.table import Column, Table, TableRow
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.boards.tables import board_table
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.site.works import code_cell, paper_cell
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made


@pytest.mark.parametrize(
    ("split", "told"),
    [
        ("slam-train", "slam-val."),
        ("seg-closeup", "seg-val."),
        ("slam-val", ""),
        ("slam-mini", ""),
        ("slam-stress", ""),
        ("my-train", ""),
    ],
)
def test_a_board_of_pictures_to_learn_on_says_so(split, told, tmp_path):
    store = RecordStore(tmp_path / "board")
    store.add(record_made(split=split, track="segmentation" if split.startswith("seg") else "slam"))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    notes = [note for note in board_page(site, info.track, split).tables[0].notes if "a training split" in note]
    assert notes == [
        note for note in board_table(site.index.page(info.id, Query())).notes if "a training split" in note
    ]
    assert [note.split()[-1] for note in notes] == ([told] if told else [])


@pytest.mark.parametrize(
    ("split", "tier", "hidden", "told"),
    [
        ("slam-mini", "scored", None, True),
        ("slam-mini", "baseline", None, False),
        ("slam-test", "scored", None, False),
        ("my-reef", "scored", False, True),
        ("my-reef", "scored", True, False),
        ("my-reef", "baseline", False, False),
    ],
)
def test_a_board_says_where_those_who_sent_estimates_could_make_the_truth(split, tier, hidden, told, tmp_path):
    store = RecordStore(tmp_path / "board")
    made = record_made(split=split, tier=tier)
    store.add(replace(made, results=tuple(replace(one, hidden=hidden) for one in made.results)))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    for table in (board_page(site, "slam", split).tables[0], board_table(site.index.page(info.id, Query()))):
        assert any("anyone can make its ground truth" in note for note in table.notes) == told


@pytest.mark.parametrize(
    ("split", "track", "said"),
    [
        ("slam-val", "slam", "A failed run scores 0; a sequence that is lacking counts as failed."),
        (
            "steer-val",
            "steering",
            "A failed run scores as the worst command at each image; a sequence that is lacking scores 0, or the "
            "lowest of a ranked method there if that is less.",
        ),
    ],
)
def test_boards_and_comparisons_say_what_a_failure_and_a_lacking_sequence_score(split, track, said, tmp_path):
    store = RecordStore(tmp_path / "board")
    one, other = (store.add(record_made(method, split=split, track=track)) for method in ("one", "other"))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    compared = compare_page(site, one, other).tables
    tables = (board_page(site, track, split).tables[0], board_table(site.index.page(info.id, Query())))
    for notes in [table.notes for table in tables] + [[note for table in compared for note in table.notes]]:
        assert any(said in note for note in notes), notes


@pytest.mark.parametrize("track", ["segmentation", "detection", "steering"])
def test_a_board_that_shows_no_coverage_does_not_refer_to_it(track, tmp_path):
    store = RecordStore(tmp_path / "board")
    store.add(record_made(split="a-val", track=track))
    table = board_page(Site(open_index(store, str(tmp_path / "index.sqlite"))), track, "a-val").tables[0]
    assert not any("coverage" in note for note in table.notes), table.notes


def test_boards_of_one_split_are_told_apart_by_the_settings_that_are_not_usual(tmp_path):
    store = RecordStore(tmp_path / "board")
    usual = record_made(method="usual", track="slam")
    store.add(usual)
    other = {**usual.results[0].settings, "align": "sim3"}
    results = tuple(replace(one, method="without scale", settings=other) for one in usual.results)
    store.add(replace(usual, method="without scale", results=results))
    index = open_index(store, str(tmp_path / "index.sqlite"))
    names = {board_table(index.page(info.id, Query())).title for info in index.boards()}
    evaluator = usual.results[0].evaluator_version
    assert len(names) == 2
    assert any(name.endswith(f"({evaluator}, align = sim3)") for name in names)


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ({"sensors": ["mono", "imu"], "online": True, "paper": "A paper"}, ("mono, imu", "online", "", "A paper")),
        ({"sensors": ["stereo"], "online": False, "code": "https://x.org"}, ("stereo", "offline", "https://x.org", "")),
        ({"sensors": ["<b>all</b>"], "online": "yes", "code": ["x"], "paper": "A\u202epaper"}, ("", "", "", "")),
        ("everything", ("", "", "", "")),
    ],
)
def test_a_board_says_what_a_method_reads_and_when_and_where_it_is_from(said, shown, tmp_path):
    record = record_made()
    results = [replace(result, info={**result.info, "method": said}) for result in record.results]
    store = RecordStore(tmp_path / "board")
    store.add(replace(record, results=tuple(results)))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    (info,) = site.index.boards()
    (row,) = site.index.page(info.id, Query()).rows
    assert (row.sensors, row.mode, row.code, row.paper) == shown
    table = board_page(site, info.track, info.split).tables[0]
    columns = {column.key for _, column in table.shown}
    assert [key in columns for key in ("sensors", "work")] == [bool(shown[0]), bool(shown[2] or shown[3])]
    given = dict(zip([column.key for column in table.columns], table.rows[0].cells, strict=True))
    assert (given["code"].value, given["paper"].value) == shown[2:]


def test_a_record_names_its_code_and_paper_with_their_addresses(tmp_path):
    said = {
        "sensors": ["mono"],
        "code": "https://github.com/reef/slam",
        "paper": "A. <Bee>: Reefs. arXiv 1902.09199, 2022",
    }
    record = record_made()
    store = RecordStore(tmp_path / "board")
    digest = store.add(replace(record, results=tuple(replace(one, info={"method": said}) for one in record.results)))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    page = render.page_html(record_page(site, digest), render.server_links())
    assert 'code: <a href="https://github.com/reef/slam" rel="nofollow noopener external">slam</a>' in page
    assert (
        'paper: <a href="https://arxiv.org/abs/1902.09199" rel="nofollow noopener external">A. &lt;Bee&gt;: Reefs'
        in page
    )


@pytest.mark.parametrize(
    ("citation", "name", "address"),
    [
        ("", "", ""),
        ("A. Bee, C. Dee: On reefs. Sea 3(2), 2021. doi:10.1/x", "Bee et al. 2021", ""),
        ("A. Bee: On reefs. Sea 3(2), 2021. doi:10.1109/X.2020.307.", "Bee 2021", "https://doi.org/10.1109/X.2020.307"),
        (
            "J.-M. Gómez Ruiz, C. Dee: Reefs. arXiv 1902.09199, 2022",
            "Gómez Ruiz et al. 2022",
            "https://arxiv.org/abs/1902.09199",
        ),
        ("A. Bee: Reefs. 2019; A. Bee, C. Dee: Seas. 2018", "Bee 2019", ""),
        ("Reefs, https://x.org/a?b=1.", "paper", "https://x.org/a?b=1"),
        ("javascript:alert(2020)", "javascript 2020", ""),
    ],
)
def test_a_paper_is_named_in_a_few_words_and_linked_where_it_has_an_address(citation, name, address):
    cell = paper_cell(citation)
    assert (cell.text or "", cell.url, cell.about) == (name, address, citation)
    html = html_table(Table("", (Column("paper"),), (TableRow((cell,)),)))
    assert html.count("<a ") == bool(address)


@pytest.mark.parametrize("odd", ["http://[x", "https://a]b/c", "http://a\u2100b.org/x"])
def test_an_address_that_cannot_be_opened_is_shown_without_a_link(odd, tmp_path):
    assert (code_cell(odd).value, code_cell(odd).url, paper_cell(f"A. Bee: Reefs. 2020, {odd}").url) == (odd, "", "")
    record = record_made()
    store = RecordStore(tmp_path / "board")
    said = {"code": odd, "paper": odd}
    store.add(replace(record, results=tuple(replace(one, info={"method": said}) for one in record.results)))
    site = Site(open_index(store, str(tmp_path / "index.sqlite")))
    assert f'href="{odd}' not in render.page_html(board_page(site, "slam", "slam-val"), render.server_links())


def test_code_is_named_as_where_it_lies_names_it():
    places = ("https://gitlab.com/reef/slam", "https://www.slam.org/x", "baselines/gtsam_vi", "ftp://x/y", "")
    assert [code_cell(place).text for place in places] == ["slam", "slam.org", "gtsam_vi", "y", None]
    assert [code_cell(place).url for place in places] == [*places[:2], "", "", ""]
