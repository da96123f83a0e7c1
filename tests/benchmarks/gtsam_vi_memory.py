"""How much memory gtsam_vi takes over minutes: `python -m tests.benchmarks.gtsam_vi_memory [--seconds S] [--rate HZ]`.

Laps over a flat bottom, 640x480, every place seen again every 28 s, with loops and the final smoothing. Resident memory
(MB) after the imports, every half a minute of the dive, at its end, and at most while it is smoothed; seconds of the
processor beside it. Ten minutes at 5 Hz take some three minutes of one core, at 20 Hz some ten. Linux only.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import threading
import time
from collections.abc import Iterator
from typing import Any

import cv2

from oysterbench.core.measurements import Image
from oysterbench_baselines.gtsam_vi import GtsamVi
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from tests.baselines.test_gtsam_vi import FlatBottom, position_error
from tests.baselines.test_gtsam_vi_long import resident_mb

STEP_S = 30.0


class Peak:
    """The most resident memory (MB) since it was started, looked at fifty times a second."""

    def __init__(self) -> None:
        self.mb = resident_mb()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            self.mb = max(self.mb, resident_mb())
            time.sleep(0.02)


class Laps(FlatBottom):
    """A flat bottom at a rate (Hz); what it measures goes into `rows` as the pictures are handed out."""

    def __init__(self, seconds: float, rate: float) -> None:
        super().__init__(seconds)
        self.cameras = {"cam": dataclasses.replace(self.cameras["cam"], rate_hz=rate)}
        self.rows: list[tuple[float, float, float]] = []  # s of the dive, MB, s of the processor

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        rate = self.cameras[camera].rate_hz
        for n, image in enumerate(super().images(camera, start_ns, end_ns)):
            if n % int(STEP_S * rate) == 0:
                self.rows.append((n / rate, resident_mb(), time.process_time()))
                print("{:6.0f} s {:6.0f} MB {:6.0f} s of the processor".format(*self.rows[-1]), flush=True)
            yield image


def measure(seconds: float, rate: float) -> dict[str, Any]:
    """Memory (MB), processor time (s) and errors (m) of such a dive."""
    cv2.setNumThreads(1)
    found: dict[str, Any] = {"imports_mb": resident_mb()}
    laps, finish = Laps(seconds, rate), Estimator.finish
    peaks: list[Peak] = []

    def finishing(estimator: Estimator) -> None:
        found["tracked_mb"], found["tracked_s"] = resident_mb(), time.process_time()
        finish(estimator)
        found["rested_mb"] = resident_mb()
        peaks.append(Peak())

    Estimator.finish = finishing  # type: ignore[method-assign, assignment]
    estimate = GtsamVi().run(laps.for_method())
    found["peak_of_smoothing_mb"], found["in_all_s"] = peaks[0].mb, time.process_time()
    found |= {name: estimate.info[name] for name in ("keyframes", "places", "loops")}
    truth = laps.truth()
    found["smoothed_m"] = position_error(truth, estimate.trajectory)
    found["online_m"] = position_error(truth, estimate.alternatives["online"])
    late = laps.rows[len(laps.rows) // 3 :]
    minutes = (late[-1][0] - late[0][0]) / 60
    found["mb_per_minute"] = (late[-1][1] - late[0][1]) / minutes if minutes else float("nan")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--rate", type=float, default=5.0, help="pictures a second")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = measure(asked.seconds, asked.rate)
    if asked.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:24s} {value:.4g}")


if __name__ == "__main__":
    main()
