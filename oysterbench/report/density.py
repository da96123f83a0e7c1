"""What the density track shows besides the tables of every track: a map of each run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from oysterbench.results.records import ResultRecord

SHOWN_MAPS = 12  # each is some 100 KB


@dataclass(frozen=True)
class DensityRun:
    """A map, scored: its record, and what was made (`density.OysterMap`), None where it failed; figure: as SVG."""

    record: ResultRecord
    result: Any = None
    figure: str = ""


def maps_section(runs: Sequence[DensityRun]) -> str:
    """The maps, sequence by sequence."""
    drawn = [run for run in runs if run.figure]
    if not drawn:
        return ""
    parts = ["<h2>Maps</h2>"]
    for run in drawn[:SHOWN_MAPS]:
        title = f"{run.record.sequence}, {run.record.method}"
        parts.append(f'<div class="card"><h3>{escape(title)}</h3>{run.figure}</div>')
    if len(drawn) > SHOWN_MAPS:
        parts.append(f'<p class="small">Shown are {SHOWN_MAPS} of {len(drawn)} maps.</p>')
    return "".join(parts)
