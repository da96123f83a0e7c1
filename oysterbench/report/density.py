"""What the density track shows besides the tables of every track: a map of each run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from oysterbench.report.cards import Card
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class DensityRun:
    """A map, scored: its record, and what was made (`density.OysterMap`), None where it failed.

    panels: of its figure, by their titles, as SVG; said: count and interval, in words
    """

    record: ResultRecord
    result: Any = None
    panels: tuple[tuple[str, str], ...] = ()
    said: str = ""


def map_cards(runs: Sequence[DensityRun]) -> list[tuple[Card, ...]]:
    """The maps, sequence by sequence, those of a run side by side."""
    return [
        tuple(
            Card(f"{run.record.sequence}, {run.record.method}: {title[:1].lower()}{title[1:]}", figure, run.said)
            for title, figure in run.panels
        )
        for run in runs
        if run.panels
    ]
