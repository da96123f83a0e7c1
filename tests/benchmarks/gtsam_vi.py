"""Where gtsam_vi spends its time: `python tests/benchmarks/gtsam_vi.py SEQUENCE [--stereo] [--seconds S]`.

Seconds of the processor by stage, reading and decoding of the file included, per frame and in all; the real-time
factor; and how the memory grows once the estimator runs. SEQUENCE: an MCAP file or a folder in EuRoC layout. Run it
with OMP_NUM_THREADS=1 to hold it to one core, which is what the real-time factor is about.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import cv2

import oysterbench
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.gtsam_vi import GtsamVi, estimator, frontend
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd
from oysterbench_baselines.gtsam_vi.loops import LoopCloser
from oysterbench_baselines.gtsam_vi.pictures import FixedPattern
from oysterbench_baselines.gtsam_vi.stereo import StereoMatcher
from oysterbench_baselines.gtsam_vi.window import Window

STAGES: tuple[tuple[Any, str, str], ...] = (
    (frontend, "without_veil", "equalise"),
    (frontend, "even_contrast", "equalise"),
    (FixedPattern, "add", "equalise"),
    (FrontEnd, "_follow", "track"),
    (FrontEnd, "_replenish", "find corners"),
    (StereoMatcher, "match", "match left to right"),
    (Estimator, "_initialise", "initialise"),
    (Estimator, "propagate", "propagate state and covariance"),
    (Window, "add", "smooth the window"),
    (estimator, "correct_filter", "covariance of the window"),
    (LoopCloser, "add_keyframe", "places and loops"),
    (Estimator, "smoothed", "final smoothing"),
)
"""Methods and functions that are stages, by the class or module that calls them so."""
REST = "the rest"
LAST = "final smoothing"


class Clock:
    """Processor seconds by stage; what one stage calls of another counts for the other."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {REST: 0.0}
        self._stack, self._last = [REST], time.process_time()

    def enter(self, stage: str) -> None:
        self._lap()
        self._stack.append(stage)

    def leave(self) -> None:
        self._lap()
        self._stack.pop()

    def _lap(self) -> None:
        now = time.process_time()
        self.seconds[self._stack[-1]] = self.seconds.get(self._stack[-1], 0.0) + now - self._last
        self._last = now

    def timed(self, function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def call(*arguments: Any, **keywords: Any) -> Any:
            self.enter(stage)
            try:
                return function(*arguments, **keywords)
            finally:
                self.leave()

        return call


class Timed:
    """A sequence whose reading is timed, and at most `seconds` of it."""

    def __init__(self, sequence: Sequence, clock: Clock, seconds: float) -> None:
        self._sequence, self._clock, self._seconds = sequence, clock, seconds
        self.memory: list[tuple[float, float]] = []  # s, MB

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sequence, name)

    def stream(self, *sensors: str) -> Iterator[Any]:
        items = self._sequence.stream(*sensors)
        first = None
        read = self._clock.timed(lambda: next(items, None), "read and decode")
        while (item := read()) is not None:
            first = item.stamp_ns if first is None else first
            time_s = (item.stamp_ns - first) * 1e-9
            if time_s > self._seconds:
                return
            if not self.memory or time_s - self.memory[-1][0] > 1.0:
                self.memory.append((time_s, resident_mb()))
            yield item


def resident_mb() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def profile(path: str, stereo: bool, seconds: float) -> dict[str, Any]:
    """Seconds by stage, frames, and MB that each minute adds, from a third of the sequence on."""
    cv2.setNumThreads(1)
    clock = Clock()
    for kind, name, stage in STAGES:
        setattr(kind, name, clock.timed(getattr(kind, name), stage))
    sequence = Timed(oysterbench.open(path).for_method(), clock, seconds)
    estimate = GtsamVi(stereo=stereo).run(sequence)  # type: ignore[arg-type]
    clock.enter(REST)
    stamps = estimate.trajectory.stamps_ns
    later = sequence.memory[len(sequence.memory) // 3 :]
    minutes = (later[-1][0] - later[0][0]) / 60
    return {
        "sequence": path,
        "duration_s": float(stamps[-1] - stamps[0]) * 1e-9,
        "frames": len(stamps),
        "seconds": clock.seconds,
        "mb_per_minute": (later[-1][1] - later[0][1]) / minutes if minutes else float("nan"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence")
    parser.add_argument("--stereo", action="store_true")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = profile(asked.sequence, asked.stereo, asked.seconds)
    if asked.json:
        print(json.dumps(found))
        return
    seconds, frames = found["seconds"], found["frames"]
    for stage, spent in sorted(seconds.items(), key=lambda row: -row[1]):
        print(f"{stage:28s} {spent:8.2f} s   {1e3 * spent / frames:6.2f} ms a frame")
    total = sum(seconds.values())
    online = total - seconds.get(LAST, 0.0)
    print(f"{'in all':28s} {total:8.2f} s   {1e3 * total / frames:6.2f} ms a frame")
    print(
        f"real-time factor {found['duration_s'] / online:.2f} online, {found['duration_s'] / total:.2f} with the rest"
    )
    print(f"memory grows by {found['mb_per_minute']:.0f} MB a minute")


if __name__ == "__main__":
    main()
