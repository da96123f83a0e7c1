"""The report: one HTML page that needs no other file and no network, and reads without JavaScript as well."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from oysterbench.core.files import write_atomically
from oysterbench.core.page import STYLES, page
from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.evaluate.metric import Metric
from oysterbench.evaluate.metrics import find_metric
from oysterbench.report.columns import ERROR_OF_TRACK, OF_TRACK, STANDING_OF_TRACK
from oysterbench.report.density import DensityRun, maps_section
from oysterbench.report.images import DatasetRow, ImageRun, curves_section, dataset_tables, samples_section
from oysterbench.report.plots import Curve, point_swatch, scatter_plot
from oysterbench.report.sequences import SlamRun, card, sequence_section
from oysterbench.report.steering import DiveRun, Figure, PictureRun, figures_section
from oysterbench.report.tables import (
    COMPLETE,
    Heading,
    Line,
    Table,
    failures_and_notes,
    pairs_table,
    results_tables,
    runs_table,
    standings_table,
    strata_table,
)
from oysterbench.results.comparison import Board, boards, remarks
from oysterbench.results.records import ResultRecord

ARROWS = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
OPEN_SEQUENCES = 3  # more are folded away, all but the first
SHOWN_CONDITIONS = 6  # plots of the score over a condition, per board


Runs = Sequence[SlamRun] | Sequence[ImageRun] | Sequence[DensityRun] | Sequence[PictureRun] | Sequence[DiveRun]

TITLES = {
    "slam": "SLAM",
    "segmentation": "Segmentation",
    "detection": "Detection",
    "density": "Oyster maps",
    "steering": "Steering",
    "exploration": "Exploration",
}


def write_html_report(
    path: str | os.PathLike[str],
    runs: Runs,
    command: str,
    title: str | None = None,
    data_set: Sequence[DatasetRow] = (),
    first: Sequence[Table] = (),
    figures: Sequence[Figure] = (),
) -> None:
    """Write `html_report` to a file, nothing half-written."""
    write_atomically(path, html_report(runs, command, title, data_set, first, figures).encode())


def html_report(
    runs: Runs,
    command: str,
    title: str | None = None,
    data_set: Sequence[DatasetRow] = (),
    first: Sequence[Table] = (),
    figures: Sequence[Figure] = (),
) -> str:
    """Table, standings, trajectories, errors and recall, frames, definitions, and how it was all made.

    Of tracks of images: the data set as a whole, curves and pictures in place of trajectories. first, figures: what a
    track shows before and after the tables of every track.
    """
    records = [run.record for run in runs]
    splits = list(dict.fromkeys(record.split for record in records if record.split))
    sequences = list(dict.fromkeys(record.sequence for record in records))
    methods = list(dict.fromkeys(record.method for record in records))
    track = records[0].track if records else "slam"
    title = title or f"{TITLES[track]} on {', '.join(splits or sequences)}"
    styles = {method: 1 + i % STYLES for i, method in enumerate(methods)}
    found = boards(records)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(", ".join(methods))} on {_count(len(sequences), "sequence")}, scored by oysterbench '
        f"{escape(records[0].oysterbench_version)} on {escape(records[0].created[:10])}.</p>"
        if records
        else '<p class="lead">No runs.</p>',
        *(f'<p class="small">{escape(remark[0].upper() + remark[1:])}.</p>' for remark in remarks(found)),
    ]
    for table in (*first, *dataset_tables(data_set)):
        notes = "".join(f'<p class="small">{escape(note)}</p>' for note in table.notes)
        parts.append(f"<h2>{escape(table.title)}</h2>{_table(table)}{notes}")
    parts.append(curves_section(data_set, styles))
    standings = [_standings(board) for board in found if len(board.sequences) > 1]
    parts += [*standings, *(["<h2>By sequence</h2>"] if standings else []), _results(records)]
    parts += [f'<p class="small warn">{escape(remark)}</p>' for remark in failures_and_notes(records)]
    slam = [run for run in runs if isinstance(run, SlamRun)]
    drawn = any(run.result is not None for run in runs)
    parts += [_board(board, styles, compared=len(board.sequences) > 1 or not drawn) for board in found]
    parts.append(samples_section([run for run in runs if isinstance(run, ImageRun)]))
    parts.append(maps_section([run for run in runs if isinstance(run, DensityRun)]))
    parts.append(figures_section(figures))
    for i, sequence in enumerate(sequences if slam else ()):
        of_sequence = [run for run in slam if run.record.sequence == sequence]
        failed = all(run.record.failure is not None for run in of_sequence)
        if failed or any(run.result is not None or run.frames for run in of_sequence):
            section = sequence_section(of_sequence, sequence, styles)
            many = len(sequences) > OPEN_SEQUENCES
            parts.append(_folded(f"Paths and errors on {sequence}", section, i == 0) if many else section)
    if slam and not drawn:
        parts.append('<p class="small">Paths are drawn in the report of each evaluation.</p>')
    parts += [_making(records, command), _definitions(records), f"<script>{_asset('report.js')}</script>"]
    return page(title, f"<style>{_asset('report.css')}</style>" + "\n".join(parts))


def _asset(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" + ("" if n == 1 else "s")


def _results(records: Sequence[ResultRecord]) -> str:
    """Results by sequence."""
    found = results_tables(records)
    headed = len(found) > 1
    slam = all(record.track == "slam" for record in records)
    drawn = [(f"<h3>{escape(table.title)}</h3>" if headed else "") + _table(table) for table in found]
    shaded = (
        (
            " The best of each sequence is shaded, errors among runs that answer at least "
            f"{COMPLETE:.0%} of what the most complete one does."
            if slam
            else " The best of each sequence is shaded."
        )
        if any(any(line.best) for table in found for line in table.lines)
        else ""
    )
    several = " Of several runs the medians are shown." if any(record.run for record in records) else ""
    beside = "; read every error beside its coverage" if slam else ""
    return "".join(drawn) + (
        f'<p class="small">{ARROWS["lower"]} lower is better, '
        f"{ARROWS['higher']} higher is better{beside}.{shaded}{several}</p>"
    )


def _table(table: Table) -> str:
    """An HTML table that scrolls sideways on a narrow screen."""
    headings = "".join(_heading(heading, i) for i, heading in enumerate(table.headings))
    lines = []
    for n, line in enumerate(table.lines):
        first = line.kind == "mean" and n and table.lines[n - 1].kind != "mean"
        kind = f' class="mean{" first" if first else ""}"' if line.kind == "mean" else ""
        cells = []
        for i, (text, heading) in enumerate(zip(line.cells, table.headings, strict=True)):
            classes = [] if heading.number else ["name"]
            if line.best and line.best[i]:
                classes.append("best")
            if line.kind == "failed" and heading.text == "method":
                classes.append("warn")
                text += " (failed)"
            attribute = f' class="{" ".join(classes)}"' if classes else ""
            cells.append(
                f'<th scope="row"{attribute}>{escape(text)}</th>' if i == 0 else f"<td{attribute}>{escape(text)}</td>"
            )
        lines.append(f"<tr{kind}>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll" role="region" aria-label="{escape(table.title)}" tabindex="0"><table><thead>'
        f"<tr>{headings}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _heading(heading: Heading, i: int) -> str:
    metric = find_metric(heading.key) if heading.key else None
    text = metric.heading if metric is not None and metric.heading and heading.unit != "difference" else heading.text
    text = text if heading.name else text[0].upper() + text[1:]
    own = "" if heading.unit.lower() in text.lower() else heading.unit
    unit = " ".join(part for part in (own, ARROWS[metric.better] if metric is not None else "") if part)
    about = f' title="{escape(metric.definition)}"' if metric is not None else ""
    name = "" if heading.number and i else ' class="name"'
    return f'<th scope="col"{name}{about}>{_unbroken(text)}<br><small>{escape(unit)}</small></th>'


def _unbroken(heading: str) -> str:
    return escape(heading).replace("1 s", "1&nbsp;s")


def _standings(board: Board) -> str:
    table = standings_table(board)
    notes = "".join(f'<p class="small">{escape(note)}</p>' for note in table.notes)
    return f"<h2>{escape(table.title)}</h2>{_table(table)}{notes}"


def _board(board: Board, styles: Mapping[str, int], compared: bool) -> str:
    """Pairs, classes, the score over conditions, and runs, each where there is something of it to say.

    Methods on a single sequence are compared where that is what was asked for; beside its plots they need no words.
    """
    parts = [_standings(board)] if compared and len(board.sequences) == 1 and len(board.standings) > 1 else []
    pairs = pairs_table(board) if compared else Table("", (), ())
    everywhere = tuple(line for line in pairs.lines if line.kind == "mean")
    if everywhere:
        parts.append(f"<h2>{escape(pairs.title)}</h2>{_table(replace(pairs, lines=_plain(everywhere)))}")
    if len(everywhere) < len(pairs.lines):
        within = replace(pairs, lines=tuple(line for line in pairs.lines if line.kind != "mean"))
        parts.append(_folded("Pairs within each class of conditions", _table(within)))
    if (strata := strata_table(board)).lines:
        parts.append(f"<h2>{escape(strata.title)}</h2>{_table(strata)}")
        parts += [f'<p class="small">{escape(note)}</p>' for note in strata.notes]
    parts.append(_over_conditions(board, styles))
    if (runs := runs_table(board)).lines:
        parts.append(_folded(f"{runs.title}: median and spread", _table(runs)))
    return "".join(parts)


def _plain(lines: Sequence[Line]) -> tuple[Line, ...]:
    return tuple(replace(line, kind="") for line in lines)


def _folded(summary: str, content: str, opened: bool = False) -> str:
    return f"<details{' open' if opened else ''}><summary>{escape(summary)}</summary>{content}</details>"


def _over_conditions(board: Board, styles: Mapping[str, int]) -> str:
    varying = list(board.varying().items())[:SHOWN_CONDITIONS]
    if not varying:
        return ""
    labels = [row.label for row in board.standings]
    order = {label: styles.get(label, 1 + i % STYLES) for i, label in enumerate(labels)}
    legend = "".join(f'<li data-label="{escape(k)}">{point_swatch(v)}{escape(k)}</li>' for k, v in order.items())
    plots = "".join(_over(board, key, values, order) for key, values in varying)
    return (
        f'<section class="sequence"><h2>{escape(_short(board))} and error over conditions on {escape(board.name)}</h2>'
        f'<ul class="legend" aria-label="Legend">{legend}</ul><div class="pair">{plots}</div></section>'
    )


def _short(board: Board) -> str:
    metric = find_metric(board.metric)
    return metric.heading if metric is not None else board.metric


def _over(board: Board, condition: str, values: Mapping[str, float], styles: Mapping[str, int]) -> str:
    """The ranking metric, and the error beside it, of every sequence over a condition."""
    cards = []
    ranking = find_metric(board.metric)
    for key, top in (
        (board.metric, None if ranking is not None and ranking.unit else 1.0),
        *((key, None) for key in (ERROR_OF_TRACK[board.track],) if key in board.keys),
    ):
        metric = find_metric(key)
        found = board.cells(key)
        curves = []
        for label, style in styles.items():
            cells = [cell for cell in found if cell.label == label and cell.sequence in values]
            y = np.array([cell.median for cell in cells])
            if len(y) and not np.isnan(y).all():
                curves.append(Curve(label, np.array([values[cell.sequence] for cell in cells]), y, style))
        if curves and metric is not None:
            about = CONDITIONS[condition]
            x_label = about.name + (f" [{about.unit}]" if about.unit else "")
            y_label = metric.heading + (f" [{metric.unit}]" if metric.unit else "")
            title = f"{metric.heading} over {about.name}"
            cards.append(card(title, scatter_plot(curves, title, x_label, y_label, top)))
    return "".join(cards)


def _making(records: Sequence[ResultRecord], command: str) -> str:
    """Command, settings, versions and machine, each distinct value once."""
    lines: dict[str, list[str]] = {}

    def add(label: str, value: str) -> None:
        if value and value not in lines.setdefault(label, []):
            lines[label].append(value)

    for record in records:
        add("Split", f"{record.split}, recipe {record.split_digest[:16]}" if record.split_digest else record.split)
        add("Evaluator", record.evaluator_version)
        add("Settings", _settings(record.settings))
        add("oysterbench", record.oysterbench_version)
        add("Machine", _settings(record.hardware))
        add("Created", record.created)
    for record in records:
        add(f"Settings of {record.method}", _settings(record.method_settings))
        add(f"{record.method} says", _settings(record.info))
    seeds: dict[str, list[str]] = {}
    for record in records:
        if record.seed is not None:
            seeds.setdefault(record.method, []).append(str(record.seed))
    for method, given in seeds.items():
        add(f"Seeds of {method}", ", ".join(dict.fromkeys(given)))
    items = "".join(f"<dt>{escape(k)}</dt><dd>{'<br>'.join(map(escape, v))}</dd>" for k, v in lines.items() if v)
    conditions = {record.sequence: _settings(record.conditions) for record in records if record.conditions}
    listed = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in conditions.items())
    folded = _folded("Conditions of each sequence", f"<dl>{listed}</dl>") if listed else ""
    return f"<h2>How this was made</h2><pre><code>{escape(command)}</code></pre><dl>{items}</dl>{folded}"


def _settings(values: Mapping[str, Any]) -> str:
    """Keys and values in one line; long values are cut, since the whole is in the JSON."""
    texts = {k: v if isinstance(v, str) else json.dumps(v, default=str) for k, v in values.items()}
    return ", ".join(f"{k} = {v if len(v) <= 2000 else v[:1997] + '...'}" for k, v in texts.items())


def _definitions(records: Sequence[ResultRecord]) -> str:
    """What the numbers mean: the metrics of the tables, then all others that were measured, folded away."""
    measured = {key for record in records for key in record.metrics}
    track = records[0].track if records else "slam"
    columns = (*OF_TRACK[track], *STANDING_OF_TRACK[track])
    shown = [key for key in dict.fromkeys(column.key for column in columns) if key in measured]
    others = [key for record in records for key in record.metrics if key not in shown]
    folded = "".join(_definition(key, records) for key in dict.fromkeys(others))
    if folded:
        folded = (
            f"<details><summary>{len(set(others))} more metrics, and their values</summary><dl>{folded}</dl></details>"
        )
    return f"<h2>What the numbers mean</h2><dl>{''.join(_definition(key) for key in shown)}</dl>{folded}"


def _definition(key: str, records: Sequence[ResultRecord] = ()) -> str:
    """Name, unit, direction and definition of a metric, and its value in each record."""
    metric = find_metric(key) or Metric("No definition is known to this version.", key)
    unit = " ".join(part for part in (f"[{metric.unit}]" if metric.unit else "", ARROWS[metric.better]) if part)
    values = [
        f"{record.method} on {record.sequence}: "
        + (f"{value:.6g}" if not math.isnan(value) else f"none, {record.reasons.get(key, '')}")
        for record in records[:SHOWN_VALUES]
        if (value := record.metrics.get(key)) is not None
    ]
    shown = f'<br><span class="values">{escape("; ".join(values))}</span>' if values else ""
    return (
        f"<dt>{escape(metric.heading or key)} <small>{escape(unit)}</small><br><code>{escape(key)}</code></dt>"
        f"<dd>{escape(metric.definition)}{shown}</dd>"
    )


SHOWN_VALUES = 8  # records whose values stand beside a definition; the JSON holds them all
