"""Numbers that others reported on other data: a table of their own, never ranked with ours."""

from __future__ import annotations

from dataclasses import asdict

from oysterbench.report.table import Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.site import Site


def literature_page(site: Site) -> Page:
    """A table for each track, in the order of the list."""
    tracks = list(dict.fromkeys(one.track for one in site.literature))
    columns = (
        Column("method", "Method"),
        Column("metric", "Metric, as its source defines it"),
        Column("value", "Value", kind="number"),
        Column("data", "Measured on"),
        Column("source", "Source"),
        Column("note", "Note"),
        Column("track", hidden=True),
        Column("url", hidden=True),
    )
    tables = []
    for track in tracks:
        rows = tuple(
            TableRow(
                (
                    Cell(one.method),
                    Cell(one.metric, kind="wrap"),
                    Cell(one.value),
                    Cell(one.data, kind="wrap"),
                    Cell(one.source, kind="wrap", url=one.url),
                    Cell(one.note, kind="wrap"),
                    Cell(one.track),
                    Cell(one.url),
                )
            )
            for one in site.literature
            if one.track == track
        )
        name = numbers.track_name(track)
        tables.append(Table(f"{name}: reported by others, on other data", columns, rows, name="literature"))
    every = Table(
        "Reported by others, on other data", columns, tuple(row for t in tables for row in t.rows), name="literature"
    )
    return Page(
        "/literature",
        "Reported by others",
        "literature.html",
        {"by_track": tables},
        (every,),
        plain({"literature": [asdict(one) for one in site.literature]}),
    )
