"""The report: one self-contained HTML page that needs no network and is readable without JavaScript.

This module gathers what the template `report.html` shows.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from oysterbench.core.atomic import write_atomically
from oysterbench.core.html import environment
from oysterbench.core.page import STYLES
from oysterbench.core.text import as_unicode
from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.evaluate.metric import TrackMetrics
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.report.cards import Card, PlotGroup
from oysterbench.report.columns import lost_note, metric_column
from oysterbench.report.consistency import consistency_table
from oysterbench.report.density import DensityRun, map_cards
from oysterbench.report.images import LEGEND, DatasetRow, ImageRun, curves_group, dataset_tables, sample_pictures
from oysterbench.report.making import flattened, making, scored_when
from oysterbench.report.plots import Curve, point_swatch, scatter_plot, swatch
from oysterbench.report.renderers.html import FOLDER
from oysterbench.report.sequences import SequencePlots, SlamRun, sequence_plots
from oysterbench.report.steering import PictureRun, RolloutRun
from oysterbench.report.stress import stress_group, stress_table
from oysterbench.report.table import Table
from oysterbench.report.tables import (
    COMPLETE,
    failures_and_notes,
    pairs_table,
    results_tables,
    runs_table,
    several_note,
    standings_table,
    strata_table,
)
from oysterbench.results.comparison import Board, boards
from oysterbench.results.labels import names_of_runs
from oysterbench.results.records import ResultRecord, output_place
from oysterbench.results.remarks import remarks

SHOWN_CONDITIONS = 6  # plots of the score over a condition, per board
LEAST_POINTS = 6  # sequences of a board below which points over a condition show nothing but chance
NOTHING = TrackMetrics("Results", {}, (), (), "", {})
"""Track of a report without runs."""

SHOWN_VALUES = 8  # records whose values are shown beside a definition; the JSON holds them all

LIMITS = {
    "COMPLETE": COMPLETE,
    "LEGEND": LEGEND,
    "OPEN_SEQUENCES": 3,  # if there are more, all but the first are folded away
    "SHOWN_SAMPLES": 12,  # sequences with sample images; more would make a report of many megabytes
    "SHOWN_MAPS": 12,  # each is some 100 KB
    "SHOWN_FIGURES": 40,  # each is some 50 KB
}

Runs = Sequence[SlamRun] | Sequence[ImageRun] | Sequence[DensityRun] | Sequence[PictureRun] | Sequence[RolloutRun]


@dataclass(frozen=True)
class BoardPart:
    """The parts of a comparison, each None if it has nothing to show."""

    standings: Table | None
    pairs: Table | None
    pairs_within: Table | None
    strata: Table | None
    stress: Table | None
    stress_plots: PlotGroup | None
    over: PlotGroup | None
    runs: Table | None


@dataclass(frozen=True)
class Definition:
    """Key, heading, unit with direction, and definition of a metric, and its values in some records."""

    key: str
    heading: str
    unit: str
    about: str
    values: str = ""


def write_html_report(
    path: str | os.PathLike[str],
    runs: Runs,
    command: str,
    title: str | None = None,
    data_set: Sequence[DatasetRow] = (),
    first: Sequence[Table] = (),
    figures: Sequence[Card] = (),
) -> None:
    """Write `html_report` to a file, atomically."""
    text = html_report(runs, command, title, data_set, first, figures, Path(path).parent)
    write_atomically(path, as_unicode(text).encode())


def html_report(
    runs: Runs,
    command: str,
    title: str | None = None,
    data_set: Sequence[DatasetRow] = (),
    first: Sequence[Table] = (),
    figures: Sequence[Card] = (),
    folder: Path | None = None,
) -> str:
    """Make the report: results, standings, trajectories, errors and recall, frames, definitions, and provenance.

    For image tracks: the data set as a whole, curves and sample images instead of trajectories. first, figures: what a
    track shows before and after the tables common to all tracks; folder: in which failed runs may have left output.
    """
    records = [run.record for run in runs]
    splits = list(dict.fromkeys(record.split for record in records if record.split))
    sequences = list(dict.fromkeys(record.sequence for record in records))
    methods = list(dict.fromkeys(record.method for record in records))
    tracks = [TRACKS[name] for name in dict.fromkeys(record.track for record in records)] or [NOTHING]
    found = boards(records)
    styles = _styles(found)
    slam = [run for run in runs if isinstance(run, SlamRun)]
    drawn = any(run.result is not None for run in runs)
    results = results_tables(records)
    standings = [standings_table(board) for board in found if len(board.sequences) > 1]
    context = {
        **LIMITS,
        "swatch": swatch,
        "point_swatch": point_swatch,
        "title": title or f"{' and '.join(track.title for track in tracks)} on {', '.join(splits or sequences)}",
        "records": records,
        "scored": scored_when(records) if records else "",
        "sequence_names": sequences,
        "remarks": remarks(found),
        "names": [*methods, *splits, *sequences],
        "first": [*first, *dataset_tables(data_set)],
        "curves": curves_group(data_set, styles),
        "standings": standings,
        "results": [replace(table, notes=()) for table in results],
        "covered": any("coverage" in track.table for track in tracks),
        "shaded": any(cell.kind == "best" for table in results for row in table.rows for cell in row.cells),
        "several": several_note(records) if any(record.run for record in records) else "",
        "lost": _lost_notes(found, results, standings),
        "warnings": [*failures_and_notes(records), *([] if folder is None else _outputs(records, folder))],
        "boards": [_board(board, styles, compared=len(board.sequences) > 1 or not drawn) for board in found],
        "samples": sample_pictures([run for run in runs if isinstance(run, ImageRun)]),
        "maps": map_cards([run for run in runs if isinstance(run, DensityRun)]),
        "figures": figures,
        "trust": consistency_table(records),
        "sequences": _sequences(slam, sequences, styles),
        "not_drawn": not drawn and any(one.track == "slam" and one.failure is None for one in records),
        "command": command,
        "making": making(records),
        "conditions": {record.sequence: dict(flattened(record.conditions)) for record in records if record.conditions},
        **_definitions(records),
    }
    return environment(FOLDER).get_template("report.html").render(**context)


def _outputs(records: Sequence[ResultRecord], folder: Path) -> list[str]:
    """A sentence for each failed run of which the folder has the full output, on where that is."""
    failed = {f"{one.method} on {one.sequence}": output_place(one) for one in records if one.failure is not None}
    return [f"full output of {run}: {place}" for run, place in failed.items() if (folder / place).is_dir()]


def _sequences(runs: Sequence[SlamRun], names: Sequence[str], styles: Mapping[str, int]) -> list[SequencePlots]:
    found = []
    for name in names:
        of_sequence = [run for run in runs if run.record.sequence == name]
        failed = all(run.record.failure is not None for run in of_sequence)
        if of_sequence and (failed or any(run.result is not None or run.frames for run in of_sequence)):
            found.append(sequence_plots(of_sequence, name, styles))
    return found


def _board(board: Board, styles: Mapping[str, int], compared: bool) -> BoardPart:
    """Collect pairs, classes, the score over conditions, and runs of a board.

    Methods on a single sequence are compared only if `compared` is set; beside its plots a comparison is not needed.
    """
    alone = compared and len(board.sequences) == 1 and len(board.standings) > 1
    pairs = pairs_table(board)
    everywhere = [replace(row, kind="") for row in pairs.rows if compared and row.kind == "mean"]
    within = [row for row in pairs.rows if compared and row.kind != "mean"]
    strata, runs = strata_table(board), runs_table(board)
    return BoardPart(
        standings_table(board) if alone else None,
        replace(pairs, rows=tuple(everywhere), notes=() if within else pairs.notes) if everywhere else None,
        replace(pairs, rows=tuple(within)) if within else None,
        strata if strata.rows else None,
        stress_table(board),
        stress_group(board, styles),
        _over_conditions(board, {row.label: styles[row.label] for row in board.standings}),
        runs if runs.rows else None,
    )


def _over_conditions(board: Board, styles: Mapping[str, int]) -> PlotGroup | None:
    varying = list(board.varying().items())[:SHOWN_CONDITIONS]
    if not varying or len(board.sequences) < LEAST_POINTS:
        return None
    cards = [card for key, values in varying for card in _over(board, key, values, styles)]
    heading = f"Over conditions on {board.name}"
    return PlotGroup(heading, tuple(styles.items()), tuple(cards), points=True)


def _styles(found: Sequence[Board]) -> dict[str, int]:
    """Style for each label of a method on a board, and for each name: that of its first label."""
    entries = [entry for board in found for entry in board.entries]
    styles = {label: 1 + i % STYLES for i, label in enumerate(dict.fromkeys(entry.label for entry in entries))}
    for entry in entries:
        styles.setdefault(entry.records[0].method, styles[entry.label])
    return styles


def _lost_notes(found: Sequence[Board], results: Sequence[Table], standings: Sequence[Table]) -> list[str]:
    """Notes on what errors over several sequences are, where no table of standings has them."""
    over_all = any(row.kind == "mean" for table in results for row in table.rows)
    notes = [lost_note(board.track) for board in found] if over_all else []
    told = " ".join(note for table in standings for note in table.notes)
    return [note for note in dict.fromkeys(notes) if note and note not in told]


def _over(board: Board, condition: str, values: Mapping[str, float], styles: Mapping[str, int]) -> list[Card]:
    """Plot the ranking metric, and the error shown beside it, of every sequence over a condition."""
    cards = []
    beside = TRACKS[board.track].beside
    for key in (board.metric, *((beside,) if beside in board.keys else ())):
        metric = find_metric(key)
        curves = []
        for label, style in styles.items():
            means = {name: mean for name, mean in board.runs_of(label).means(key).items() if name in values}
            if means:
                x = np.array([values[name] for name in means])
                curves.append(Curve(label, x, np.array(list(means.values())), style))
        if curves and metric is not None:
            about = CONDITIONS[condition]
            x_label = about.name + (f" [{about.unit}]" if about.unit else "")
            y_label = metric.heading + (f" [{metric.unit}]" if metric.unit else "")
            title = f"{metric.heading} over {about.name}"
            top = 1.0 if key == board.metric and not metric.unit else None
            cards.append(Card(title, scatter_plot(curves, title, x_label, y_label, top)))
    return cards


def _definitions(records: Sequence[ResultRecord]) -> dict[str, list[Definition]]:
    """Definitions of the metrics in the tables, then of all others that were measured; by track, as those of two tracks
    may have one key."""
    found: dict[str, list[Definition]] = {"definitions": [], "more_definitions": []}
    names = dict.fromkeys(record.track for record in records)
    for name in names:
        of_track, track = [record for record in records if record.track == name], TRACKS[name]
        measured = dict.fromkeys(key for record in of_track for key in record.metrics)
        shown = [key for key in dict.fromkeys((*track.table, *track.costs, *track.standing)) if key in measured]
        made = [_definition(key, name) for key in shown]
        more = [_definition(key, name, of_track) for key in measured if key not in shown]
        for where, several in zip(found, (made, more), strict=True):
            apart = [replace(one, heading=f"{one.heading}, {track.title}") for one in several]
            found[where] += apart if len(names) > 1 else several
    return found


def _definition(key: str, track: str, records: Sequence[ResultRecord] = ()) -> Definition:
    column, metric = metric_column(key, track=track), find_metric(key, track)
    arrow = environment().globals["ARROWS"][column.better]  # type: ignore[index]
    unit = f"[{metric.unit}] {arrow}" if metric is not None and metric.unit else arrow
    names = names_of_runs([(record.method, record.sequence, record.run) for record in records])
    values = [
        f"{name} on {record.sequence}: "
        + (f"{value:.6g}" if not math.isnan(value) else f"none, {record.reasons.get(key, '')}")
        for name, record in list(zip(names, records, strict=True))[:SHOWN_VALUES]
        if (value := record.metrics.get(key)) is not None
    ]
    return Definition(key, column.heading, unit.strip(), column.about, "; ".join(values))
