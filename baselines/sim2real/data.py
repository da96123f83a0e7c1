"""The real images: sides that share nothing, and a few of many that a person might have labelled first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from oysterbench.annotations import Duplicate, LabelledSet, near_duplicates
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import stream
from oysterbench_baselines.sim2real.settings import ALL


@dataclass(frozen=True)
class Real:
    """train, test: apart; leaks: training images that nearly are test images, which were taken out of `train`."""

    train: LabelledSet
    test: LabelledSet
    leaks: tuple[Duplicate, ...]


def real_data(
    labelled: LabelledSet,
    hold_out: tuple[str, ...],
    min_correlation: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Real:
    """The sides of a set of real images, as its manifest has them.

    hold_out: clips of the training side that are tested on in place of the test side, which is then not looked at: to
    choose settings by. Training images that correlate with a test image by `min_correlation` are left out.
    """
    train, test = labelled.of_split("train"), labelled.of_split("test")
    for clip in hold_out:
        if clip not in train.clips:
            raise LabelError(f"--hold-out {clip}: expected a clip of the training side: {', '.join(train.clips)}")
    if hold_out:
        test = train.where(lambda entry: entry.clip in hold_out, f"{labelled.name} held out")
        train = train.where(lambda entry: entry.clip not in hold_out)
    leaks = near_duplicates(train, test, min_correlation, lambda done: progress(done, len(train)))
    leaking = {leak.one for leak in leaks}
    kept = train.where(lambda entry: entry.name not in leaking)
    if not len(kept):
        raise LabelError(f"{labelled.name}: every training image nearly is a test image; is it split by clip?")
    return Real(kept, test, tuple(leaks))


def drawn(train: LabelledSet, size: int, seed: int) -> LabelledSet:
    """So many images of a set; those of a smaller size are among those of a larger one.

    Clip by clip in turn, each time one at random: who labels few images takes them from everything there is.
    """
    if size == ALL or size == len(train):
        return train
    if size > len(train):
        raise LabelError(f"{train.name}: {size} real images are asked for, but there are {len(train)} to train on")
    rng = stream(seed, b"", "sim2real", "selection")
    piles = {clip: [entry.name for entry in train.entries if entry.clip == clip] for clip in train.clips}
    order = [list(piles)[k] for k in rng.permutation(len(piles))]
    for clip in order:
        piles[clip] = [piles[clip][k] for k in rng.permutation(len(piles[clip]))]
    chosen: set[str] = set()
    while len(chosen) < size:
        for clip in order:
            if piles[clip] and len(chosen) < size:
                chosen.add(piles[clip].pop())
    return train.where(lambda entry: entry.name in chosen)
