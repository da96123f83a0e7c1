"""Page of results reported by others on other data, by metric and data: in separate tables, never ranked with ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

from oysterbench.report.table import Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import Literature
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.site import Site


@dataclass(frozen=True)
class Group:
    """Results in one metric on the same data. source: that of the first; about: what holds for all of them."""

    data: str
    metric: str
    source: str
    url: str
    about: str
    table: Table


COLUMNS = (
    Column("method", "Method"),
    Column("value", "Value", kind="number"),
    Column("note", "Note"),
    *(Column(key, hidden=True) for key in ("metric", "data", "source", "track", "url")),
)


def literature_page(site: Site) -> Page:
    """Page of reported results: tracks in the order of the list, results on the same data grouped."""
    tracks = list(dict.fromkeys(one.track for one in site.literature))
    by_track = {
        numbers.track_name(track): _groups([one for one in site.literature if one.track == track]) for track in tracks
    }
    rows = tuple(row for groups in by_track.values() for group in groups for row in group.table.rows)
    every = Table("Reported by others, on other data", COLUMNS, rows, name="literature")
    return Page(
        "/literature",
        "Reported by others",
        "literature.html",
        {"by_track": by_track},
        (every,),
        plain({"literature": [asdict(one) for one in site.literature]}),
    )


def _groups(of_track: Sequence[Literature]) -> list[Group]:
    """Group results that may be read side by side: the same metric on the same data."""
    groups: dict[tuple[str, str], list[Literature]] = {}
    for one in of_track:
        groups.setdefault((one.data, one.metric), []).append(one)
    return [_group(several) for several in groups.values()]


def _group(several: Sequence[Literature]) -> Group:
    """Group of results in one metric on the same data; what all notes have in common is said once, and a result's
    differing source in its own note."""
    first = several[0]
    shared = set.intersection(*({part for part in one.note.split("; ") if part} for one in several))
    lines = []
    for one in several:
        parts = [part for part in one.note.split("; ") if part and part not in shared]
        other = one.source if one.source != first.source else ""
        note = "; ".join([*parts, *([other] if other else [])])
        cells = (Cell(one.method), Cell(one.value), Cell(note, kind="wrap", url=one.url if other else ""))
        lines.append(TableRow((*cells, one.metric, one.data, one.source, one.track, one.url)))
    about = "; ".join(part for part in first.note.split("; ") if part in shared)
    columns = [
        replace(c, hidden=c.hidden or (c.key == "note" and not any(row.cells[2].value for row in lines)))
        for c in COLUMNS
    ]
    table = Table(f"{first.metric}, on {first.data}", tuple(columns), tuple(lines), name="literature")
    return Group(first.data, first.metric, first.source, first.url, about, table)
