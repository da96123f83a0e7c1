"""Page of a board: its records in order, sortable and filtered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any

from oysterbench.evaluate.metrics import SPEEDS, TRACKS, find_metric
from oysterbench.report.columns import STANDING_OF_TRACK, lost_column, lost_note, metric_column, standing_column
from oysterbench.report.table import Cell, Column, Table, TableRow, interval_column
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import STATES, BoardInfo, BoardPage, Query, Row
from oysterbench_leaderboard.boards.tables import (
    DATA_SET,
    NOT_RANKED,
    failures_note,
    has_data_set,
    learnt_on,
    machines_note,
    trust_note,
)
from oysterbench_leaderboard.boards.vehicle import carried, lacks
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Later, Page, PageError
from oysterbench_leaderboard.site.pages.compare import PAIRED
from oysterbench_leaderboard.site.pages.heat import classes_heat, scores_of, sequences_heat
from oysterbench_leaderboard.site.pages.ranks import ABOUT_TIERS, RANK, UNRANKED, rank_cells, state_mark
from oysterbench_leaderboard.site.pages.speed import speed_card
from oysterbench_leaderboard.site.pages.stress import stress_drawing
from oysterbench_leaderboard.site.paths import board_path, record_path, slug, split_path
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.site.works import work_cell
from oysterbench_leaderboard.storage.record import RANKED, TIERS

SIZES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Numbers of rows that a page may have: few, as each makes other pages, all of which take time and memory."""

MOST_ROWS = SIZES[-1]
LONGEST_TEXT = 100
"""Maximum number of characters in a text search; MOST_ROWS is that of rows on a page."""

HIDDEN = (
    "place",
    "team",
    "tier",
    "mode",
    "sequences",
    "runs",
    "state",
    "record",
    "code",
    "paper",
    "machine",
    "supersedes",
    "url",
)
"""Columns that only CSV and JSON have."""

MODE = "Online: each estimate uses only earlier data; offline: the whole sequence."

WORK = "The code and the paper that describes it, as given by the method."

FAILED = "Failed runs, and sequences without an estimate."

MOST_SHOWN = 5
"""Number of columns of metrics shown on the page beside the ranking one; CSV and JSON have all."""

NAMED = ("rank", "method", "team", "created", "data_set")
"""Keys that a board can be sorted by besides its metrics."""


def find_board(site: Site, track: str, split: str, board: str | None = None) -> BoardInfo:
    """Find a board by the slugs of its address; the newest of the split where no id is given. Raises PageError with
    links to those there are."""
    found = [info for info in site.index.boards() if slug(info.track) == track and slug(info.split) == split]
    for info in found:
        if info.id == board or (board is None and info.newest):
            return info
    if found:
        hints = {board_path(info): f"{info.split}, {info.evaluator_version}" for info in found}
        raise PageError(f"expected a board of {track} on {split}, got {board!r}", hints=hints)
    hints = {split_path(info.track, info.split): f"{info.track} on {info.split}" for info in site.index.boards()}
    raise PageError(f"no records of track {track!r} on split {split!r}", hints=hints or {"/": "all boards"})


def parse_query(asked: Mapping[str, Sequence[str]], size: int = 50) -> Query:
    """Parse the query in the address of a board; unknown keys are ignored, and the number of rows is rounded up to one
    of `SIZES`. Raises PageError (400)."""

    def last(key: str, default: str) -> str:
        values = asked.get(key) or [default]
        return values[-1]

    def chosen(key: str, known: Sequence[str]) -> tuple[str, ...]:
        values = [value for value in asked.get(key, ()) if value]
        for value in values:
            if value not in known:
                raise PageError(f"{key}: expected {', '.join(known)}, got {value!r:.60}", 400)
        return tuple(one for one in known if one in values)

    def whole(key: str, default: int, most: int) -> int:
        text = last(key, str(default))
        if not (text.isascii() and text.isdigit() and 1 <= int(text[:9]) <= most):
            raise PageError(f"{key}: expected a whole number from 1 to {most}, got {text!r:.60}", 400)
        return int(text)

    order = last("order", "asc")
    if order not in ("asc", "desc"):
        raise PageError(f"order: expected asc or desc, got {order!r:.60}", 400)
    text = last("q", "").strip()
    if len(text) > LONGEST_TEXT:
        raise PageError(f"q: expected at most {LONGEST_TEXT} characters, got {len(text)}", 400)
    states: Any = chosen("state", STATES) or ("current",)
    return Query(
        sort=last("sort", "rank") or "rank",
        descending=order == "desc",
        text=text,
        tiers=chosen("tier", TIERS),
        states=states,
        page=whole("page", 1, 10**6),
        size=next(one for one in SIZES if one >= whole("size", size, MOST_ROWS)),
    )


