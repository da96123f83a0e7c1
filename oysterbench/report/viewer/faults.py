"""When faults of the sensors struck: a lane for each kind, in px of the SVG that `view.html` makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.report.viewer.strips import BOTTOM, LEFT, RIGHT, TOP, WIDTH, time_ticks
from oysterbench.sequence.types import Sequence

LANE = 26  # px from one lane to the next: a line of text, and bars under it
TEXT = 12  # px from the top of a lane to the line that its text stands on
BAR = 6  # px
SHORTEST = 1.5  # px of a bar, so that what lasts one sample is seen


@dataclass(frozen=True)
class Lane:
    """One kind of fault of one sensor: what is written over its bars, the height of that line, and the bars as a path
    of SVG."""

    text: str
    y: float
    bars: str


@dataclass(frozen=True)
class FaultPlot:
    """Lanes one under the other, over the same span of time as the curves."""

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
    """The faults from one stamp to another; None where none struck, or none are known."""
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
