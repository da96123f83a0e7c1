"""Tables of the track steering: all pictures together, and where a pilot stands between two others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from oysterbench.evaluate.statistics import LEVEL, Comparison, compare
from oysterbench.evaluate.steering.dataset import Whole, over_sequences
from oysterbench.evaluate.steering.rollouts import NormalisedScore, normalised_score
from oysterbench.report.columns import ABSENT, OF_TRACK, Column, find_column
from oysterbench.report.steering import DiveRun, PictureRun
from oysterbench.report.tables import MINUS, Heading, Line, Table, interval_text
from oysterbench.results.records import ResultRecord, samples

INTERVALS = ("skill", "yaw_macro_f1", "pitch_macro_f1")
"""Metrics over all pictures that are shown with their interval."""

OF_PAIRS = ("oysters_per_min", "covered_share", "contacts_per_min")
"""Metrics that pilots are compared by, each on the same reefs."""

LOWER, UPPER = "random", "expert"
"""The pilots between which others have a place."""


def whole_of(runs: Sequence[PictureRun]) -> dict[str, Whole]:
    """Each method over all pictures, if it failed on no sequence."""
    groups: dict[str, list[PictureRun]] = {}
    for run in runs:
        groups.setdefault(run.record.method, []).append(run)
    found = {}
    for method, group in groups.items():
        parts = [(run.labels, run.commands) for run in group if run.labels is not None and run.commands is not None]
        if len(parts) == len(group):
            found[method] = over_sequences(parts)
    return found


def pictures_table(wholes: Mapping[str, Whole]) -> Table:
    """A line per method, over all pictures together."""
    columns = OF_TRACK["steering"]
    texts = {c.key: c.texts([whole.score.metrics.get(c.key) for whole in wholes.values()]) for c in columns}
    lines = []
    for i, (method, whole) in enumerate(wholes.items()):
        cells = [method]
        for column in columns:
            cells.append(texts[column.key][i])
            if column.key in INTERVALS:
                cells.append(interval_text(whole.intervals[column.key], column))
        lines.append(Line(tuple(cells)))
    headings = [Heading("method", number=False)]
    for column in columns:
        headings.append(Heading(column.heading, column.unit, column.key))
        if column.key in INTERVALS:
            headings.append(Heading(f"{LEVEL:.0%}", "interval"))
    notes = []
    for whole in list(wholes.values())[:1]:
        n, pictures = whole.sequences, whole.score.metrics["pictures"]
        notes.append(f"{pictures:.0f} pictures of {n} sequence{'' if n == 1 else 's'} together; these are resampled.")
        if reason := whole.intervals["skill"].reason:
            notes.append(f"{reason[0].upper()}{reason[1:]}.")
    return Table("Over all pictures", tuple(headings), tuple(lines), tuple(notes))


def _pilots(runs: Sequence[DiveRun]) -> dict[str, list[ResultRecord]]:
    found: dict[str, list[ResultRecord]] = {}
    for run in runs:
        found.setdefault(run.record.method, []).append(run.record)
    return found


def pilots_table(runs: Sequence[DiveRun]) -> Table:
    """Every pilot against each that comes after it: differences on the same reefs, of several metrics."""
    pilots = _pilots(runs)
    names = list(pilots)
    lines = []
    for key in OF_PAIRS:
        column = find_column(key)
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                better = "lower" if key.startswith("contacts") else "higher"
                found = compare(samples(pilots[a], key), samples(pilots[b], key), better)  # type: ignore[arg-type]
                lines.append(Line((f"{a} {MINUS} {b}", *_difference(column, found))))
    headings = (
        Heading("pilots", number=False),
        Heading("metric", number=False),
        Heading("difference"),
        Heading(f"{LEVEL:.0%}", "interval"),
        Heading("reefs", "won / tied / lost"),
        Heading("verdict", number=False),
    )
    return Table("Pilot against pilot", headings, tuple(lines))


def _difference(column: Column, found: Comparison) -> tuple[str, ...]:
    difference = ABSENT
    if not math.isnan(found.difference):
        difference = f"{found.difference * column.factor:+.{column.decimals}f}".replace("-", MINUS)
    return (
        f"{column.heading} [{column.unit}]",
        difference,
        interval_text(found.interval, column),
        f"{found.wins} / {found.ties} / {found.losses}",
        found.verdict if found.interval.known else "too few reefs to tell",
    )


def places(runs: Sequence[DiveRun]) -> dict[str, NormalisedScore]:
    """Where each pilot stands between LOWER and UPPER, by oysters per minute; none where one of these is not there."""
    pilots = {name: samples(records, "oysters_per_min") for name, records in _pilots(runs).items()}
    if LOWER not in pilots or UPPER not in pilots:
        return {}
    return {
        name: normalised_score(sample, pilots[LOWER], pilots[UPPER])
        for name, sample in pilots.items()
        if name not in (LOWER, UPPER)
    }


def places_table(found: Mapping[str, NormalisedScore]) -> Table:
    """A line per pilot."""
    column = Column("place", "place", "", decimals=2, small=0.0)
    lines = []
    for name, place in found.items():
        value = ABSENT if math.isnan(place.value) else f"{place.value:.2f}".replace("-", MINUS)
        lines.append(Line((name, value, interval_text(place.interval, column), str(place.reefs))))
    headings = (
        Heading("pilot", number=False),
        Heading("place", f"{LOWER} 0, {UPPER} 1"),
        Heading(f"{LEVEL:.0%}", "interval"),
        Heading("reefs"),
    )
    reasons = dict.fromkeys(place.reason or place.interval.reason for place in found.values())
    notes = [f"(pilot {MINUS} {LOWER}) / ({UPPER} {MINUS} {LOWER}), of the mean oysters per minute on the same reefs."]
    return Table(
        f"Place between {LOWER} and {UPPER}",
        headings,
        tuple(lines),
        (*notes, *(f"{reason[0].upper()}{reason[1:]}." for reason in reasons if reason)),
    )
