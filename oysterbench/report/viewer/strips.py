"""Strip charts of the scalar sensors over time, in px of the SVG that `view.html` draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.sensors.kind import XYZ, Strip
from oysterbench.sequence.truth import TRUTH
from oysterbench.sequence.types import Sequence, imu_arrays

WIDTH, HEIGHT = 1080, 120
LEFT, RIGHT, TOP, BOTTOM = 64, 8, 8, 20
COLUMNS = 500
"""Columns that the samples of a curve are grouped into: each keeps its minimum and maximum, so that no peak is lost."""

IMU = "/imu"


@dataclass(frozen=True)
class StripPlot:
    """Curves as SVG paths; ticks: values and their y, px; times: seconds and their x, px."""

    title: str
    span_s: float
    curves: list[str]
    ticks: list[tuple[float, float]]
    times: list[tuple[float, float]]
    width: int = WIDTH
    height: int = HEIGHT
    left: int = LEFT
    right: int = WIDTH - RIGHT
    top: int = TOP
    bottom: int = HEIGHT - BOTTOM


def _wanted(sequence: Sequence) -> list[Strip]:
    counts = {topic: count for topic, _, count in sequence.contents()}
    ranked = sorted(sequence.sensors().items(), key=lambda item: item[1].rank)
    wanted = [strip for name, kind in ranked for strip in kind.strips(name)]
    return [strip for strip in wanted if strip.topic == IMU or counts.get(strip.topic)]


def strips(sequence: Sequence, start_ns: int, end_ns: int) -> list[StripPlot]:
    """Plot each strip, over the same time span."""
    return [_plot(strip, table, start_ns, end_ns) for strip, table in strip_tables(sequence)]


def strip_tables(sequence: Sequence) -> list[tuple[Strip, pd.DataFrame]]:
    """Strips to plot for the scalar sensors, each with the table, indexed by stamp_ns, that holds its columns."""
    inertial = _inertial_table(sequence)
    tables = [(strip, inertial if strip.topic == IMU else sequence.frame(strip.topic)) for strip in _wanted(sequence)]
    return [*_speed(sequence), *tables, *_taken(sequence)]


def _speed(sequence: Sequence) -> list[tuple[Strip, pd.DataFrame]]:
    """True speed of base_link; empty if the sequence has no ground-truth topic."""
    if TRUTH not in (topic for topic, _, _ in sequence.contents()):
        return []
    table = sequence.frame(TRUTH)
    speed = np.linalg.norm(table[[f"velocity_{axis}" for axis in XYZ]].to_numpy(), axis=1)
    return [(Strip(TRUTH, "true speed, m/s", ("speed",)), pd.DataFrame({"speed": speed}, index=table.index))]


def _taken(sequence: Sequence) -> list[tuple[Strip, pd.DataFrame]]:
    """Exposure time and gain of cameras with automatic exposure; empty if they are not known."""
    try:
        taken = sequence.taken()
    except SequenceError:
        return []
    found = []
    for camera, rows in taken.groupby("camera", sort=False):
        for column, title in (("exposure_ms", "exposure, ms"), ("gain", "gain")):
            if column in rows and rows[column].notna().any():
                found.append((Strip("", f"{camera} {title}", (column,)), rows.set_index("stamp_ns")))
    return found


def _inertial_table(sequence: Sequence) -> pd.DataFrame:
    """IMU samples as in the table of `Sequence.frame`, also for layouts that provide no tables."""
    stamps, gyro, accel = imu_arrays(sequence.imu())
    columns = [f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in XYZ]
    return pd.DataFrame(np.hstack([gyro, accel]), index=stamps, columns=columns)


def _plot(strip: Strip, table: pd.DataFrame, start_ns: int, end_ns: int) -> StripPlot:
    lacking = [column for column in strip.columns if column not in table]
    if lacking:
        raise SequenceError(f"{strip.topic}: its messages have no {', '.join(lacking)}; are they of another type?")
    table = table[(table.index >= start_ns) & (table.index <= end_ns)]
    seconds = (table.index.to_numpy() - start_ns) * 1e-9
    span = (end_ns - start_ns) * 1e-9
    values = table[list(strip.columns)].to_numpy(dtype=float) * strip.factor
    values[~np.isfinite(values)] = np.nan
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    margin = 0.06 * (high - low) or 0.5
    low, high = low - margin, high + margin
    across = WIDTH - LEFT - RIGHT
    x = LEFT + seconds / span * across
    y = TOP + (high - values) / (high - low) * (HEIGHT - TOP - BOTTOM)
    return StripPlot(
        title=strip.title,
        span_s=span,
        curves=[_curve(x, y[:, k], known_at=np.isfinite(values[:, k])) for k in range(len(strip.columns))],
        ticks=_ticks(low, high),
        times=time_ticks(span),
    )


def time_ticks(span_s: float) -> list[tuple[float, float]]:
    """Round numbers of seconds and their x, px."""
    across = WIDTH - LEFT - RIGHT
    return [(value, LEFT + value / span_s * across) for value in round_values(0.0, span_s * 0.995, 8)]


def _curve(x: Array, y: Array, known_at: NDArray[np.bool_]) -> str:
    """SVG path through the minimum and maximum of each column of the plot; broken where nothing is known."""
    column = np.minimum(((x - LEFT) / (WIDTH - LEFT - RIGHT) * COLUMNS).astype(int), COLUMNS - 1)
    parts, pen = [], "M"
    for group in np.split(np.arange(len(x)), np.flatnonzero(np.diff(column)) + 1):
        inside = group[known_at[group]]
        if len(inside) == 0:
            pen = "M"
            continue
        ends = {int(inside[np.argmin(y[inside])]), int(inside[np.argmax(y[inside])])}
        for k in sorted(ends):
            parts.append(f"{pen}{x[k]:.1f} {y[k]:.1f}")
            pen = "L"
    return "".join(parts)


def _ticks(low: float, high: float) -> list[tuple[float, float]]:
    """Round values between two bounds, and their y, px."""
    values = round_values(low, high, 4)
    return [(value, TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM)) for value in values]


def round_values(low: float, high: float, n: int) -> list[float]:
    """About n values within two bounds that are multiples of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / n
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999)
    return [float(round(k * step, 12)) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]
