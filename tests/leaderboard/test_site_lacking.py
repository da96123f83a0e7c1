"""A record that lacks sequences of its board has on every page the score by which it is ranked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from oysterbench.report.table import Table
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.compare_several import several_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import MADE, record_made

LACKING = {track: tuple(MADE[track][0])[1:3] for track in ("slam", "segmentation", "steering")}
SPLITS = {"slam": "slam-val", "segmentation": "seg-val", "steering": "steer-val"}
SKILLS = {"slam": (0.8, 0.6), "segmentation": (0.8, 0.6), "steering": (-0.3, -0.2)}


def site_of(folder: Path, *records: Record) -> Site:
    store = RecordStore(folder / "board")
    for record in records:
        store.add(record)
    return Site(open_index(store, str(folder / "index.sqlite")))


def made(track: str) -> tuple[Record, Record]:
    """A record on all sequences, and one that lacks some."""
    (whole, part), split, without = SKILLS[track], SPLITS[track], LACKING[track]
    return (
        record_made("whole", skill=whole, track=track, split=split),
        record_made("part", skill=part, track=track, split=split, without=without),
    )


@pytest.mark.parametrize("track", LACKING)
def test_its_page_and_comparisons_have_the_score_of_the_ranking(track, tmp_path):
    whole, part = made(track)
    site = site_of(tmp_path, whole, part)
    row = site.index.row(part.digest)
    assert row.score is not None
    sequences, metrics = record_page(site, part.digest).tables[:2]
    assert metrics.rows[0].cells[2].value == pytest.approx(row.score)
    of_two = compare_page(site, whole.digest, part.digest)
    assert of_two.data["difference"]["difference"] == pytest.approx(site.index.row(whole.digest).score - row.score)
    several = several_page(site, [whole.digest, part.digest])
    assert several.data["means"]["part"][site.index.boards()[0].metric] == pytest.approx(row.score)
    lacking = next(line for line in sequences.rows if line.cells[0].value == LACKING[track][0])
    assert lacking.cells[0].mark == "not answered"


@pytest.mark.parametrize("state", ["reported", "withdrawn"])
@pytest.mark.parametrize("track", LACKING)
def test_where_nothing_is_ranked_pages_have_the_scores_of_the_board(track, state, tmp_path):
    whole, part = made(track)
    if state == "reported":
        whole, part = (replace(record, tier="reported") for record in (whole, part))
    site = site_of(tmp_path, whole, part)
    for record in (whole, part) if state == "withdrawn" else ():
        site.store.change_status(record.digest, "withdrawn", "a fault")
    site.index.refresh()
    row = site.index.row(part.digest)
    assert (row.place, row.state) == (None, "withdrawn" if state == "withdrawn" else "current")
    assert record_page(site, part.digest).tables[1].rows[0].cells[2].value == pytest.approx(row.score)


@pytest.mark.parametrize("track", LACKING)
def test_sequences_that_are_none_of_the_board_do_not_count_on_a_page_either(track, tmp_path):
    whole, part = made(track)
    more = replace(whole, tier="reported")
    site = site_of(tmp_path, more, part)
    sequences, metrics = record_page(site, more.digest).tables[:2]
    assert metrics.rows[0].cells[2].value == pytest.approx(site.index.row(more.digest).score)
    said = f"Not counted, as no ranked record of the board has them: {', '.join(sorted(LACKING[track]))}."
    assert said in sequences.notes
    over = f"also those that do not count here: {', '.join(sorted(LACKING[track]))}."
    assert any(note.endswith(over) for note in metrics.notes) == bool(more.data_set)
    for table in record_page(site, part.digest).tables[:2]:
        assert not any(note == said or note.endswith(over) for note in table.notes)


def test_a_sequence_that_both_of_two_lack_weighs_there_what_it_weighs_in_the_ranking(tmp_path):
    whole, part = made("segmentation")
    other = record_made("other", skill=0.5, track="segmentation", split="seg-val", without=LACKING["segmentation"])
    site = site_of(tmp_path, whole, part, other)
    found = compare_page(site, part.digest, other.digest).data["difference"]["difference"]
    assert found == pytest.approx(site.index.row(part.digest).score - site.index.row(other.digest).score)


def test_the_conditions_of_what_it_lacks_are_those_that_others_have(tmp_path):
    whole, part = made("slam")
    alone, both = site_of(tmp_path / "alone", whole), site_of(tmp_path / "both", whole, part)
    classes = [
        [cell.value for line in record_page(site, digest).tables[2].rows for cell in line.cells[:3]]
        for site, digest in ((alone, whole.digest), (both, part.digest))
    ]
    assert classes[0]
    assert classes[0] == classes[1]


def heat_of(site: Site, track: str, title: str) -> Table:
    heats = board_page(site, track, SPLITS[track]).context["heats"]
    return next(table for table in heats if title in table.title)


def test_heat_maps_have_every_sequence_in_its_class_whoever_is_first(tmp_path):
    whole = record_made("whole", skill=0.5)
    units = []
    for name, skill in (("worse", 0.2), ("better", 0.95)):
        site = site_of(tmp_path / name, whole, record_made("part", skill=skill, without=LACKING["slam"]))
        heat = heat_of(site, "slam", "by conditions")
        units.append([column.unit for column in heat.columns])
    assert site.index.page(site.index.boards()[0].id, Query()).rows[0].method == "part"
    assert units[0] == units[1]


def test_heat_maps_count_what_it_lacks_as_the_ranking_does(tmp_path):
    whole, part = made("steering")
    site = site_of(tmp_path, whole, part)
    heat = heat_of(site, "steering", "by sequence")
    row = next(line for line in heat.rows if line.cells[0].value == "part")
    values = [cell.value for cell in row.cells[1:]]
    assert sum(values) / len(values) == pytest.approx(site.index.row(part.digest).score)
