"""The real images: training and test sides that share nothing, and selections of few, as a person might label them
first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile

from oysterbench.annotations import Duplicate, LabelledSet, near_duplicates
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import stream
from oysterbench_baselines.sim2real.settings import ALL


@dataclass(frozen=True)
class Real:
    """Real images. train, test: disjoint sets; leaks: training images that nearly duplicate test images, which were
    removed from `train`."""

    train: LabelledSet
    test: LabelledSet
    leaks: tuple[Duplicate, ...]


def real_data(
    labelled: LabelledSet,
    hold_out: tuple[str, ...],
    min_correlation: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Real:
    """Split a set of real images into training and test sides according to its manifest.

    hold_out: clips of the training side to test on in place of the test side, which is then not looked at, for choosing
    settings. Training images whose correlation with a test image reaches `min_correlation` are left out. Raises
    LabelError where a clip is not of the training side, or no training image is left.
    """
    train, test = labelled.of_split("train"), labelled.of_split("test")
    for clip in hold_out:
        if clip not in train.clips:
            raise LabelError(f"--hold-out {clip}: expected a clip of the training side: {', '.join(train.clips)}")
    if hold_out:
        test = train.where(lambda entry: entry.clip in hold_out, f"{labelled.name} held out")
        train = train.where(lambda entry: entry.clip not in hold_out)
    return _apart(labelled.name, train, test, min_correlation, progress)


def sites_of(
    labelled: LabelledSet, min_correlation: float, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, tuple[str, ...]]:
    """Group clips by the place they show; a place is named by the common prefix of its clips' names. Clips show one
    place if an image of each correlate by at least `min_correlation`, or if other clips link them."""
    clips = labelled.clips
    site = {clip: {clip} for clip in clips}
    for k, clip in enumerate(clips):
        progress(k, len(clips))
        own = labelled.where(lambda entry, clip=clip: entry.clip == clip)  # type: ignore[misc]
        for other in clips[k + 1 :]:
            theirs = labelled.where(lambda entry, other=other: entry.clip == other)  # type: ignore[misc]
            if site[clip] is not site[other] and near_duplicates(own, theirs, min_correlation):
                site[clip] |= site[other]
                for member in site[other]:
                    site[member] = site[clip]
    progress(len(clips), len(clips))
    places = {id(members): tuple(one for one in clips if one in members) for members in site.values()}
    names = [_common(members) for members in places.values()]
    return {
        name if names.count(name) == 1 else "+".join(members): members
        for name, members in zip(names, places.values(), strict=True)
    }


def _common(names: tuple[str, ...]) -> str:
    """Common prefix of names, without a trailing separator: of one name all of it; without a common prefix the first
    name."""
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in alike).rstrip("-_ ") or names[0]


def site_data(
    labelled: LabelledSet,
    clips: tuple[str, ...],
    min_correlation: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Real:
    """Split a set into one site to test on and all others to train on, whatever sides the manifest gives. Raises
    LabelError for a clip that does not exist."""
    for clip in clips:
        if clip not in labelled.clips:
            raise LabelError(f"{labelled.name}: expected clips of {', '.join(labelled.clips)}, got {clip!r}")
    test = labelled.where(lambda entry: entry.clip in clips)
    train = labelled.where(lambda entry: entry.clip not in clips)
    return _apart(labelled.name, train, test, min_correlation, progress)


def _apart(
    name: str,
    train: LabelledSet,
    test: LabelledSet,
    min_correlation: float,
    progress: Callable[[int, int], None],
) -> Real:
    leaks = near_duplicates(train, test, min_correlation, lambda done: progress(done, len(train)))
    leaking = {leak.one for leak in leaks}
    kept = train.where(lambda entry: entry.name not in leaking)
    if not len(kept):
        raise LabelError(f"{name}: every training image nearly is a test image; is it split by clip?")
    return Real(kept, test, tuple(leaks))


def drawn(train: LabelledSet, size: int, seed: int) -> LabelledSet:
    """Draw `size` images of a set; a smaller selection is part of a larger one. Raises LabelError where it has fewer.

    One at random from each clip in turn: whoever labels only a few images takes them from everything there is.
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
