"""What the density track shows besides the tables of every track: a map of each run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from oysterbench.report.cards import Card
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class DensityRun:
    """A map, scored: its record, and what was made (`density.OysterMap`), None where it failed; figure: as SVG."""

    record: ResultRecord
    result: Any = None
    figure: str = ""


def map_cards(runs: Sequence[DensityRun]) -> list[Card]:
    """The maps, sequence by sequence."""
    return [Card(f"{run.record.sequence}, {run.record.method}", run.figure) for run in runs if run.figure]
