"""Faults of sensors, for the ground truth: time spans, and what was wrong in them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

COLUMNS = ("start_ns", "end_ns", "sensor", "fault", "value")


@dataclass(frozen=True)
class Fault:
    """A fault from start_s to end_s, true times since the start; value: its largest size, in the unit that its name
    ends in, such as `outlier_m_s`."""

    start_s: float
    end_s: float
    name: str
    value: float


def spans(times_s: Array, struck: NDArray[np.bool_], name: str, sizes: Array) -> list[Fault]:
    """Return one fault per run of struck samples; times (N,) s, struck (N,), sizes (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], struck, [False]]).astype(np.int8)))
    runs = edges.reshape(-1, 2).tolist()
    return [
        Fault(float(times_s[a]), float(times_s[b - 1]), name, float(sizes[a:b][np.argmax(np.abs(sizes[a:b]))]))
        for a, b in runs
    ]


def fault_csv(faults: Iterable[tuple[str, Fault]], epoch_ns: int) -> bytes:
    """CSV with COLUMNS, in time order, of faults given as pairs of sensor name and fault."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    rows = [
        (epoch_ns + round(1e9 * fault.start_s), epoch_ns + round(1e9 * fault.end_s), sensor, fault.name, fault.value)
        for sensor, fault in faults
    ]
    for start, end, sensor, name, value in sorted(rows):
        writer.writerow([start, end, sensor, name, f"{value:.6g}"])
    return file.getvalue().encode()
