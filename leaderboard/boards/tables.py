"""Boards, records and literature as report tables, for the terminal, Markdown and LaTeX, and as CSV."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache
from typing import Any

from oysterbench.evaluate.metrics import FAILED, SPEEDS, TRACKS, find_metric
from oysterbench.evaluate.statistics import Interval
from oysterbench.recipe import load_split, split_names
from oysterbench.report.columns import (
    STANDING_OF_TRACK,
    lost_column,
    lost_note,
    metric_column,
    metric_columns,
    name_columns,
)
from oysterbench.report.renderers import csv_table
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow, interval_column
from oysterbench_leaderboard.boards.board import BoardInfo, BoardPage, Literature, Row
from oysterbench_leaderboard.boards.vehicle import lacks
from oysterbench_leaderboard.storage.record import RANKED

SHORT = 8
"""Number of digits shown of a digest."""

DATA_SET = "{} ranks by its mean over sequences; 'data set' is of all sequences at once, and does not rank."
"""Note on a ranking metric, or a record, that has both."""

NOT_RANKED = "What is self-reported (tier 'reported') is not ranked: nobody but its authors computed it."


def board_name(board: BoardInfo) -> str:
    """Name of a board: track, split, evaluator, and its settings that are not defaults."""
    return f"{board.track} on {board.split} ({board.scored_by})"


def board_table(page: BoardPage) -> Table:
    """Table of a board's rows by rank: score with interval, coverage beside the errors, tier and date."""
    board, rows = page.board, page.rows
    metric = metric_column(board.metric)
    beside = [replace(column, wide=i > 1) for i, column in enumerate(STANDING_OF_TRACK[board.track])]
    whole = has_data_set(board, rows)
    table_rows = [
        TableRow(
            (
                Cell(row.rank, rank_text(row)),
                row.method,
                row.team,
                row.score,
                interval_of(row),
                *([row.data_set] if whole else []),
                *(row.metrics.get(column.key) for column in beside),
                row.failures or "" if row.lost is None else row.lost,
                row.tier,
                row.created[:10],
                row.digest[:SHORT],
            )
        )
        for row in rows
    ]
    columns = (
        Column("rank", "Rank", kind="number", short="rank"),
        *name_columns("method"),
        replace(name_columns("team")[0], wide=True),
        metric,
        interval_column(metric),
        *([data_set_column(metric)] if whole else []),
        *beside,
        lost_or_failed(board),
        *(replace(column, wide=column.key != "record") for column in name_columns("tier", "date", "record")),
    )
    return Table(board_name(board), columns, tuple(table_rows), tuple(_notes(page, rows)))


def lost_or_failed(board: BoardInfo) -> Column:
    """Column with the number of lost sequences, where the track defines them; otherwise of failed runs."""
    if TRACKS[board.track].lost_below is not None:
        return lost_column(board.track, len(board.sequences), sort="lost")
    about = "Failed runs, and sequences without an estimate."
    return Column("failed", "Failed", "runs", "number", "failed", about=about)


def data_set_column(metric: Column) -> Column:
    """The column of the same metric over the whole data set."""
    short = f"{metric.short.partition(chr(10))[0]}\ndata set"
    return replace(metric, key="data_set", heading=f"{metric.heading} of the data set", short=short)


def has_data_set(board: BoardInfo, rows: Sequence[Row]) -> bool:
    """Whether the ranking metric over the whole data set differs from the mean, and any record has it. For a metric
    with a weighted mean the two are the same."""
    metric = find_metric(board.metric)
    return not (metric is not None and metric.weight) and any(row.data_set is not None for row in rows)


LEADING = ("val", "test", "", "train", "mini", "stress")
"""Roles of splits, those on which methods are compared first."""


def role_of(split: str) -> str:
    """Role of one of our splits: "val", "test", "mini", "train" or "stress"; empty for splits of others, and for sets
    that are framed like real images."""
    role = split.partition("-")[2]
    return role if role in ("val", "test", "mini", "train", "stress") else ""


@cache
def learnt_on(split: str) -> str:
    """Warning on a board whose images a method may have been trained on; empty for other boards."""
    if role_of(split) in ("mini", "val", "test", "stress") or split not in split_names():
        return ""
    kind = split.partition("-")[0]
    return f"{split} is a training split: methods may have been trained on it. Compare them on {kind}-val."


@cache
def _is_public(split: str) -> bool:
    return split in split_names() and not load_split(split).hidden


def trust_note(board: BoardInfo, rows: Sequence[Row]) -> str:
    """Warning on a board whose ground truth those who sent estimates could make; empty for other boards."""
    if not (board.public or _is_public(board.split)):
        return ""
    if not any(row.state == "current" and row.tier == "scored" for row in rows):
        return ""
    return (
        f"{board.split} is public, and anyone can make its ground truth: what was sent here (tier 'scored') rests on "
        "trust; on a hidden split it does not."
    )


def failures_note(track: str) -> str:
    """What failed runs and lacking sequences score."""
    ranking = TRACKS[track].ranking
    metric = find_metric(ranking, track)
    may_be_less = metric is not None and metric.range[0] < FAILED[track].get(ranking, math.nan)
    lacking = "scores 0, or the lowest of a ranked method there if that is less" if may_be_less else "counts as failed"
    return f"A failed run {TRACKS[track].failed_as}; a sequence that is lacking {lacking}."


