"""Timeline of sensor faults: a lane for each kind, in px of the SVG that `view.html` draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.report.viewer.strips import BOTTOM, LEFT, RIGHT, TOP, WIDTH, time_ticks
from oysterbench.sequence.types import Sequence

LANE = 26  # px from one lane to the next: a line of text with bars below it
TEXT = 12  # px from the top of a lane to the baseline of its text
BAR = 6  # px, height of a bar
SHORTEST = 1.5  # px, minimum length of a bar, so that a fault of one sample is visible


@dataclass(frozen=True)
class Lane:
    """One kind of fault of one sensor: the text above its bars, the y of its baseline, and the bars as an SVG path."""

    text: str
    y: float
    bars: str


@dataclass(frozen=True)
class FaultPlot:
    """Lanes below one another, over the same time span as the curves."""

    span_s: float
    lanes: list[Lane]
    times: list[tuple[float, float]]
    height: int
    bottom: int
    width: int = WIDTH
    left: int = LEFT
    right: int = WIDTH - RIGHT
    top: int = TOP


def fault_plot(sequence: Sequence, start_ns: int, end_ns: int) -> FaultPlot | None:
    """Plot the faults between two stamps; None if there were none, or none are known."""
    try:
        faults = sequence.faults()
    except SequenceError:
        return None
    span = (end_ns - start_ns) * 1e-9
    faults = faults[(faults["end_ns"] >= start_ns) & (faults["start_ns"] < end_ns)]
    lanes: list[Lane] = []
    for (sensor, fault), rows in faults.groupby(["sensor", "fault"], sort=True):
        top = TOP + LANE * len(lanes)
        begins, ends = (
            LEFT + (WIDTH - LEFT - RIGHT) * np.clip((rows[key].to_numpy() - start_ns) * 1e-9 / span, 0.0, 1.0)
            for key in ("start_ns", "end_ns")
        )
        y = top + LANE - BAR - 3
        bars = "".join(
            f"M{a:.1f} {y}h{max(b - a, SHORTEST):.1f}v{BAR}H{a:.1f}Z" for a, b in zip(begins, ends, strict=True)
        )
        worst = rows["value"].abs().max()
        lanes.append(Lane(f"{sensor} {fault}, {_times(len(rows))}, up to {worst:.3g}", top + TEXT, bars))
    if not lanes:
        return None
    bottom = TOP + LANE * len(lanes)
    return FaultPlot(span, lanes, time_ticks(span), bottom + BOTTOM, bottom)


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"
