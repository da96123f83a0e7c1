"""What tracks of images show besides the tables of every track: the data set as a whole, classes, curves, pictures."""

from __future__ import annotations

import base64
import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from oysterbench.evaluate.detection import DetectionClip
from oysterbench.evaluate.detection.precision import RECALLS
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.segmentation import ClipResult
from oysterbench.evaluate.statistics import LEVEL, Interval
from oysterbench.report.columns import ABSENT, OF_TRACK
from oysterbench.report.plots import Curve, share_plot, swatch
from oysterbench.report.sequences import card
from oysterbench.report.tables import Heading, Line, Table, interval_text
from oysterbench.results.records import ResultRecord, plain

LEGEND = "Green: found. Blue: missed. Orange: called oyster, and none. Grey: ignored."
SHOWN_CLIPS = 12  # with pictures; more would make a report of many megabytes
STRATA = {"iou_range_": "range", "recall_height_": "shell height", "recall_area_": "visible area", "iou_": "class"}
"""How keys of classes within images begin -> what they are classes of."""


@dataclass(frozen=True)
class Sample:
    """A picture with what a method says painted over it, as JPEG."""

    name: str
    method: str
    jpeg: bytes


@dataclass(frozen=True)
class ImageRun:
    """One run of a method on a clip: its record; None for a result where it failed."""

    record: ResultRecord
    result: ClipResult | DetectionClip | None = None
    samples: tuple[Sample, ...] = ()


@dataclass(frozen=True)
class DatasetRow:
    """A method over all clips together: metrics with reasons, intervals of those that have one, number of clips."""

    method: str
    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    intervals: Mapping[str, Interval]
    clips: int
    whole: ClipResult | DetectionClip

    def as_plain(self) -> dict[str, Any]:
        """For JSON; a number that does not exist is null, with the reason beside."""
        intervals = {
            key: {"low": found.low, "high": found.high, "reason": found.reason} for key, found in self.intervals.items()
        }
        return plain(
            {
                "method": self.method,
                "clips": self.clips,
                "metrics": self.metrics,
                "reasons": self.reasons,
                "intervals": intervals,
            }
        )


def track_of(row: DatasetRow) -> str:
    """Of the two."""
    return "segmentation" if isinstance(row.whole, ClipResult) else "detection"


def dataset_tables(rows: Sequence[DatasetRow]) -> list[Table]:
    """The data set as a whole, and classes within images, each where there is something to say."""
    if not rows:
        return []
    return [_dataset_table(rows), *([strata] if (strata := _strata_table(rows)).lines else [])]


def _dataset_table(rows: Sequence[DatasetRow]) -> Table:
    columns = OF_TRACK[track_of(rows[0])]
    if any("miou" in row.metrics for row in rows):
        columns = (*columns[:1], _like(columns[0], "miou", "mIoU"), *columns[1:])
    texts = {c.key: c.texts([row.metrics.get(c.key) for row in rows]) for c in columns}
    first = columns[0]
    lines = [
        Line((row.method, texts[first.key][i], _interval(row, first.key), *(texts[c.key][i] for c in columns[1:])))
        for i, row in enumerate(rows)
    ]
    headings = (
        Heading("method", number=False),
        Heading(first.heading, first.unit, first.key),
        Heading(f"{LEVEL:.0%}", "interval"),
        *(Heading(c.heading, c.unit, c.key) for c in columns[1:]),
    )
    notes = [f"All images of {rows[0].clips} clip{'' if rows[0].clips == 1 else 's'} together; clips are resampled."]
    unknown = next((r.intervals[first.key].reason for r in rows if first.key in r.intervals), "")
    return Table("Over the data set", headings, tuple(lines), (*notes, *([unknown.capitalize()] if unknown else [])))


def _like(column: Any, key: str, heading: str) -> Any:
    return type(column)(key, heading, column.unit, column.factor, column.decimals, column.small)


def _interval(row: DatasetRow, key: str) -> str:
    found = row.intervals.get(key)
    return ABSENT if found is None else interval_text(found, OF_TRACK[track_of(row)][0])


