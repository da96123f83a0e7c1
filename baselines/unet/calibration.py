"""Calibration of a trained network's outputs, measured on images that it was not trained on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import LabelledImage, LabelledSet, ends_of, runs_of
from oysterbench_baselines.learning.masks import probability
from oysterbench_baselines.learning.samples import Floats
from oysterbench_baselines.unet.instances import LARGEST, Division, Instances, find_instances, means
from oysterbench_baselines.unet.views import Look

T = TypeVar("T")

SHARE = 10
"""Of each clip the last 1 / SHARE of each camera's images are held out; of clips with fewer images, one clip in SHARE.
Images without a clip are one together, or one for each folder in their names."""
MOST, SOME = 240, 80
"""Maximum number of images to measure on, evenly spaced; and how many of these are used to compare divisions. The score
above which oysters are counted needs many: with 80 images of rendered reefs the count is off by 5 % (1 sigma)."""
LEAST = 5
"""Number of images with oysters from which thresholds that were measured before are replaced. As the error of the count
falls with the root of the number, it is 20 % with 5 images, and 45 % with one."""
TEMPERATURES = np.geomspace(0.4, 4.0, 37)
CUTS = np.linspace(-3.0, 3.0, 61)
"""Candidate logit thresholds of the mask."""
LEAST_TELLING = 0.65
"""Balanced accuracy of live against dead, 0.5 for guessing, below which no state is reported."""
RISES = (0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15)
"""Candidate values of `instances.Division.rise`, of which the best is chosen."""
SAME = 0.5
"""IoU above which a detected oyster counts as a true one."""
PIXELS = 4000
"""Number of evenly spaced pixels per image from which temperature and cut are determined."""


@dataclass(frozen=True)
class Calibration:
    """Calibration of a network. temperature: divisor of the logits that minimises the cross-entropy (Guo et al. 2017);
    cut: the logit threshold that maximises IoU over all pixels, which becomes a probability of 0.5; rise: the value
    that gives the most correct oysters among as many detections as there are true ones; sure: the score above which
    that many oysters are counted (both: `instances.Division`). live_cut: the logit that best separates live oysters
    from dead ones; states: balanced accuracy of that, 0 where it was not measured. images: number of images on which
    all this was measured, 0 for default values."""

    temperature: float = 1.0
    cut: float = 0.0
    rise: float = Division.rise
    sure: float = 0.5
    live_cut: float = 0.0
    states: float = 0.0
    images: int = 0

    @property
    def tells(self) -> bool:
        """Whether live oysters are told from dead ones well enough to report it."""
        return self.states >= LEAST_TELLING

    def applied(self, logits: Floats) -> Floats:
        """Calibrate logits of oyster, so that 0 is the cut."""
        return np.asarray((logits - np.float32(self.cut)) / np.float32(self.temperature), dtype=np.float32)

    @property
    def division(self) -> Division:
        """Division of the mask into oysters with the calibrated parameters."""
        return Division(rise=self.rise, sure=self.sure)


def kept_back(labelled: LabelledSet) -> tuple[LabelledSet, LabelledSet]:
    """Split a set into the images to train on and those to measure on; the latter are none where there are too few.
    Images that several cameras took at the same instant fall on the same side, and of images whose clips are not known
    those that follow each other by name, as frames of a video."""
    kept: set[str] = set()
    short = 0
    for run in runs_of(labelled.entries):
        ends = ends_of(run.entries, 1 / SHARE)
        if not ends:
            short += 1
            ends = list(run.entries) if short % SHARE == 0 else []
        kept |= {entry.name for entry in ends}
    return labelled.where(lambda entry: entry.name not in kept), labelled.where(lambda entry: entry.name in kept)


def names_digest(labelled: LabelledSet) -> str:
    """SHA-256 of the names of a set's images: which images were held out."""
    names = "\n".join(entry.name for entry in labelled.entries)
    return hashlib.sha256(names.encode(errors="surrogateescape")).hexdigest()


def measured(
    labelled: LabelledSet,
    look: Callable[[NDArray[np.uint8]], Look],
    progress: Callable[[int, int], None] = lambda done, total: None,
    otherwise: Calibration | None = None,
) -> Calibration:
    """Measure the calibration of a network whose predictions for an image (H, W, 3) uint8 RGB `look` returns.
    otherwise: calibration that was measured before, returned where fewer than `LEAST` images show an oyster; without
    it, one image is enough, and the default calibration is returned where there is none."""
    taken = evenly(labelled.entries, MOST)
    seen = []
    for k, entry in enumerate(taken, start=1):
        image = entry.read()
        seen.append(Seen.of(image, look(image.pixels)))
        progress(k, len(taken) + len(RISES) + 1)
    if sum(one.numbers.any() for one in seen) < (1 if otherwise is None else LEAST):
        return otherwise or Calibration()
    logits, truth = (np.concatenate(parts) for parts in zip(*(one.some() for one in seen), strict=True))
    cut = float(CUTS[np.argmax([_iou(logits > cut, truth) for cut in CUTS])])
    heat = float(TEMPERATURES[np.argmin([_entropy(logits / value, truth) for value in TEMPERATURES])])
    found = Calibration(round(heat, 3), round(cut, 3))
    live_cut, states = _telling(seen)
    rise, sure = _dividing(seen, found, lambda done: progress(len(taken) + done, len(taken) + len(RISES) + 1))
    return replace(found, rise=rise, sure=sure, live_cut=live_cut, states=states, images=len(seen))


