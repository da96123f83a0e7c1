"""Checks of what a method is given: mistakes of units and clocks that no filter could tell from motion."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.measurements import Image
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.common.inertial import MOST_RATE

CHECKED = 2000
"""Inertial samples that are checked, the first ones of a sequence: ten seconds at 200 Hz."""
RATE_RATIO = 100.0
"""Stated rate to measured one, either way, beyond which stamps are taken to be in another unit."""
UNITS = {"g": 9.80665, "milli-g": 9806.65e-6}
"""Units of specific force that are met instead of m/s^2, in m/s^2."""


def check_inertial(method: str, sequence: Sequence) -> None:
    """Refuse inertial samples that no vehicle can have measured. Raises MethodError."""
    samples = list(islice(sequence.imu(), CHECKED))
    if len(samples) < 2:
        raise MethodError(f"{method}: expected inertial samples in sequence {sequence.name}, got {len(samples)}")
    gravity, rate_hz = sequence.imu_calibration.gravity, sequence.imu_calibration.rate_hz
    steps_ns = np.diff([sample.stamp_ns for sample in samples])
    # Gaps spoil the mean; samples that come in bursts, stamped on arrival, spoil the median.
    rates_hz = [1e9 / max(float(step_ns), 1.0) for step_ns in (np.median(steps_ns), steps_ns.mean())]
    measured_hz = min(rates_hz, key=lambda found_hz: abs(np.log(found_hz / rate_hz)))
    if not 1 / RATE_RATIO < measured_hz / rate_hz < RATE_RATIO:
        raise MethodError(
            f"{method}: {sequence.name}: expected stamps of inertial samples in ns, {rate_hz:g} Hz by the calibration, "
            f"got {measured_hz:g} Hz; are they in another unit?"
        )
    forces, rates = (np.array([getattr(sample, name) for sample in samples]) for name in ("accel", "gyro"))
    force = float(np.median(np.linalg.norm(forces, axis=1)))
    if not 0.5 * gravity < force < 2.0 * gravity:
        unit = next((f"are they in {unit}?" for unit, size in UNITS.items() if 0.8 < force * size / gravity < 1.25), "")
        raise MethodError(
            f"{method}: {sequence.name}: expected specific forces in m/s^2, of {gravity:.3g} mostly, got a median of "
            f"{force:.3g}; {unit or 'are the columns of the inertial samples in order (rate, then force)?'}"
        )
    rate = float(np.quantile(np.linalg.norm(rates, axis=1), 0.9))
    if rate > 0.5 * MOST_RATE:
        raise MethodError(
            f"{method}: {sequence.name}: expected angular rates in rad/s, got {rate:.3g} or more in a tenth; "
            "are they in deg/s?"
        )


def on_imu_clock(stream: Iterator[Any], cameras: Mapping[str, CameraCalibration]) -> Iterator[Any]:
    """Yield a stream with images stamped by when they were taken, as far as the calibrations know, in time order."""
    late_ns = {name: round(1e9 * camera.time_offset_s) for name, camera in cameras.items()}
    if not any(late_ns.values()):
        yield from stream
        return
    waiting: list[tuple[int, bool, int, Any]] = []
    most = max(*late_ns.values(), 0)
    for n, item in enumerate(stream):
        while waiting and waiting[0][0] < item.stamp_ns - most:
            yield heapq.heappop(waiting)[-1]
        if isinstance(item, Image):
            item = replace(item, stamp_ns=item.stamp_ns - late_ns.get(item.camera, 0))
        # At equal stamps, inertial samples come before images.
        heapq.heappush(waiting, (item.stamp_ns, isinstance(item, Image), n, item))
    while waiting:
        yield heapq.heappop(waiting)[-1]
