"""Columns of tables: those of metrics, made from their definitions, and those of names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from oysterbench.evaluate.metric import Metric
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.report.table import Column

UNITS = {"x": "\N{MULTIPLICATION SIGN} real time"}
"""Second line of a narrow heading -> the unit that it stands for, if that is not the metric's own."""

IN_FILES = " (0 to 1)"
"""Range of a share in files, left out of the definition where it is shown in percent."""


def metric_column(key: str, sort: bool = False, track: str = "") -> Column:
    """Column of a metric of a track; sort: whether a URL may ask to sort by it."""
    metric = find_metric(key, track) or Metric("This version has no definition of it.", key)
    about = metric.definition.replace(IN_FILES, "") if metric.factor == 100.0 else metric.definition
    unit = metric.unit or ("%" if metric.factor == 100.0 else UNITS.get(metric.narrow[1], ""))
    return Column(
        key,
        metric.heading or key,
        unit,
        "number",
        "\n".join(filter(None, metric.narrow)),
        metric.digits,
        metric.small,
        metric.factor,
        cut=key == "coverage",
        better=metric.better,
        about=about,
        sort=key if sort else "",
        wide=track in TRACKS and key in TRACKS[track].wide,
    )


def metric_columns(keys: Iterable[str], track: str = "") -> tuple[Column, ...]:
    """Columns of several metrics."""
    return tuple(metric_column(key, track=track) for key in keys)


def standing_column(key: str, track: str, sort: bool = False) -> Column:
    """Column of a metric aggregated over sequences: the mean or, for an error, the median, as the heading then says."""
    column = metric_column(key, sort, track)
    if key not in TRACKS[track].errors:
        return column
    unit, about = (
        f"{column.unit}, median".removeprefix(", "),
        f"{column.about} Median over the sequences that are not lost.",
    )
    return replace(column, unit=unit, about=about)


def lost_column(track: str, sequences: int, sort: str = "") -> Column:
    """Column of the number of sequences that a method lost, out of `sequences`."""
    about = f"Sequences with a score below {TRACKS[track].lost_below:g}: no estimate, or one that went astray."
    return Column("lost", "Lost", f"of {sequences}", "number", "lost", better="lower", about=about, sort=sort)


def lost_note(track: str) -> str:
    """Note for a table with such columns; empty if the track does not define lost sequences."""
    least = TRACKS[track].lost_below if track in TRACKS else None
    if least is None:
        return ""
    return f"A sequence with a score below {least:g} is lost; errors are medians over the others."


def name_columns(*keys: str) -> tuple[Column, ...]:
    """Text columns, each headed by its key."""
    return tuple(Column(key, key.replace("_", " ").capitalize(), short=key.replace("_", " ")) for key in keys)


OF_TRACK = {name: metric_columns(track.table, name) for name, track in TRACKS.items()}
"""Track -> columns of its results table."""

COSTS_OF_TRACK = {name: metric_columns(track.costs, name) for name, track in TRACKS.items()}
"""Track -> columns of the cost of its runs."""

STANDING_OF_TRACK = {
    name: tuple(standing_column(key, name) for key in track.standing) for name, track in TRACKS.items()
}
"""Track -> columns of its standings, beside the ranking metric."""
