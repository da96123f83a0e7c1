"""How long `unet` takes: python -m tests.benchmarks.unet [THREADS].

Wall time of each part of a step of training, on crops of seg-mini, and of looking at a picture of it. Weights are
random: times do not depend on them, but for the division into oysters, of which there is none here.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch

from oysterbench.cli.labelled import open_all
from oysterbench.core.streams import Streams
from oysterbench_baselines.learning.batches import Mixture, make_batch
from oysterbench_baselines.learning.loop import channels_last
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.samples import LabelledDataset
from oysterbench_baselines.unet.model import UNetModel
from oysterbench_baselines.unet.network import build_network
from oysterbench_baselines.unet.training import pretrained_settings
from oysterbench_baselines.unet.views import VIEWS, closer_views, closer_zoom

TIMES = 5


def middle_ms(*parts: Callable[[], object]) -> list[float]:
    """Median wall time of each of parts that follow one another, after one round that is not counted."""
    took: list[list[float]] = [[] for _ in parts]
    for _ in range(TIMES + 1):
        for part, times in zip(parts, took, strict=True):
            began = time.perf_counter()
            part()
            times.append(1000 * (time.perf_counter() - began))
    return [statistics.median(times[1:]) for times in took]


def main(threads: str = "1") -> None:
    torch.set_num_threads(int(threads))
    settings, streams = pretrained_settings("lite0"), Streams(0)
    labelled = open_all(("seg-mini",))
    mixture = Mixture([LabelledDataset(labelled, side=settings.network.side).load()], [settings.batch])
    network = channels_last(build_network(settings.network)).train()
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.fit.learning_rate)
    batch = make_batch(mixture, settings.augmentation, streams, 0)
    loss = mask_loss(network, *batch)

    def forward() -> None:
        nonlocal loss
        optimiser.zero_grad(set_to_none=True)
        loss = mask_loss(network, *batch)

    step = middle_ms(
        lambda: make_batch(mixture, settings.augmentation, streams, 0), forward, lambda: loss.backward(), optimiser.step
    )
    print(f"a step of {settings.batch} crops of {settings.augmentation.crop} px, ms: ", end="")
    print("crops {:.0f}, forward {:.0f}, backward {:.0f}, weights {:.0f}".format(*step))
    model = UNetModel(network.eval(), 1.0, 32, torch.device("cpu"), settings.network.side, settings.network.outputs, 2)
    pixels = np.ascontiguousarray(labelled.entries[0].read().pixels)
    closer = closer_views(closer_zoom(*pixels.shape[:2]))[1]
    views = middle_ms(*(lambda view=view: model._seen(pixels, view) for view in (*VIEWS[:2], closer)))
    print(f"a picture of {pixels.shape[1]} x {pixels.shape[0]}, ms: ", end="")
    print("first view {:.0f}, second {:.0f}, a closer look {:.0f}".format(*views))


if __name__ == "__main__":
    main(*sys.argv[1:])
