"""Maps of the runs of the density track, for its report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from oysterbench.report.cards import Card
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class DensityRun:
    """A scored map: its record, and the map itself (`mapping.OysterMap`), None where it failed.

    panels: titles and SVGs of the panels of its figure; said: count and interval, in words
    """

    record: ResultRecord
    result: Any = None
    panels: tuple[tuple[str, str], ...] = ()
    said: str = ""


def map_cards(runs: Sequence[DensityRun]) -> list[tuple[Card, ...]]:
    """Cards of the maps, run by run, the panels of a run side by side."""
    return [
        tuple(
            Card(f"{run.record.sequence}, {run.record.method}: {title[:1].lower()}{title[1:]}", figure, run.said)
            for title, figure in run.panels
        )
        for run in runs
        if run.panels
    ]
