"""What pages show besides tables: frames of data sets, heat maps, scores against speed, intervals zoomed in."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from oysterbench.recipe import split_names
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.site import frames, numbers, render
from oysterbench_leaderboard.site.page import PageError
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.pages.compare_several import several_page
from oysterbench_leaderboard.site.pages.heat import heat_kind
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.literature import literature_page
from oysterbench_leaderboard.site.pages.speed import speed_card
from oysterbench_leaderboard.site.server import application
from tests.helpers.site_made import Client, Reading, make_site


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("board"))


@pytest.fixture(scope="module")
def site(made):
    return made[0]


@pytest.mark.parametrize(
    ("query", "kept"),
    [("?v={}", True), ("?v={}&more=1", True), ("?v=deadbeef0123", False), ("?v=", False), ("", False)],
)
def test_a_file_is_kept_for_good_under_the_name_of_its_own_version_alone(site, query, kept):
    client = Client(application(site, fresh_s=60.0))
    answer = client.get(f"/static/style.css{query.format(render.assets_version())}")
    client.close()
    assert (answer.status, "immutable" in answer.headers["cache-control"]) == (200, kept)


def html(page) -> str:
    return render.page_html(page, render.server_links())


def test_every_data_set_has_a_small_frame_of_a_sequence_of_its_own():
    assert set(frames.choices()) == set(split_names())
    for split, picture in frames.pictures().items():
        assert len(picture) <= frames.MOST_BYTES, split
        pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert pixels.shape[1] <= frames.WIDTH_PX, split
    assert set(frames.pictures()) == set(split_names()), "run `oysterbench leaderboard frames`"


def test_a_picture_is_small_whatever_is_in_it():
    noise = np.random.default_rng(1).integers(0, 255, (1080, 1440, 3), dtype=np.uint8)
    data = frames.small_webp(noise)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == (420, 560, 3)
    assert len(data) < len(cv2.imencode(".webp", noise, [cv2.IMWRITE_WEBP_QUALITY, 82])[1]) / 4


def test_the_first_page_leads_with_val_and_shows_a_frame_of_it(site):
    page = home_page(site)
    assert [cards[0].name for cards in page.context["cards"].values()] == [
        "slam-val",
        "seg-val",
        "seg-val",
        "steer-val",
    ]
    read = Reading(html(page))
    pictures = [str(one["src"]).partition("?")[0] for one in read.all("img")]
    assert pictures[0] == "/static/frame-slam-val.webp"
    assert all(one.get("alt") for one in read.all("img"))
    assert len(set(pictures)) == len(frames.pictures())


def test_a_heat_map_has_the_score_of_every_record_on_every_sequence(site):
    info = site.index.boards("slam")[0]
    by_sequence, by_conditions = board_page(site, "slam", "slam-val").context["heats"]
    assert [column.key for column in by_sequence.columns[1:]] == list(info.sequences)
    for row in by_sequence.rows:
        digest = row.cells[0].path.rpartition("/")[2]
        known = site.index.sequence_means(digest)
        for name, cell in zip(info.sequences, row.cells[1:], strict=True):
            assert cell.value == pytest.approx(known.get(name, {}).get("score", 0.0))
            assert cell.kind.startswith("heat-")
    counts = [int(column.unit.rpartition("n = ")[2]) for column in by_conditions.columns[1:]]
    assert min(counts) >= 2, "a class of one sequence is that sequence, which has a column already"
    assert "Classes of one sequence are in the table above" in by_conditions.notes[0]
    murky = next(i for i, column in enumerate(by_conditions.columns) if column.key == "water murky")
    for line, of in zip(by_conditions.rows, by_sequence.rows, strict=True):
        values = [
            cell.value for cell, column in zip(of.cells, by_sequence.columns, strict=True) if column.unit == "murky"
        ]
        assert line.cells[murky].value == pytest.approx(sum(values) / len(values))


def test_what_is_worse_than_chance_is_drawn_in_a_colour_of_its_own(site):
    assert [heat_kind(value, 0.8) for value in (-0.1, 0.0, 0.4, 0.8)] == ["below", "heat-0", "heat-5", "heat-10"]
    assert heat_kind(math.nan, 1.0) == "soft"
    assert heat_kind(1.0, 2.0, lower_is_better=True) == "heat-5"


def test_intervals_below_zero_are_drawn_with_a_mark_at_zero():
    axis = numbers.bars_axis([(-0.2, -0.05), (0.1, 0.3)])
    bar = numbers.bar(-0.2, -0.1, -0.05, axis, "-0.25 to 0.35")
    assert axis[0] < -0.2
    assert 0 < bar.low < bar.middle < bar.high < bar.zero < 1
    assert numbers.bar(-0.2, -0.1, -0.05) is None, "on an axis of shares"


def test_intervals_are_zoomed_to_the_better_half_and_the_others_are_cut(site):
    rows = site.index.page(site.index.boards("slam")[0].id, Query()).rows
    table = board_page(site, "slam", "slam-val").table
    column = [column.key for column in table.columns].index("interval")
    bars = [row.cells[column].bar for row in table.rows]
    lows = [row.low for row in rows]
    assert min(bar.low for bar in bars[: len(bars) // 2]) >= 0
    assert bars[lows.index(min(lows))].low < 0
    assert "drawn from" in bars[0].about


def test_a_record_all_of_whose_runs_failed_has_no_speed(site):
    info = site.index.boards("slam")[0]
    rows = site.index.page(info.id, Query()).rows
    assert rows[0].method in str(speed_card(info, rows).plot)
    failed = [replace(rows[0], method="lost", failures=rows[0].runs), *rows[1:]]
    assert "lost" not in str(speed_card(info, failed).plot)
    assert speed_card(info, rows[:2]) is None


def test_no_record_stretches_the_axis_of_speeds(site):
    info = site.index.boards("slam")[0]
    rows = site.index.page(info.id, Query()).rows
    for speed, told in ((1e12, "(1e+12) boast"), (1e-9, "(1e-09) boast")):
        boast = replace(rows[0], method="boast", metrics={**rows[0].metrics, "realtime_factor": speed})
        plot = str(speed_card(info, [boast, *rows[1:]]).plot)
        ticks = [float(text) for text in re.findall(r'text-anchor="middle">([^<]+)</text>', plot)]
        assert 0.005 <= min(ticks) <= max(ticks) <= 1000.0
        assert len(ticks) < 20
        assert told in plot


def test_any_number_of_ticked_records_stand_side_by_side(site, made):
    names = [made[1]["carp2"], "cod", "gap", "eel", "drift"]
    page = several_page(site, names)
    means, pairs, *heats = page.tables
    assert len(means.rows) == len(pairs.rows) == len(names)
    assert len(heats) == 2
    rows = {row.cells[0].value: row for row in pairs.rows}
    keys = [column.key for column in pairs.columns]
    digests = {column.heading: column.key for column in pairs.columns}
    there = rows["carp"].cells[keys.index(digests["drift"])]
    back = rows["drift"].cells[keys.index(digests["carp"])]
    assert there.value == pytest.approx(-back.value)
    assert (there.small, back.small) == ("better", "worse")
    read = Reading(html(page))
    assert not read.wrong
    assert page.data["means"]["carp"]["score"] == pytest.approx(site.row(names[0]).score)


def test_records_of_no_common_board_and_too_many_are_refused(site):
    with pytest.raises(PageError, match="these records share no board"):
        several_page(site, ["carp", "cod", "unet"])
    with pytest.raises(PageError, match="expected 50 records at most, got 51"):
        several_page(site, ["carp"] * 51)


def test_literature_stands_by_data_with_its_source_once(site):
    page = literature_page(site)
    groups = page.context["by_track"]["SLAM"]
    assert [group.data for group in groups] == ["harbour <1>", "lake"]
    assert sum(len(group.table.rows) for group in groups) == len(page.table.rows) == len(site.literature)
    assert Reading(html(page)).text.count("Somebody 2020") == 1
