"""Boards, records and literature as tables of the report: for the terminal, Markdown, LaTeX; and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from typing import Any

from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.statistics import LEVEL
from oysterbench.recipe import split_names
from oysterbench.report.columns import ABSENT, STANDING_OF_TRACK, find_column
from oysterbench.report.tables import Heading, Line, Table
from oysterbench_leaderboard.board import BoardInfo, BoardPage, Literature, Row

SHORT = 8
"""Digits of a digest that is shown."""

DATA_SET = "{} ranks by its mean over sequences; 'data set' is of all sequences at once, and does not rank."
"""Said of a ranking metric, or a record, that has both."""


def board_name(board: BoardInfo) -> str:
    """Track, split, evaluator."""
    return f"{board.track} on {board.split} ({board.evaluator_version})"


def board_table(page: BoardPage) -> Table:
    """Rows by rank: score with interval, coverage beside the errors, who vouches for them, and when."""
    board, rows = page.board, page.rows
    metric = find_column(board.metric)
    beside = STANDING_OF_TRACK[board.track]
    texts = {column.key: column.texts([row.metrics.get(column.key) for row in rows]) for column in beside}
    scores = metric.texts([row.score for row in rows])
    whole = metric.texts([row.data_set for row in rows]) if has_data_set(board, rows) else []
    lines = [
        Line(
            (
                rank_text(row),
                row.method,
                row.team,
                scores[i],
                interval_text(row, metric),
                *whole[i : i + 1],
                *(texts[column.key][i] for column in beside),
                str(row.failures) if row.failures else "",
                row.tier,
                row.created[:10],
                row.digest[:SHORT],
            )
        )
        for i, row in enumerate(rows)
    ]
    headings = (
        Heading("rank"),
        Heading("method", number=False, name=True),
        Heading("team", number=False, name=True),
        Heading(metric.heading, metric.unit, metric.key),
        Heading(f"{LEVEL:.0%}", "interval"),
        *([Heading(metric.heading, "data set")] if whole else []),
        *(Heading(column.heading, column.unit, column.key) for column in beside),
        Heading("failed"),
        Heading("tier", number=False),
        Heading("date", number=False),
        Heading("record", number=False),
    )
    return Table(board_name(board), headings, tuple(lines), tuple(_notes(page, rows)))


def has_data_set(board: BoardInfo, rows: Sequence[Row]) -> bool:
    """Whether the ranking metric over the whole data set is another number than the mean, and any record knows it. A
    metric that is weighed is the same both ways."""
    metric = find_metric(board.metric)
    return not (metric is not None and metric.weight) and any(row.data_set is not None for row in rows)


@cache
def learnt_on(split: str) -> str:
    """What is said of a board whose pictures a method may have learnt from; nothing of the others."""
    kind, _, role = split.partition("-")
    if role in ("mini", "val", "test") or split not in split_names():
        return ""
    return f"{split} is there to learn on, and methods may have: what they are worth is on the boards of {kind}-val."


def rank_text(row: Row) -> str:
    """The rank, with "=" where others have it; a place in brackets where no difference can be significant; the state
    where there is neither."""
    if row.place is None:
        return row.state if row.state != "current" else ABSENT
    shown = f"{row.rank or row.place}{'=' if row.tied else ''}"
    return f"({shown})" if row.rank is None else shown


def interval_text(row: Row, metric: Any) -> str:
    """Both ends, or a dash."""
    if row.low is None or row.high is None:
        return ABSENT
    return f"{row.low * metric.factor:.{metric.decimals}f} to {row.high * metric.factor:.{metric.decimals}f}"


def _notes(page: BoardPage, rows: Sequence[Row]) -> list[str]:
    board = page.board
    count = f"{len(board.sequences)} sequence{'' if len(board.sequences) == 1 else 's'}"
    notes = []
    if page.total > len(rows):
        notes.append(f"{len(rows)} of {page.total} rows.")
    if any(row.place is not None and row.rank is None for row in rows):
        notes.append(f"{count}: too few for a significant difference; places in brackets are the order of these means.")
    elif rows:
        notes.append(f"Over {count}; one that is lacking or failed counts as nothing, and is among 'failed'.")
    if has_data_set(board, rows):
        notes.append(DATA_SET.format(find_column(board.metric).heading))
    if warning := learnt_on(board.split):
        notes.append(warning)
    if not board.newest:
        notes.append("A later evaluator has taken over: this board is history.")
    return notes


def boards_csv(pages: Sequence[BoardPage]) -> str:
    """One line per row, every digit; an empty field where there is no value. No field begins a formula."""
    columns = list(dict.fromkeys(key for page in pages for key in page.board.columns))
    facts = [key for key in Row.__dataclass_fields__ if key not in ("metrics", "board")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["board", "track", "split", "evaluator_version", "metric", *facts, *(c for c in columns)])
    for page in pages:
        board = page.board
        for row in page.rows:
            values = [board.id, board.track, board.split, board.evaluator_version, board.metric]
            values += [getattr(row, key) for key in facts]
            values += [row.metrics.get(key) for key in columns]
            writer.writerow([csv_field(value) for value in values])
    return text.getvalue()


def csv_field(value: Any) -> str:
    """As text; what a spreadsheet would take for a formula is quoted."""
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value)
    text = str(value)
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") else text


def page_plain(page: BoardPage) -> dict[str, Any]:
    """For JSON."""
    return {"board": asdict(page.board), "rows": [asdict(row) for row in page.rows], "total": page.total}


def record_table(row: Row, means: Mapping[str, Mapping[str, float | None]], keys: Sequence[str]) -> Table:
    """A record's numbers by sequence; keys: of metrics."""
    columns = [find_column(key) for key in keys]
    names = list(means)
    texts = {column.key: column.texts([means[name].get(column.key) for name in names]) for column in columns}
    lines = [Line((name, *(texts[column.key][i] for column in columns))) for i, name in enumerate(names)]
    headings = (Heading("sequence", number=False), *(Heading(c.heading, c.unit, c.key) for c in columns))
    return Table(f"{row.method} by sequence", headings, tuple(lines))


def history_table(rows: Sequence[Row], boards: Mapping[str, BoardInfo]) -> Table:
    """Records of a method: where, what became of them, what they reached."""
    lines = []
    for row in rows:
        board = boards[row.board]
        score = find_column(board.metric).texts([row.score])[0]
        place = f"{row.rank if row.rank is not None else f'({row.place})'}" if row.place is not None else ABSENT
        cells = (row.created[:10], row.digest[:SHORT], row.team, board.split, board.evaluator_version)
        lines.append(Line((*cells, row.state, place, score, row.tier, row.supersedes[:SHORT])))
    names = ("date", "record", "team", "split", "evaluator", "state", "rank", "score", "tier", "in place of")
    headings = tuple(Heading(name, number=name in ("rank", "score")) for name in names)
    return Table(f"Records of {rows[0].method}", headings, tuple(lines))


def literature_tables(rows: Sequence[Literature]) -> list[Table]:
    """What others reported: a table for each source, metric and data."""
    groups: dict[tuple[str, ...], list[Literature]] = {}
    for row in rows:
        groups.setdefault((row.track, row.metric, row.data, row.source, row.url), []).append(row)
    headings = (Heading("method", number=False), Heading("value"), Heading("note", number=False))
    found = []
    for (track, metric, data, source, url), group in groups.items():
        lines = tuple(Line((row.method, row.value, row.note)) for row in group)
        said = (f"{metric}", f"Source: {source}{f', {url}' if url else ''}")
        found.append(Table(f"{track}: {data}", headings, lines, said))
    return found
