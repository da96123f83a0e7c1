"""Tables for the terminal and a self-contained HTML report. Both read results only."""

from __future__ import annotations

import base64
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.metrics import SLAM
from oysterbench.evaluate.slam import SlamResult
from oysterbench.files import write_atomically
from oysterbench.geometry import Array
from oysterbench.page import STYLES, page
from oysterbench.plots import Curve, height_plot, map_plot, swatch, thin, time_plot
from oysterbench.results import ResultRecord, aggregate
from oysterbench.trajectory import Trajectory, ns_to_seconds

if TYPE_CHECKING:
    from rich.table import Table

ABSENT = "\N{EN DASH}"
TIME = "time since start [s]"
COMPLETE = 0.95
"""Of the highest coverage on a sequence: what a run must answer to be called the best there."""


@dataclass(frozen=True)
class Column:
    """A metric in a table: key, heading and unit below it, factor to the shown unit.

    decimals: of ordinary values; one more is shown where a value lies below `small`
    """

    key: str
    heading: str
    unit: str
    factor: float = 1.0
    decimals: int = 2
    small: float = 0.1

    def texts(self, values: Sequence[float | None]) -> list[str]:
        """The values as shown, all with the same decimals, so that the eye can compare them.

        Coverage is cut, not rounded: 100 is said of nothing less.
        """
        known = [abs(value * self.factor) for value in values if value is not None and math.isfinite(value)]
        decimals = self.decimals + any(0 < value < self.small for value in known)
        return [ABSENT if value is None or math.isnan(value) else self._text(value, decimals) for value in values]

    def _text(self, value: float, decimals: int) -> str:
        if self.key == "coverage":
            return f"{math.floor(value * self.factor * 10 + 1e-9) / 10:.1f}"
        return f"{value * self.factor:.{decimals}f}"


COLUMNS = (
    Column("ate_rmse_m", "ATE", "m", decimals=3, small=0.01),
    Column("ate_percent", "ATE", "%"),
    Column("ate_rotation_rmse_deg", "rot", "deg"),
    Column("rpe_1s_translation_rmse_m", "RPE 1s", "m", decimals=3, small=0.01),
    Column("rpe_1s_rotation_rmse_deg", "RPE 1s", "deg"),
    Column("coverage", "cover", "%", factor=100.0),
    Column("realtime_factor", "speed", "x real", decimals=1),
)


@dataclass(frozen=True)
class Row:
    """A line of a table: name of the sequence (or of the mean), method, texts by column, which of them are the best."""

    name: str
    method: str
    cells: tuple[str, ...]
    best: tuple[bool, ...] = (False,) * len(COLUMNS)
    failed: bool = False
    mean: bool = False


def rows(records: Sequence[ResultRecord]) -> list[Row]:
    """Records by sequence, in the order of their first appearance, then the means where there are two sequences."""
    order = list(dict.fromkeys(record.sequence for record in records))
    records = sorted(records, key=lambda record: order.index(record.sequence))
    means = aggregate(records) if len(order) > 1 else []
    best = _best(records)
    metrics = [record.metrics for record in records] + [mean["metrics"] for mean in means]
    cells = list(zip(*(c.texts([values.get(c.key) for values in metrics]) for c in COLUMNS), strict=True))
    found = [
        Row(
            record.sequence,
            record.method,
            texts,
            tuple(record.metrics.get(c.key) == best.get((record.sequence, c.key), math.nan) for c in COLUMNS),
            failed=record.failure is not None,
        )
        for record, texts in zip(records, cells, strict=False)
    ]
    for mean, texts in zip(means, cells[len(records) :], strict=True):
        failures = f", {mean['failures']} failed" if mean["failures"] else ""
        found.append(Row(f"mean of {mean['sequences']}{failures}", mean["method"], texts, mean=True))
    return found


