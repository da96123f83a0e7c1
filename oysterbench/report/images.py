"""Contents of reports on image tracks, besides the tables of every track: whole data set, classes, curves, images."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oysterbench.evaluate.detection import DetectionClip
from oysterbench.evaluate.detection.precision import RECALLS
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.runs import span_of_runs
from oysterbench.evaluate.segmentation import ClipResult
from oysterbench.evaluate.statistics import Interval
from oysterbench.report.cards import Card, Picture, PlotGroup
from oysterbench.report.columns import metric_column, metric_columns, name_columns
from oysterbench.report.formats import csv_of
from oysterbench.report.plots import Curve, share_plot
from oysterbench.report.table import Column, Estimate, Table, TableRow, interval_column
from oysterbench.results.records import ResultRecord, plain

LEGEND = "Green: found. Blue: missed. Orange: false positive. Grey: ignored."
STRATA = {"iou_range_": "range", "recall_height_": "shell height", "recall_area_": "visible area", "iou_": "class"}
"""Prefix of the keys of metrics by class within images -> what the classes are of."""


@dataclass(frozen=True)
class Sample:
    """An image overlaid with the prediction of a method, as JPEG."""

    name: str
    method: str
    jpeg: bytes


@dataclass(frozen=True)
class ImageRun:
    """One run of a method on a clip: its record, and its result, None where it failed."""

    record: ResultRecord
    result: ClipResult | DetectionClip | None = None
    samples: tuple[Sample, ...] = ()


@dataclass(frozen=True)
class DatasetRow:
    """A method over all clips together: metrics, reasons for missing ones, confidence intervals where they exist,
    number of clips, and (C,) of runs on each; totals are as of one run. left_out: clips without a result of each other
    method that has no row, as it has not run or has failed on them."""

    track: str
    method: str
    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    intervals: Mapping[str, Interval]
    clips: int
    whole: ClipResult | DetectionClip
    runs: Sequence[int] = (1,)
    left_out: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def as_plain(self) -> dict[str, Any]:
        """Convert to plain values for JSON; a number that does not exist is null, with the reason beside it."""
        intervals = {
            key: {"low": found.low, "high": found.high, "reason": found.reason} for key, found in self.intervals.items()
        }
        return {
            "method": self.method,
            "clips": self.clips,
            "metrics": plain(self.metrics),
            "reasons": dict(self.reasons),
            "intervals": plain(intervals),
        }


def dataset_tables(rows: Sequence[DatasetRow]) -> list[Table]:
    """Tables of the data set as a whole, of counts, and of classes within images, each if it has rows."""
    if not rows:
        return []
    return [_dataset_table(rows), *(table for table in (_count_table(rows), _strata_table(rows)) if table.rows)]


def _dataset_table(rows: Sequence[DatasetRow]) -> Table:
    keys = TRACKS[rows[0].track].table
    with_mean = keys[:1] if not any("miou" in row.metrics for row in rows) else (keys[0], "miou")
    first, *others = metric_columns((*with_mean, *keys[1:]))
    table_rows = [
        TableRow(
            (
                row.method,
                row.metrics.get(first.key),
                row.intervals.get(first.key),
                *(row.metrics.get(column.key) for column in others),
            )
        )
        for row in rows
    ]
    clips = f"{rows[0].clips} sequence{'' if rows[0].clips == 1 else 's'}"
    unknown = next((row.intervals[first.key].reason for row in rows if first.key in row.intervals), "")
    about = f"All images of {clips} together"
    runs = [count for row in rows for count in row.runs]
    if max(runs) > 1:
        about += f", in {span_of_runs(runs)} on each; totals are as of one run"
    notes = [f"{about}; {unknown}." if unknown else f"{about}; sequences are resampled for the interval."]
    if missed := rows[0].left_out:
        lacking = (f"{method}, as it has no result on {_some(names)}" for method, names in missed.items())
        notes.append(f"Left out: {'; '.join(lacking)}.")
    columns = (*name_columns("method"), first, interval_column(first), *others)
    return Table("Over the data set", columns, tuple(table_rows), tuple(notes))


def lacking_table(lacking: Mapping[str, Sequence[str]]) -> Table:
    """Table in place of that of the data set as a whole, where no method has a result on every sequence. lacking: names
    of the sequences without one, by method."""
    rows = tuple(TableRow((method, _some(names))) for method, names in lacking.items())
    note = "No method has a result on every sequence, so there are no values over all of them together."
    return Table("Over the data set", name_columns("method", "no_result_on"), rows, (note,))


def _some(names: Sequence[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


COUNTS = (
    "count_truth",
    "count_estimate",
    "count_bias",
    "count_mae",
    "live_error",
    "f1_live",
    "f1_dead",
    "state_accuracy",
)


def _count_table(rows: Sequence[DatasetRow]) -> Table:
    """Table of true and counted numbers of oysters, errors per image with their intervals, and live and dead ones."""
    columns = [replace(column, kind="estimate") for column in metric_columns(COUNTS)]
    table_rows = [
        TableRow(
            (
                row.method,
                *(
                    Estimate(row.metrics[key], row.intervals.get(key, Interval(math.nan, math.nan, "none")))
                    for key in COUNTS
                ),
            )
        )
        for row in rows
        if "count_truth" in row.metrics
    ]
    return Table("Counts", (*name_columns("method"), *columns), tuple(table_rows), ("Bias and MAE are per image.",))


def _strata_table(rows: Sequence[DatasetRow]) -> Table:
    """Table with a row per class of range, size and so on, and a column per method; intervals in brackets if known."""
    keys = dict.fromkeys(key for row in rows for key in row.metrics)
    table_rows, by_size = [], False
    for begin, noun in STRATA.items():
        for key in keys:
            if not key.startswith(begin) or (begin == "iou_" and key.startswith("iou_range_")):
                continue
            values = [row.metrics.get(key, math.nan) for row in rows]
            if not all(map(math.isnan, values)):
                measure, _, name = metric_column(key).heading.partition(", ")
                by_size |= measure == "Recall"
                intervals = [row.intervals.get(key, Interval(math.nan, math.nan, "none")) for row in rows]
                table_rows.append(TableRow((noun, name, measure, *map(Estimate, values, intervals))))
    columns = (
        *name_columns("of", "class", "metric"),
        *(Column(r.method, r.method, "", "estimate", digits=3) for r in rows),
    )
    note = (
        "False positives belong to no oyster, so only recall is given by size: it is highest for a method that "
        "calls everything oyster."
    )
    return Table("By class within images", columns, tuple(table_rows), (note,) if by_size else ())


def curves_group(rows: Sequence[DatasetRow], styles: Mapping[str, int]) -> PlotGroup | None:
    """Plots of IoU over thresholds, and of precision over recall."""
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
        cards.append(Card(title, share_plot(over, title, "threshold", "IoU")))
    if any(not np.isnan(curve.y).all() for curve in against):
        title = "Precision over recall of " + ("pixels" if over else "oysters, at an overlap of 0.5")
        cards.append(Card(title, share_plot(against, title, "recall", "precision")))
    legend = tuple((curve.label, curve.style) for curve in against)
    return PlotGroup("Curves", legend, tuple(cards)) if cards else None


def sample_pictures(runs: Sequence[ImageRun]) -> list[tuple[str, list[Picture]]]:
    """Sequences with their sample images, the same image side by side for all methods."""
    shown: dict[str, dict[str, list[Picture]]] = {}
    for run in runs:
        sequence = run.record.sequence
        for sample in run.samples:
            about = f"{sample.name}, {sample.method}"
            picture = Picture(sample.jpeg, sample.method, sample.name.removeprefix(f"{sequence}/"), about)
            shown.setdefault(sequence, {}).setdefault(sample.name, []).append(picture)
    return [(sequence, [one for same in of.values() for one in same]) for sequence, of in shown.items()]


def images_csv(runs: Sequence[ImageRun]) -> str:
    """CSV with a line per image, method and run; an empty field where there is no value."""
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
    return csv_of(rows)