def asked_by(query: Query) -> dict[str, str | list[str]]:
    """Query as the parameters of an address, without those at their defaults."""
    found: dict[str, str | list[str]] = {
        "sort": "" if query.sort == "rank" else query.sort,
        "order": "desc" if query.descending else "",
        "q": query.text,
        "tier": list(query.tiers),
        "state": [] if query.states == ("current",) else list(query.states),
        "page": "" if query.page == 1 else str(query.page),
        "size": "" if query.size == Query().size else str(query.size),
    }
    return {key: value for key, value in found.items() if value}


def board_page(site: Site, track: str, split: str, board: str | None = None, query: Query | None = None) -> Page:
    """Page of a board, by the slugs of its address; the newest of the split where no id is given.

    Raises PageError where there is none, or where the query asks for a column or page that it does not have.
    """
    query = query or Query()
    info = find_board(site, track, split, board)
    loses = TRACKS[info.track].lost_below is not None
    sortable = (*NAMED, *(["lost"] if loses else []), info.metric, *info.columns)
    if query.sort not in sortable:
        raise PageError(f"sort: expected {', '.join(dict.fromkeys(sortable))}, got {query.sort!r:.60}", 400)
    path = board_path(info) if board else split_path(info.track, info.split)
    found = site.index.page(info.id, query)
    if query.page > found.pages:
        raise PageError(f"page: expected 1 to {found.pages}, got {query.page}", 404, {path: "the first page"})
    name = numbers.track_name(info.track)
    title = f"{name} on {info.split}" + ("" if board is None else f", {info.evaluator_version}")
    table = page_table(found, f"{title}: {_counted(found)}")
    others = [other for other in site.index.boards(info.track) if other.split == info.split and other.id != info.id]
    context = {
        "info": info,
        "paired": PAIRED,
        "name": name,
        "metric": metric_column(info.metric),
        "found": found,
        "asked": asked_by(query),
        "sorting": _sorting(table, query),
        "all_tiers": ABOUT_TIERS,
        "states": STATES,
        "others": [(board_path(other), other) for other in others],
        "permalink": board_path(info),
        "heats": heats(site, info, found.rows),
        "speed": speed_card(info, found.rows),
        "machines": machines_note(found.rows, info.columns),
        "drawings": [drawing] if (drawing := stress_drawing(site, info, found.rows)) else [],
        "has_ranks": any(row.rank is not None for row in found.rows),
        "settings": {key: numbers.setting_text(value) for key, value in info.settings.items()},
        "carried": carried(info.split),
    }
    data = Later(lambda: _data(found))
    return Page(path, title, "board.html", context, (table,), data, asked_by(query))


def heats(site: Site, info: BoardInfo, rows: Sequence[Row]) -> list[Table]:
    """Heat maps of the rows' scores by sequence and by conditions, each only where it adds to the board's table."""
    scores = scores_of(site, info, rows)
    return [] if scores is None else [table for table in (sequences_heat(scores), classes_heat(scores)) if table]


def _data(found: BoardPage) -> dict[str, Any]:
    """Content of the page's JSON."""
    data: dict[str, Any] = plain(
        {
            "board": asdict(found.board),
            "query": asdict(found.query),
            "total": found.total,
            "pages": found.pages,
            "rows": [asdict(row) for row in found.rows],
        }
    )
    return data


def _counted(found: BoardPage) -> str:
    records = numbers.count(found.total, "record")
    return records if found.pages == 1 else f"{records}, page {found.query.page} of {found.pages}"


def _sorting(table: Table, query: Query) -> dict[str, dict[str, Any]]:
    """Key of a column -> query that a click on its heading makes, and its present sort order."""
    found = {}
    for column in table.columns:
        if not column.sort:
            continue
        down_first = column.better == "higher" or column.sort == "created"
        now = query.sort == column.sort
        descending = not query.descending if now else down_first
        asked = asked_by(replace(query, sort=column.sort, descending=descending, page=1))
        state = ("descending" if query.descending else "ascending") if now else ""
        found[column.key] = {"query": asked, "state": state}
    return found