def _strata_table(rows: Sequence[DatasetRow]) -> Table:
    """A line per class of range, size and so on, a column per method; intervals in brackets where there are any."""
    keys = dict.fromkeys(key for row in rows for key in row.metrics)
    lines = []
    for begin, noun in STRATA.items():
        for key in keys:
            if not key.startswith(begin) or (begin == "iou_" and key.startswith("iou_range_")):
                continue
            if all(math.isnan(row.metrics.get(key, math.nan)) for row in rows):
                continue
            metric = find_metric(key)
            short = metric.heading if metric is not None else key
            measure, _, name = short.partition(", ")
            lines.append(Line((noun, name, measure, *(_stratum(row, key) for row in rows))))
    headings = (
        Heading("of", number=False),
        Heading("class", number=False),
        Heading("metric", number=False),
        *(Heading(row.method, name=True) for row in rows),
    )
    note = "False positives belong to no oyster: by size there is recall alone, which calling everything oyster wins."
    by_size = any(line.cells[2] == "Recall" for line in lines)
    return Table("By class within images", headings, tuple(lines), (note,) if by_size else ())


def _stratum(row: DatasetRow, key: str) -> str:
    value = row.metrics.get(key, math.nan)
    found = row.intervals.get(key)
    bracket = f" [{interval_text(found, OF_TRACK['segmentation'][0])}]" if found is not None and found.known else ""
    return ABSENT if math.isnan(value) else f"{value:.3f}{bracket}"


def curves_section(rows: Sequence[DatasetRow], styles: Mapping[str, int]) -> str:
    """IoU over thresholds, and precision over recall."""
    cards = []
    over, against = [], []
    for row in rows:
        style = styles.get(row.method, 1)
        if isinstance(row.whole, DetectionClip):
            against.append(Curve(row.method, RECALLS, row.whole.curve, style))
        elif (found := row.whole.curve) is not None:
            over.append(Curve(row.method, found.thresholds, found.iou, style))
            against.append(Curve(row.method, found.recall, found.precision, style))
    if over:
        title = "IoU over the threshold of probability"
        cards.append(card(title, share_plot(over, title, "threshold", "IoU")))
    if any(not np.isnan(curve.y).all() for curve in against):
        title = "Precision over recall of " + ("pixels" if over else "oysters, at an overlap of 0.5")
        cards.append(card(title, share_plot(against, title, "recall", "precision")))
    if not cards:
        return ""
    items = "".join(
        f'<li data-label="{escape(curve.label)}">{swatch(curve.style)}{escape(curve.label)}</li>' for curve in against
    )
    legend = f'<ul class="legend" aria-label="Legend">{items}</ul>'
    return f'<section class="sequence"><h2>Curves</h2>{legend}<div class="pair">{"".join(cards)}</div></section>'


def samples_section(runs: Sequence[ImageRun]) -> str:
    """Pictures, clip by clip, the same picture of each method side by side."""
    clips = list(dict.fromkeys(run.record.sequence for run in runs if run.samples))
    if not clips:
        return ""
    parts = [f'<h2>Pictures</h2><p class="small">{LEGEND}</p>']
    for clip in clips[:SHOWN_CLIPS]:
        of_clip = [run for run in runs if run.record.sequence == clip]
        names = dict.fromkeys(sample.name for run in of_clip for sample in run.samples)
        figures = [
            _figure(sample, f"{sample.method}<br><small>{escape(sample.name.removeprefix(clip + '/'))}</small>")
            for name in names
            for run in of_clip
            for sample in run.samples
            if sample.name == name
        ]
        parts.append(f'<h3>{escape(clip)}</h3><div class="frames">{"".join(figures)}</div>')
    if len(clips) > SHOWN_CLIPS:
        parts.append(f'<p class="small">Shown are {SHOWN_CLIPS} of {len(clips)} clips.</p>')
    return "".join(parts)


def _figure(sample: Sample, caption: str) -> str:
    data = base64.b64encode(sample.jpeg).decode()
    about = escape(f"{sample.name}, {sample.method}")
    return (
        f'<figure><img loading="lazy" alt="{about}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def images_csv(runs: Sequence[ImageRun]) -> str:
    """A line per image and method; an empty field where there is no value."""
    rows: list[dict[str, Any]] = []
    for run in runs:
        about = {"clip": run.record.sequence, "method": run.record.method, "run": run.record.run}
        if isinstance(run.result, ClipResult):
            for image in run.result.images:
                pixels = {k: v for k, v in image.tally.items() if re.fullmatch(r"(true|false)_\w+_px|ignored_px", k)}
                rows.append({**about, "image": image.name, **image.metrics, **pixels})
        elif run.result is not None:
            for one in run.result.counts:
                rows.append(
                    {
                        **about,
                        "image": one.name,
                        "count_truth": one.truth,
                        "count_estimate": one.estimate,
                        "footprint_m2": one.footprint_m2,
                    }
                )
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: "" if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()})
    return text.getvalue()
