"""Pages of the data sets: what there is, the conditions of each sequence, and how to get it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import BoardInfo
from oysterbench_leaderboard.site.datasets import Conditions, DataSet, all_data_sets, classes_note, conditions_of
from oysterbench_leaderboard.site.frames import file_name
from oysterbench_leaderboard.site.page import Page, PageError
from oysterbench_leaderboard.site.paths import board_path, data_path, slug, split_path
from oysterbench_leaderboard.site.site import Site

DECIMALS = {"secchi_m": 1, "altitude_m": 2, "speed_m_s": 2, "oysters_per_m2": 0, "depth_m": 1, "snow_per_m3": 0}


def data_page(site: Site) -> Page:
    """Page of all data sets."""
    columns = (
        Column("split", "Data set"),
        Column("track", "Made for"),
        Column("sequences", "Sequences", kind="number"),
        Column("duration_s", "Duration", "min", "number", digits=1, factor=1 / 60),
        Column("truth", "Truth"),
        Column("records", "Records", "current", "number"),
        Column("rig", "Rig"),
        Column("summary", "What it is"),
        Column("version", hidden=True),
        Column("recipe", hidden=True),
        Column("manifest", hidden=True),
    )
    entries: dict[str, int] = {}
    for info in site.index.boards():
        if info.newest:
            entries[info.split] = entries.get(info.split, 0) + info.entries
    lines = []
    for name, found in sorted(all_data_sets(site).items(), key=lambda item: (item[1].track, item[0])):
        lines.append(
            TableRow(
                (
                    Cell(name, path=data_path(name), small=found.version),
                    Cell(found.track),
                    len(found.sequences),
                    found.duration_s,
                    Cell("hidden" if found.hidden else "public"),
                    entries.get(name, 0),
                    Cell(found.rig, found.rig or ABSENT),
                    Cell(found.summary or "known only from records", kind="wrap"),
                    Cell(found.version),
                    Cell(found.digest),
                    Cell(found.manifest),
                )
            )
        )
    table = Table("Data sets", columns, tuple(lines), name="data")
    data = [_plain(found) for found in all_data_sets(site).values()]
    return Page("/data", "Data sets", "data.html", {}, (table,), plain({"data_sets": data}))


def split_page(site: Site, split: str) -> Page:
    """Page of a data set, by the slug of its name. Raises PageError with links to those there are."""
    known = all_data_sets(site)
    found = next((one for name, one in known.items() if slug(name) == split), None)
    if found is None:
        hints = {"/data": "all data sets", **{data_path(name): name for name in known}}
        raise PageError(f"no data set {split!r}", hints=hints)
    boards = [info for info in site.index.boards() if info.split == found.name]
    like = conditions_of(site, found)
    table = conditions_table(found, like)
    context = {
        "found": found,
        "frame": file_name(found.name),
        "minutes": "" if found.duration_s is None else f"{found.duration_s / 60:.1f}",
        "megabytes": "" if found.size is None else f"{found.size / 1e6:.0f}",
        "boards": [(split_path(b.track, b.split) if b.newest else board_path(b), b) for b in boards],
    }
    data = {**_plain(found), "recipe": found.recipe, "conditions": like, "boards": [_board(info) for info in boards]}
    return Page(data_path(found.name), found.name, "split.html", context, (table,), plain(data))


def _plain(found: DataSet) -> dict[str, Any]:
    values = asdict(found)
    return {key: value for key, value in values.items() if key not in ("recipe", "seed" if found.hidden else "")}


def _board(info: BoardInfo) -> dict[str, Any]:
    return {"id": info.id, "track": info.track, "evaluator_version": info.evaluator_version, "path": board_path(info)}


def conditions_table(found: DataSet, like: Mapping[str, Conditions]) -> Table:
    """Table of the conditions of each sequence; conditions that no sequence has, such as waves, have no column."""
    keys = [key for key in CONDITIONS if any(values.get(key) for values in like.values())]
    columns = (
        Column("sequence", "Sequence"),
        *(_column(key, like) for key in keys),
    )
    lines = []
    for name in found.sequences:
        lines.append(TableRow((name, *(like.get(name, {}).get(key) or None for key in keys))))
    notes = tuple(filter(None, (classes_note(),))) if keys else ("The conditions of the sequences are not known here.",)
    return Table(f"Sequences of {found.name}", columns, tuple(lines), notes, "sequences")


def _column(key: str, like: Mapping[str, Conditions]) -> Column:
    about = CONDITIONS[key]
    number = not any(isinstance(values.get(key), str) for values in like.values())
    heading = about.name[:1].upper() + about.name[1:]
    return Column(key, heading, about.unit, "number" if number else "text", digits=DECIMALS.get(key))