def page_table(found: BoardPage, title: str) -> Table:
    """Table of a board: rank, method, score with interval, coverage beside errors, failures, tier; digests in CSV."""
    info, rows = found.board, found.rows
    whole = has_data_set(info, rows)
    keys = [info.metric, *(key for key in info.columns if key != info.metric)]
    shown = {column.key for column in STANDING_OF_TRACK.get(info.track, ())[:MOST_SHOWN]}
    loses = any(row.lost is not None for row in rows)
    metric = metric_column(info.metric, sort=True)
    axis = numbers.bars_axis([(row.low, row.high) for row in sorted(rows, key=lambda row: row.place or math.inf)])
    drawn = "" if axis is None else f"{metric.text(axis[0])} to {metric.text(axis[1])}"
    described = any(row.sensors or row.mode for row in rows)
    columns = (
        Column("rank", "Rank", kind="number", sort="rank", about=RANK),
        Column("method", "Method", sort="method"),
        metric,
        interval_column(metric, "interval", "Interval", numbers.LEVEL if axis is None else f"{numbers.LEVEL}, {drawn}"),
        replace(
            metric,
            key="data_set",
            unit="data set",
            about="Over all sequences at once, not a mean over them; not used for ranking.",
            sort="data_set",
            hidden=not whole,
        ),
        *(replace(standing_column(key, info.track, sort=True), hidden=key not in shown) for key in keys[1:]),
        *([lost_column(info.track, len(info.sequences), sort="lost")] if loses else []),
        Column("failures", "Failed", "runs", "number", hidden=loses, about=FAILED),
        Column("sensors", "Sensors", "mode", hidden=not described, about=f"As stated by the method. {MODE}"),
        Column("work", "Code", "paper", hidden=not any(row.code or row.paper for row in rows), about=WORK),
        Column(
            "created",
            "Date",
            "tier",
            sort="created",
            about="Date of the record, in UTC, and the source of its numbers.",
        ),
        *(
            Column(key, kind="number" if key in ("place", "sequences", "runs") else "text", hidden=True)
            for key in HIDDEN
        ),
    )
    lines = []
    for row, rank in zip(rows, rank_cells(rows), strict=True):
        interval, failed = numbers.interval(row.low, row.high), f"{row.failures} of {row.runs}"
        lines.append(
            TableRow(
                (
                    rank,
                    Cell(row.method, path=record_path(row.digest), small=row.team, mark=state_mark(row)),
                    row.score,
                    Cell(interval, bar=axis and numbers.bar(row.low, row.score, row.high, axis, drawn), kind="soft"),
                    row.data_set,
                    *(_measured(row, key) for key in keys[1:]),
                    *(
                        [Cell(row.lost, kind="warn" if row.lost else "", about=f"{failed} runs failed")]
                        if loses
                        else []
                    ),
                    Cell(row.failures, failed, kind="warn" if row.failures else ""),
                    Cell(row.sensors or None, kind="few", small=row.mode),
                    work_cell(row.code, row.paper),
                    Cell(row.created, row.created[:10], about=ABOUT_TIERS.get(row.tier, ""), small=row.tier),
                    *(row.digest if key == "record" else getattr(row, key) for key in HIDDEN),
                ),
                row.state if row.state != "current" else "",
                row.digest,
            )
        )
    if found.query.sort == "rank" and not found.query.descending:
        groups = [row.rank for row in rows]
        starts = [i + 1 for i, (a, b) in enumerate(pairwise(groups)) if a != b and rows[i].rank is not None]
        for i in starts:
            lines[i] = replace(lines[i], kind=f"{lines[i].kind} first".strip())
    return Table(title, columns, tuple(lines), _notes(info, rows), f"{slug(info.track)}-{slug(info.split)}")


def _measured(row: Row, key: str) -> Cell:
    """Cell of a metric beside the ranking one; that of a speed shows its machine on hover."""
    return Cell(row.metrics.get(key), about=row.machine if key in SPEEDS else "")


def _notes(info: BoardInfo, rows: Sequence[Row]) -> tuple[str, ...]:
    metric = find_metric(info.metric)
    mean = (
        f"{metric_column(info.metric).heading} is that of all pixels of {len(info.sequences)} sequences together"
        if metric is not None and metric.weight
        else f"Means over {numbers.count(len(info.sequences), 'sequence')}, each the mean of its runs"
    )
    notes = [f"{mean}. {failures_note(info.track)} {lost_note(info.track)}".rstrip()]
    if rows and (lacking := lacks(info.split, info.track)):
        notes.append(lacking)
    notes += [note for note in (machines_note(rows, info.columns),) if note]
    if has_data_set(info, rows):
        notes.append(DATA_SET.format(metric_column(info.metric).heading))
    if any(row.state == "current" and row.tier not in RANKED for row in rows):
        notes.append(NOT_RANKED)
    if trust := trust_note(info, rows):
        notes.append(trust)
    if warning := learnt_on(info.split):
        notes.append(warning)
    if any(row.rank is not None for row in rows):
        notes.append(f"A rank is {RANK}")
    elif any(row.place is not None for row in rows):
        notes.append(f"In brackets: {UNRANKED}")
    return tuple(notes)
