"""North on a map, from the magnetometer: the initial heading of a path may be a guess."""

from __future__ import annotations

import numpy as np

from oysterbench.mapping.views import PoseInterpolator
from oysterbench.sequence.types import Sequence

LARGEST_SPREAD_RAD = np.radians(20.0)
"""1 sigma of the field directions of single readings, above which they give no north: unknown iron turns with the
vehicle, and a path with wrong headings has the same effect."""
LEAST_TURN_RAD = np.radians(40.0)
"""1 sigma of the headings, below which unknown iron would not show in that spread."""


def magnetic_north(sequence: Sequence, poses: PoseInterpolator) -> float | None:
    """Mean direction of the measured magnetic field in a path's world frame, rad clockwise from +y seen from above.

    None without a magnetometer, or if it cannot be relied on: its readings do not agree, or the iron on board is
    unknown and the vehicle turned too little to reveal it.
    """
    known = sequence.magnetometer_calibration
    if known is None:
        return None
    hard = np.zeros(3) if known.hard_iron_t is None else known.hard_iron_t
    soft = np.eye(3) if known.soft_iron is None else known.soft_iron
    fields, headings = [], []
    for reading in sequence.magnetometer():
        T = poses.at(reading.stamp_ns)
        if T is not None:
            field = T[:3, :3] @ known.T_base_sensor[:3, :3] @ np.linalg.solve(soft, reading.field - hard)
            fields.append(complex(field[0], field[1]))
            headings.append(complex(T[0, 0], T[1, 0]))
    if not fields or _spread(fields) > LARGEST_SPREAD_RAD:
        return None
    if known.hard_iron_t is None and _spread(headings) < LEAST_TURN_RAD:
        return None
    return float(np.pi / 2 - np.angle(_mean(fields)))


def _mean(directions: list[complex]) -> complex:
    return complex(np.mean(np.array(directions) / np.abs(directions)))


def _spread(directions: list[complex]) -> float:
    """Circular standard deviation, rad: directions with standard deviation s have a mean of length exp(-s^2 / 2)
    (Mardia & Jupp 2000, sec. 3.4)."""
    return float(np.sqrt(-2.0 * np.log(np.clip(abs(_mean(directions)), 1e-12, 1.0))))
