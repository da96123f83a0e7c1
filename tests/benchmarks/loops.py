"""The loops that a method closes, held against the ground truth.

`python -m tests.benchmarks.loops SEQUENCE... [--method NAME]`

Of each sequence: how many loops, by how much their relative poses are off (median, greatest), and how many by more than
`WRONG_M` or `WRONG_DEG`. A wrong loop joins places that are not the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import oysterbench
from oysterbench.core.geometry import Array, invert
from oysterbench.methods.finding import find_variant
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.gtsam_vi.loops import LoopCloser
from oysterbench_baselines.gtsam_vi.places import heading_of, level_pose

WRONG_M, WRONG_DEG = 0.3, 3.0


@contextmanager
def watched() -> Iterator[tuple[list[LoopCloser], dict[int, int]]]:
    """The loop closers of the runs inside, and the stamps of their key frames in ns, by number."""
    closers: list[LoopCloser] = []
    stamps: dict[int, int] = {}
    add = LoopCloser.add_keyframe

    def seen(closer: LoopCloser, keyframes: Any, picture: Any) -> None:
        if not any(one is closer for one in closers):
            closers.append(closer)
        stamps[keyframes[-1].index] = keyframes[-1].stamp_ns
        add(closer, keyframes, picture)

    with patch.object(LoopCloser, "add_keyframe", seen):
        yield closers, stamps


def errors(closers: list[LoopCloser], stamps: dict[int, int], sequence: Sequence) -> Array:
    """(L, 2) of each loop: m, and degrees of heading, by which its relative pose is off."""
    truth = sequence.truth()
    found = []
    for closer in closers:
        for loop in closer.loops:
            ends = [stamps[closer.places[n].keyframe] for n in (loop.first, loop.second)]
            known = truth.at(np.clip(ends, truth.stamps_ns[0], truth.stamps_ns[-1]))
            first, second = map(level_pose, known.matrices @ sequence.imu_calibration.T_base_imu)
            off = invert(invert(first) @ second) @ loop.T_first_second
            found.append((np.linalg.norm(off[:3, 3]), abs(np.degrees(heading_of(off)))))
    return np.array(found, dtype=float).reshape(-1, 2)


def told(off: Array) -> str:
    """Of errors (L, 2), in words."""
    wrong = int(((off[:, 0] > WRONG_M) | (off[:, 1] > WRONG_DEG)).sum())
    if not len(off):
        return "no loops"
    median_m, greatest_m, greatest_deg = np.median(off[:, 0]), off[:, 0].max(), off[:, 1].max()
    return (
        f"loops: {len(off)}, off by {median_m:.4f} m (median), {greatest_m:.4f} m and {greatest_deg:.2f} deg at most; "
        f"wrong: {wrong}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", nargs="+")
    parser.add_argument("--method", default="gtsam_vi")
    given = parser.parse_args()
    for path in given.sequence:
        method, _ = find_variant(given.method)
        with oysterbench.open(path) as sequence:
            with watched() as (closers, stamps):
                method.run(sequence.for_method())
            print(f"{Path(path).name}: {given.method}: {told(errors(closers, stamps, sequence))}", flush=True)


if __name__ == "__main__":
    main()
