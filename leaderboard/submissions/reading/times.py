"""Checks of a path's timestamps against the time span of its sequence, which need no ground truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.diagnose import TIME_UNITS
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

SLACK_NS = 100_000_000
"""Tolerance before the start and after the end of a recording, for unsynchronised sensor clocks and rounding."""

UNIT_SLACK_NS = 1_000_000_000
"""The same, for recognising timestamps in another unit, such as whole seconds."""


def check_times(path: Trajectory, label: str, sequence: str, span: tuple[int, int]) -> None:
    """Refuse a path with no pose within the time span of its sequence; the refusal names the unit in which they would
    be, if there is one.

    label: name of the file; span: start and end of the recording, ns
    """
    if _inside(path, span).any():
        return
    begin, end = (int(stamp) for stamp in (path.stamps_ns.min(), path.stamps_ns.max()))
    seen = f"{_seconds(begin)} to {_seconds(end)} s"
    of_it = f"{sequence} is recorded from {_seconds(span[0])} to {_seconds(span[1])} s"
    unit = next((unit for factor, unit in TIME_UNITS.items() if _within(begin * factor, end * factor, span)), "")
    if unit:
        advice = f"its timestamps are in {unit}: write seconds (TUM, as 12.5) or whole nanoseconds (EuRoC)"
    elif begin >= 0 and _within(span[0] + begin, span[0] + end, span):
        advice = f"if they count from the start of the sequence, add {_seconds(span[0])} s"
    else:
        advice = "keep the timestamps of the messages of that sequence"
    raise Refusal("format", f"{label}: no pose is at a time of its sequence: they are at {seen}, {of_it}; {advice}")


def outside_notes(path: Trajectory, sequence: str, span: tuple[int, int] | None) -> list[str]:
    """Note on poses before the start or after the end of the recording, which are not scored; empty without any."""
    outside = 0 if span is None else int(np.count_nonzero(~_inside(path, span)))
    if not outside:
        return []
    return [f"{sequence}: {outside} of {len(path)} poses are before its begin or after its end, and are not scored"]


def _inside(path: Trajectory, span: tuple[int, int]) -> NDArray[np.bool_]:
    return np.asarray((path.stamps_ns >= span[0] - SLACK_NS) & (path.stamps_ns <= span[1] + SLACK_NS))


def _within(begin: float, end: float, span: tuple[int, int]) -> bool:
    return begin >= span[0] - UNIT_SLACK_NS and end <= span[1] + UNIT_SLACK_NS


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns * 1e-9:.3f}"