def _best(records: Sequence[ResultRecord]) -> dict[tuple[str, str], float]:
    """Best value of each sequence and column, where methods were compared and the metric has a direction.

    Only runs that answer nearly as much as the most complete one compete: an error over the easy part is no record.
    """
    most: dict[str, float] = {}
    for record in records:
        most[record.sequence] = max(most.get(record.sequence, 0.0), record.metrics.get("coverage", 1.0))
    values: dict[tuple[str, str], list[float]] = {}
    for record in records:
        if record.metrics.get("coverage", 1.0) < COMPLETE * most[record.sequence]:
            continue
        for column in COLUMNS:
            value = record.metrics.get(column.key, math.nan)
            if not math.isnan(value):
                values.setdefault((record.sequence, column.key), []).append(value)
    best = {}
    for (sequence, key), found in values.items():
        if len(found) > 1 and min(found) < max(found):
            best[sequence, key] = max(found) if SLAM[key].better == "higher" else min(found)
    return best


def slam_table(records: Sequence[ResultRecord], colour: bool = True) -> Table:
    """A table of at most 80 columns where names are short; failures and notes stand below it, in words."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption_justify="left")
    table.header_style = "bold" if colour else ""
    table.add_column("sequence", overflow="fold")
    table.add_column("method", overflow="fold")
    for column in COLUMNS:
        table.add_column(f"{column.heading}\n{column.unit}", justify="right", no_wrap=True)
    before_means = True
    for row in rows(records):
        if row.mean and before_means:
            table.add_section()
            before_means = False
        styles = ["bold green" if colour and best else "" for best in row.best]
        cells = [Text(text, style=style) for text, style in zip(row.cells, styles, strict=True)]
        method = Text(row.method, style="red" if colour and row.failed else "")
        table.add_row(Text(row.name), method, *cells, style="bold" if colour and row.mean else "")
    remarks = _remarks(records)
    if remarks:
        table.caption = Text("\n".join(remarks), style="yellow" if colour else "")
        table.caption_style = ""
    return table


def _remarks(records: Sequence[ResultRecord]) -> list[str]:
    remarks = []
    for record in records:
        name = f"{record.method} on {record.sequence}"
        if record.failure is not None:
            remarks.append(f"{name} failed: {record.failure}")
        remarks += [f"{name}: {note}" for note in record.notes]
    return remarks


@dataclass(frozen=True)
class SlamRun:
    """One run for the report: its record, its poses if it was scored, and camera frames as (stamp in ns, JPEG)."""

    record: ResultRecord
    result: SlamResult | None = None
    frames: Sequence[tuple[int, bytes]] = ()


def write_html_report(
    path: str | os.PathLike[str], runs: Sequence[SlamRun], command: str, title: str | None = None
) -> None:
    """Write `html_report` to a file, nothing half-written."""
    write_atomically(path, html_report(runs, command, title).encode())


def html_report(runs: Sequence[SlamRun], command: str, title: str | None = None) -> str:
    """A self-contained page: table, trajectories, errors over time, frames, and how it was all made."""
    records = [run.record for run in runs]
    splits = list(dict.fromkeys(record.split for record in records if record.split))
    sequences = list(dict.fromkeys(record.sequence for record in records))
    methods = list(dict.fromkeys(record.method for record in records))
    title = title or f"SLAM on {', '.join(splits or sequences)}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(", ".join(methods))} on {_count(len(sequences), "sequence")}, scored by oysterbench '
        f"{escape(records[0].oysterbench_version)} on {escape(records[0].created[:10])}.</p>"
        if records
        else '<p class="lead">No runs.</p>',
        _table(records),
        *(f'<p class="small warn">{escape(remark)}</p>' for remark in _remarks(records)),
    ]
    styles = {method: 1 + i % STYLES for i, method in enumerate(methods)}
    for sequence in sequences:
        parts.append(_sequence([run for run in runs if run.record.sequence == sequence], sequence, styles))
    parts.append(_making(records, command))
    parts.append(_definitions(records))
    return page(title, "\n".join(parts))


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" + ("" if n == 1 else "s")


def _table(records: Sequence[ResultRecord]) -> str:
    """Results as an HTML table that scrolls sideways on a narrow screen."""
    arrows = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
    headings = "".join(
        f'<th scope="col" title="{escape(SLAM[c.key].definition)}">{_unbroken(SLAM[c.key].short)}'
        f"<br><small>{escape(c.unit)} {arrows[SLAM[c.key].better]}</small></th>"
        for c in COLUMNS
    )
    lines = []
    found = rows(records)
    for i, row in enumerate(found):
        first = row.mean and not found[i - 1].mean
        kind = f' class="mean{" first" if first else ""}"' if row.mean else ""
        cells = "".join(
            f"<td{' class=best' if best else ''}>{text}</td>" for text, best in zip(row.cells, row.best, strict=True)
        )
        warn = " warn" if row.failed else ""
        method = f'<td class="name{warn}">{escape(row.method)}{" (failed)" if row.failed else ""}</td>'
        lines.append(f'<tr{kind}><th scope="row">{escape(row.name)}</th>{method}{cells}</tr>')
    shaded = (
        " The best of each sequence is shaded, among runs that answer at least "
        f"{COMPLETE:.0%} of what the most complete one does."
        if any(any(row.best) for row in found)
        else ""
    )
    return (
        '<div class="scroll" role="region" aria-label="Results" tabindex="0"><table aria-describedby="reading"><thead>'
        f'<tr><th scope="col">Sequence</th><th scope="col" class="name">Method</th>{headings}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
        f'<p class="small" id="reading">{arrows["lower"]} lower is better, '
        f"{arrows['higher']} higher is better; read every error beside its coverage.{shaded}</p>"
    )


def _unbroken(heading: str) -> str:
    return escape(heading).replace("1 s", "1&nbsp;s")


def _sequence(runs: Sequence[SlamRun], name: str, styles: Mapping[str, int]) -> str:
    """Plots and frames of one sequence."""
    scored = [(run.record.method, run.result) for run in runs if run.result is not None]
    parts = [f"<h2>{escape(name)}</h2>"]
    begin_ns = None
    if scored:
        truth = scored[0][1].whole_truth
        begin_ns = int(truth.stamps_ns[0])
        end_s = (int(truth.stamps_ns[-1]) - begin_ns) * 1e-9
        parts.append(
            f'<p class="small">{truth.path_length:.1f} m of path in {end_s:.1f} s, from stamp '
            f"{ns_to_seconds(begin_ns)} s. Estimates are shown where they answer, aligned by "
            f"{escape(scored[0][1].settings.align)}.</p>"
        )
        parts.append(_legend([("truth", 0), *((method, styles[method]) for method, _ in scored)]))
        parts.append(_maps(truth, scored, styles))
        parts.append(_errors(begin_ns, end_s, scored, styles))
    else:
        parts.append('<p class="small">No run on this sequence could be scored.</p>')
    frames = next((run.frames for run in runs if run.frames), ())
    if frames:
        parts.append(f"<h3>Camera frames</h3><div class=frames>{''.join(_frame(*f, begin_ns) for f in frames)}</div>")
    return "\n".join(parts)


def _legend(entries: Sequence[tuple[str, int]]) -> str:
    items = "".join(f"<li>{swatch(style)}{escape(label)}</li>" for label, style in entries)
    return (
        f'<ul class="legend" aria-label="Legend">{items}<li class="small">\N{WHITE CIRCLE} start, '
        "\N{WHITE SQUARE} end of the truth</li></ul>"
    )


def _maps(truth: Trajectory, scored: Sequence[tuple[str, SlamResult]], styles: Mapping[str, int]) -> str:
    """The trajectories from above, from the side that shows more of them, and their height over time."""
    extent = np.ptp(truth.positions, axis=0)
    side = 0 if extent[0] >= extent[1] else 1
    axes = ("east x [m]", "north y [m]", "height z [m]")
    shown = [("truth", truth, 0), *((method, result.estimate, styles[method]) for method, result in scored)]

    def seen(title: str, i: int, j: int, least_height: float) -> str:
        curves = [_outline(*entry, i, j) for entry in shown]
        return _card(title, map_plot(curves, title, axes[i], axes[j], least_height))

    begin_ns, end_s = int(truth.stamps_ns[0]), float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    heights = []
    for label, trajectory, style in shown:
        seconds = (trajectory.stamps_ns - begin_ns) * 1e-9
        heights.append(Curve(label, *_broken(trajectory.stamps_ns, seconds, trajectory.positions[:, 2]), style))
    title = "Height over time"
    height = _card(title, height_plot(heights, title, TIME, axes[2], (0.0, end_s)))
    above, beside = seen("Seen from above", 0, 1, 400.0), seen("Seen from the side", side, 2, 110.0)
    return f'<div class="pair">{above}<div class="stack">{beside}{height}</div></div>'


def _card(title: str, plot: str) -> str:
    return f'<div class="card"><h3>{escape(title)}</h3>{plot}</div>'


def _outline(label: str, trajectory: Trajectory, style: int, i: int, j: int) -> Curve:
    """Coordinates i and j of a trajectory, thinned evenly, broken where its stamps are."""
    step = max(1, len(trajectory) // 800)
    index = np.unique(np.r_[0 : len(trajectory) : step, len(trajectory) - 1])
    stamps, positions = trajectory.stamps_ns[index], trajectory.positions[index]
    return Curve(label, *_broken(stamps, positions[:, i], positions[:, j]), style)


def _broken(stamps_ns: NDArray[np.int64], x: NDArray[Any], y: NDArray[Any]) -> tuple[Array, Array]:
    """x and y with a NaN wherever the stamps jump by more than 4 of their median steps and by more than 0.25 s."""
    steps = np.diff(stamps_ns)
    if not len(steps):
        return x, y
    jumps = np.flatnonzero((steps > 4 * np.median(steps)) & (steps > 250_000_000)) + 1
    return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)


def _errors(begin_ns: int, end_s: float, scored: Sequence[tuple[str, SlamResult]], styles: Mapping[str, int]) -> str:
    """Translation and rotation error over time."""
    cards = []
    for title, unit, key in (
        ("Position error over time", "error [m]", "error_m"),
        ("Rotation error over time", "error [deg]", "rotation_error_deg"),
    ):
        curves = []
        for method, result in scored:
            seconds = (result.stamps_ns - begin_ns) * 1e-9
            curves.append(
                thin(Curve(method, *_broken(result.stamps_ns, seconds, getattr(result, key)), styles[method]))
            )
        cards.append(_card(title, time_plot(curves, title, TIME, unit, (0.0, end_s))))
    return f'<div class="pair">{"".join(cards)}</div>'


def _frame(stamp_ns: int, jpeg: bytes, begin_ns: int | None) -> str:
    since = "" if begin_ns is None else f"{(stamp_ns - begin_ns) * 1e-9:.2f} s"
    stamp = ns_to_seconds(stamp_ns)
    caption = f"{since} <small>(stamp {stamp})</small>" if since else f"stamp {stamp}"
    data = base64.b64encode(jpeg).decode()
    return (
        f'<figure><img loading="lazy" alt="Camera frame at {since or stamp}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


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
    items = "".join(f"<dt>{escape(k)}</dt><dd>{'<br>'.join(map(escape, v))}</dd>" for k, v in lines.items() if v)
    return f"<h2>How this was made</h2><pre><code>{escape(command)}</code></pre><dl>{items}</dl>"


def _settings(values: Mapping[str, Any]) -> str:
    """Keys and values in one line; long values are cut, since the whole is in the JSON."""
    texts = {k: v if isinstance(v, str) else json.dumps(v, default=str) for k, v in values.items()}
    return ", ".join(f"{k} = {v if len(v) <= 2000 else v[:1997] + '...'}" for k, v in texts.items())


def _definitions(records: Sequence[ResultRecord]) -> str:
    """What the numbers mean: the shown metrics, whichever were measured."""
    measured = {key for record in records for key in record.metrics}
    items = "".join(
        f"<dt>{escape(SLAM[c.key].short)} <small>[{escape(c.unit)}]</small></dt>"
        f"<dd>{escape(SLAM[c.key].definition)}</dd>"
        for c in COLUMNS
        if c.key in measured
    )
    return f"<h2>What the numbers mean</h2><dl>{items}</dl>"