def evenly(entries: Sequence[T], most: int) -> list[T]:
    """Select at most `most` of the entries, evenly spaced over the whole length."""
    count = min(most, len(entries))
    return [entries[k * len(entries) // count] for k in range(count)]


@dataclass(frozen=True)
class Seen:
    """Ground truth and prediction of an image, every n-th pixel of a large one: numbers (h, w) of its oysters, 0 for
    none; known (h, w): where the truth may be used; logits (K, h, w); living: whether an oyster is alive, by number,
    where that is known; zoom: of the `Look`."""

    numbers: NDArray[np.uint16]
    known: NDArray[np.bool_]
    logits: NDArray[np.float16]
    living: Mapping[int, bool]
    zoom: float = 1.0

    @classmethod
    def of(cls, image: LabelledImage, look: Look) -> Seen:
        """Combine a labelled image with its prediction."""
        step = -(-max(image.ignore.shape) // LARGEST)
        grid = (slice(None, None, step), slice(None, None, step))
        numbers = np.where(image.oysters, np.maximum(image.instances, 1), 0).astype(np.uint16)
        small = look.logits[(slice(None), *grid)].astype(np.float16)
        return cls(numbers[grid].copy(), ~image.ignore[grid], small, image.living, look.zoom)

    def some(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Logits of oyster (N,) and truth (N,) at a sample of the known pixels."""
        known = np.flatnonzero(self.known)
        places = known[:: max(1, len(known) // PIXELS)]
        return self.logits[0].ravel()[places].astype(np.float32), self.numbers.ravel()[places] > 0


def _iou(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    return float((found & truth).sum() / max(1, (found | truth).sum()))


def _entropy(logits: Floats, truth: NDArray[np.bool_]) -> float:
    return float(np.logaddexp(0, np.where(truth, -logits, logits)).mean())


def _dividing(seen: Sequence[Seen], calibration: Calibration, progress: Callable[[int], None]) -> tuple[float, float]:
    """Find the best rise and the score threshold. Over all images, as many detections are taken as there are true
    oysters, those with the highest scores: the rise is the one with which most of them are correct, the threshold the
    lowest of these scores."""
    hits = []
    for k, rise in enumerate(RISES, start=1):
        scores, right, count = _found(evenly(seen, SOME), calibration, rise)
        hits.append(int(right[np.argsort(scores)[::-1][:count]].sum()))
        progress(k)
    best = RISES[int(np.argmax(hits))]
    scores, _, count = _found(seen, calibration, best)
    progress(len(RISES) + 1)
    if count == 0 or not scores.size:
        return Division.rise, 0.5
    least = np.sort(scores)[::-1][min(count, scores.size) - 1]
    return best, float(np.clip(least, 0.01, 0.99))


def _found(
    seen: Sequence[Seen], calibration: Calibration, rise: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_], int]:
    """Scores (N,) of the oysters detected in all images, which of them (N,) are true ones, and the number of true
    oysters."""
    scores: list[float] = []
    right: list[bool] = []
    count = 0
    for one in seen:
        oyster, depth = one.logits[:2].astype(np.float32)
        numbers = np.where(one.known, one.numbers, 0)
        count += len(np.unique(numbers[numbers > 0]))
        division = Division(rise=rise).zoomed(one.zoom)
        found = find_instances(probability(calibration.applied(oyster)), probability(depth), division)
        judged = means(found, one.known) > 0.5
        scores += found.scores[judged].tolist()
        right += _true(found, numbers)[judged].tolist()
    return np.array(scores), np.array(right, dtype=np.bool_), count


def _true(found: Instances, numbers: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Whether each instance (N,) has an IoU above `SAME` with one of the numbered oysters (h, w); as instances do not
    overlap, at most one matches each oyster."""
    width = len(found.scores) + 1
    pairs, shared = np.unique(numbers.astype(np.int64) * width + found.labels, return_counts=True)
    true, mine = np.divmod(pairs, width)
    areas, mine_areas = np.bincount(numbers.ravel()), np.bincount(found.labels.ravel(), minlength=width)
    iou = shared / (areas[true] + mine_areas[mine] - shared)
    result = np.zeros(width, dtype=np.bool_)
    result[mine[(iou > SAME) & (true > 0)]] = True
    return result[1:]


def _telling(seen: Sequence[Seen]) -> tuple[float, float]:
    """Find the threshold on an oyster's mean logit that best separates live from dead ones, and its balanced accuracy;
    zeros where the network has no such output, or where not both states occur."""
    means: dict[bool, list[float]] = {True: [], False: []}
    for one in seen:
        if len(one.logits) < 3 or not one.living:
            continue
        numbers = np.where(one.known, one.numbers, 0)
        areas = np.bincount(numbers.ravel())
        sums = np.bincount(numbers.ravel(), weights=one.logits[2].ravel().astype(np.float64))
        for number in map(int, np.nonzero(areas)[0]):
            if number in one.living:
                means[one.living[number]].append(sums[number] / areas[number])
    live, dead = np.array(means[True]), np.array(means[False])
    if not len(live) or not len(dead):
        return 0.0, 0.0
    cuts = np.quantile([*live, *dead], np.linspace(0.02, 0.98, 49))
    balanced = [((live > cut).mean() + (dead <= cut).mean()) / 2 for cut in cuts]
    best = int(np.argmax(balanced))
    return round(float(cuts[best]), 3), round(float(balanced[best]), 3)
