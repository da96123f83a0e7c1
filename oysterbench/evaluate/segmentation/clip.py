"""Scoring the images of a clip one by one: only counts and one entry per image are kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.segmentation.computation import measure, weights
from oysterbench.evaluate.segmentation.images import EstimateImage, TruthImage, check_pair
from oysterbench.evaluate.segmentation.settings import SegmentationSettings
from oysterbench.evaluate.segmentation.tally import Tally, add, tally_image
from oysterbench.evaluate.segmentation.thresholds import STEPS, ThresholdCurve, curve, histogram

IMAGE_METRICS = ("iou", "boundary_iou", "precision", "recall", "dice", "cover", "cover_error")
"""Metrics given for each image."""


@dataclass(frozen=True)
class ImageScore:
    """Score of one image: its name, metrics (`IMAGE_METRICS`; IoU and Dice are NaN if all is ignored) and counts."""

    name: str
    metrics: Mapping[str, float]
    tally: Mapping[str, float]


@dataclass(frozen=True)
class ClipResult:
    """Result of scoring a clip, or a whole data set.

    metrics:   values by keys of `SEGMENTATION`; NaN where there is no sample, with the reason in `reasons`
    tally:     the counts from which they are computed
    histogram: (2, STEPS) for a method that gives probabilities (`thresholds.histogram`); None for others
    images:    scores of the images, in the order in which they were scored
    """

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    tally: Tally
    histogram: NDArray[np.int64] | None
    images: tuple[ImageScore, ...]
    settings: SegmentationSettings

    @property
    def curve(self) -> ThresholdCurve | None:
        """Precision, recall and IoU over thresholds, for a method that gives probabilities; None for others."""
        return None if self.histogram is None else curve(self.histogram)


class ClipScorer:
    """Scorer that takes images one by one, and returns the result over all of them."""

    def __init__(self, settings: SegmentationSettings | None = None) -> None:
        self.settings = settings or SegmentationSettings()
        self._tally: Tally = {}
        self._histogram = np.zeros((2, STEPS), np.int64)
        self._images: list[ImageScore] = []
        self._kinds: set[str] = set()

    def add(self, truth: TruthImage, estimate: EstimateImage) -> ImageScore:
        """Score one image. Raises LabelError if truth and estimate are not of the same image and size, or the estimate
        is of another kind than those before."""
        check_pair(truth, estimate)
        oyster = np.ascontiguousarray(estimate.mask(self.settings.threshold))
        tally = tally_image(truth, estimate, oyster, self.settings)
        if estimate.probability is not None:
            scored = None if truth.ignore is None else ~truth.ignore
            self._histogram += histogram(estimate.probability, truth.oyster, scored)
        self._kinds.add(estimate.kind)
        if len(self._kinds) > 1:
            raise LabelError(f"{truth.name}: expected estimates of one kind, got {' and '.join(sorted(self._kinds))}")
        self._tally = add([self._tally, tally])
        values, _ = measure(tally)
        if not tally["scored_images"]:
            values |= dict.fromkeys(("iou", "dice", "boundary_iou"), float("nan"))
        score = ImageScore(truth.name, {key: values[key] for key in IMAGE_METRICS}, tally)
        self._images.append(score)
        return score

    def result(self) -> ClipResult:
        """Return the result over all images so far. Raises LabelError if there is none."""
        if not self._images:
            raise LabelError("expected at least one image to score, got none")
        counts = self._histogram if "probabilities" in self._kinds else None
        return finish(self._tally, counts, tuple(self._images), self.settings)


def finish(
    tally: Tally, counts: NDArray[np.int64] | None, images: tuple[ImageScore, ...], settings: SegmentationSettings
) -> ClipResult:
    """Compute the result from counts."""
    metrics, reasons = measure(tally)
    if counts is not None:
        own = (metrics["iou"], settings.threshold)  # may lie between the thresholds of the curve
        best = curve(counts).best
        metrics["best_iou"], metrics["best_threshold"] = own if own[0] > best[0] else best
    return ClipResult({**metrics, **weights(tally)}, reasons, tally, counts, images, settings)


def join(results: list[ClipResult]) -> ClipResult:
    """Compute the result over several clips from the sum of their counts."""
    histograms = [result.histogram for result in results if result.histogram is not None]
    counts = np.sum(histograms, axis=0) if len(histograms) == len(results) else None
    images = tuple(image for result in results for image in result.images)
    return finish(add([result.tally for result in results]), counts, images, results[0].settings)


def means_of_runs(clips: Sequence[Sequence[ClipResult]]) -> list[ClipResult]:
    """Compute the result on each clip over its runs: ratios of the counts of all of them, and counts as of one run.

    Clips may differ in their number of runs. Histograms, which are whole numbers, are all as of as many runs as the
    least common multiple, so that each clip has the same weight in their sum, too."""
    common = math.lcm(*map(len, clips))
    return [_mean_of_runs(list(runs), common) for runs in clips]


def _mean_of_runs(runs: list[ClipResult], common: int) -> ClipResult:
    if len(runs) == common == 1:
        return runs[0]
    whole = join(runs)
    tally = {key: count / len(runs) for key, count in whole.tally.items()}
    counts = None if whole.histogram is None else whole.histogram * (common // len(runs))
    return finish(tally, counts, whole.images, whole.settings)