def rank_text(row: Row) -> str:
    """Rank, with "=" in front where it is shared; or the place in brackets where no difference can be significant; or
    the state where there is neither."""
    if row.place is None:
        return row.state if row.state != "current" else ABSENT
    shown = f"{'=' if row.tied else ''}{row.rank or row.place}"
    return f"({shown})" if row.rank is None else shown


def interval_of(row: Row) -> Interval:
    """Confidence interval of a row's score."""
    if row.low is None or row.high is None:
        return Interval(math.nan, math.nan, "too few sequences")
    return Interval(row.low, row.high)


def machines_note(rows: Sequence[Row], columns: Collection[str] = SPEEDS) -> str:
    """Note where speeds were measured on several machines; otherwise empty. columns: keys of the metrics that are shown
    beside it."""
    machines = dict.fromkeys(row.machine for row in rows if row.machine)
    if len(machines) < 2 or not set(SPEEDS) & set(columns):
        return ""
    return f"Speeds are of different machines ({'; '.join(machines)}): they do not compare methods."


def _notes(page: BoardPage, rows: Sequence[Row]) -> list[str]:
    board = page.board
    count = f"{len(board.sequences)} sequence{'' if len(board.sequences) == 1 else 's'}"
    notes = []
    if page.total > len(rows):
        notes.append(f"{len(rows)} of {page.total} rows.")
    if any(row.place is not None and row.rank is None for row in rows):
        notes.append(f"{count}: too few for a significant difference; places in brackets are the order of these means.")
    elif rows:
        notes.append(f"Over {count}. {failures_note(board.track)}")
    if rows and (lost := lost_note(board.track)):
        notes.append(lost)
    if rows and (lacking := lacks(board.split, board.track)):
        notes.append(lacking)
    notes += [note for note in (machines_note(rows, board.columns),) if note]
    if any(row.state == "current" and row.tier not in RANKED for row in rows):
        notes.append(NOT_RANKED)
    if trust := trust_note(board, rows):
        notes.append(trust)
    if has_data_set(board, rows):
        notes.append(DATA_SET.format(metric_column(board.metric).heading))
    if warning := learnt_on(board.split):
        notes.append(warning)
    if board.former:
        notes.append(f"{board.split} has another recipe since: this board is history.")
    elif not board.newest:
        notes.append("A later evaluator has taken over: this board is history.")
    return notes


def boards_csv(pages: Sequence[BoardPage]) -> str:
    """CSV with one line per row and full precision; a field without a value is empty. No field starts a formula."""
    facts = [key for key in Row.__dataclass_fields__ if key not in ("metrics", "board")]
    columns = list(dict.fromkeys(key for page in pages for key in page.board.columns if key not in facts))
    keys = ("board", "track", "split", "evaluator_version", "metric", *facts, *columns)
    rows = []
    for page in pages:
        board = page.board
        about = (board.id, board.track, board.split, board.evaluator_version, board.metric)
        for row in page.rows:
            rows.append(TableRow((*about, *(getattr(row, key) for key in facts), *map(row.metrics.get, columns))))
    return csv_table(Table("Boards", tuple(map(Column, keys)), tuple(rows)))


def page_plain(page: BoardPage) -> dict[str, Any]:
    """Page of a board as plain values for JSON."""
    return {"board": asdict(page.board), "rows": [asdict(row) for row in page.rows], "total": page.total}


def record_table(row: Row, means: Mapping[str, Mapping[str, float | None]], keys: Sequence[str]) -> Table:
    """Table of a record's values by sequence; keys: of metrics."""
    rows = [TableRow((name, *map(of.get, keys))) for name, of in means.items()]
    return Table(f"{row.method} by sequence", (*name_columns("sequence"), *metric_columns(keys)), tuple(rows))


def history_table(rows: Sequence[Row], boards: Mapping[str, BoardInfo]) -> Table:
    """Table of a method's records: their boards, states, ranks and scores."""
    table_rows = []
    for row in rows:
        board = boards[row.board]
        rank = Cell(row.rank, ABSENT if row.place is None else rank_text(row))
        score = Cell(row.score, metric_column(board.metric).text(row.score))
        cells = (row.created[:10], row.digest[:SHORT], row.team, board.split, board.evaluator_version)
        table_rows.append(TableRow((*cells, row.state, rank, score, row.tier, row.supersedes[:SHORT])))
    numbers = [Column(key, key.capitalize(), kind="number", short=key) for key in ("rank", "score")]
    columns = (
        *name_columns("date", "record", "team", "split", "evaluator", "state"),
        *numbers,
        *name_columns("tier", "in_place_of"),
    )
    return Table(f"Records of {rows[0].method}", columns, tuple(table_rows))


def literature_tables(rows: Sequence[Literature]) -> list[Table]:
    """Tables of results reported by others, one for each track, metric, data and source."""
    groups: dict[tuple[str, ...], list[Literature]] = {}
    for row in rows:
        groups.setdefault((row.track, row.metric, row.data, row.source, row.url), []).append(row)
    columns = (*name_columns("method"), Column("value", "Value", kind="number", short="value"), *name_columns("note"))
    found = []
    for (track, metric, data, source, url), group in groups.items():
        table_rows = tuple(TableRow((row.method, row.value, row.note)) for row in group)
        notes = (metric, f"Source: {source}{f', {url}' if url else ''}")
        found.append(Table(f"{track}: {data}", columns, table_rows, notes))
    return found
