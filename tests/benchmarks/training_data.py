"""How fast data sets give items: python -m tests.benchmarks.training_data [FRAMES_SPLIT [WINDOWS_SPLIT]].

Items per second of wall time, drawn at random, with no worker and with two, and the processor time of one item without.
"""

from __future__ import annotations

import sys
import time
from itertools import islice
from typing import Any

import torch
from torch.utils.data import DataLoader

import oysterbench

ITEMS = 150


def rate(data: Any, workers: int) -> tuple[float, float]:
    """Items per second, and processor time per item, s, of this process alone: of a second pass, with workers up."""
    options: dict[str, Any] = {"num_workers": workers, "persistent_workers": workers > 0}
    loader = DataLoader(data, batch_size=None, shuffle=True, generator=torch.Generator().manual_seed(0), **options)
    for _ in range(2):
        began, cpu = time.perf_counter(), time.process_time()
        count = sum(1 for _ in islice(loader, ITEMS))
    return count / (time.perf_counter() - began), (time.process_time() - cpu) / count


def main(frames: str = "seg-mini", windows: str = "slam-mini") -> None:
    torch.set_num_threads(1)
    for make in (
        lambda: oysterbench.torch.FrameDataset(frames),
        lambda: oysterbench.torch.FrameDataset(windows),
        lambda: oysterbench.torch.FrameDataset(windows, layers=()),
        lambda: oysterbench.torch.WindowDataset(windows, length=5),
    ):
        began = time.process_time()
        data = make()
        made_s = time.process_time() - began
        alone, cpu_s = rate(data, 0)
        two, _ = rate(data, 2)
        print(f"{data!r}: made in {made_s:.2f} s; {1000 * cpu_s:.1f} ms of processor time an item; ", end="")
        print(f"{alone:.0f} items/s alone, {two:.0f} with two workers")


if __name__ == "__main__":
    main(*sys.argv[1:])
