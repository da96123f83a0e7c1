"""Scores of predictions on the test images: a line per image, metrics per clip and for all clips together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSet
from oysterbench.evaluate.detection import EVALUATOR as DETECTION_EVALUATOR
from oysterbench.evaluate.detection import DetectionScorer, ImageInstances
from oysterbench.evaluate.detection.clip import over_clips
from oysterbench.evaluate.detection.instances import from_planes
from oysterbench.evaluate.segmentation import EVALUATOR, ClipScorer, EstimateImage, TruthImage
from oysterbench.evaluate.segmentation.clip import join

WHOLE = "all clips"
"""Name of the record of all test images together."""

EVALUATORS = f"{EVALUATOR}, {DETECTION_EVALUATOR}"


@dataclass(frozen=True)
class Truth:
    """Ground truth of the test images in the form that the evaluators take, read once for all cells."""

    clips: tuple[str, ...]
    masks: tuple[TruthImage, ...]
    instances: tuple[ImageInstances, ...]
    pixels: tuple[NDArray[np.uint8], ...]

    @classmethod
    def of(cls, labelled: LabelledSet) -> Truth:
        """Read the ground truth of a set of labelled images."""
        clips, masks, instances, pixels = [], [], [], []
        for image in labelled:
            clips.append(image.clip)
            ignore = image.ignore if image.ignore.any() else None
            masks.append(TruthImage(image.name, image.classes, named=False, ignore=ignore))
            numbers = np.where(image.oysters, image.instances, 0)
            instances.append(from_planes(image.name, numbers, ignore))
            pixels.append(image.pixels)
        return cls(tuple(clips), tuple(masks), tuple(instances), tuple(pixels))


@dataclass(frozen=True)
class Prediction:
    """Prediction for one image: mask (H, W) bool; labels (H, W) int32 of single oysters, 0 for none; scores[k], the
    score of label k + 1."""

    mask: NDArray[np.bool_]
    labels: NDArray[np.int32]
    scores: NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """Scores of one method. metrics: by clip, and of all clips (`WHOLE`); reasons: why metrics are NaN; images: a line
    for each."""

    metrics: Mapping[str, Mapping[str, float]]
    reasons: Mapping[str, Mapping[str, str]]
    images: tuple[Mapping[str, Any], ...]


def score(truth: Truth, predictions: Iterable[Prediction]) -> Score:
    """Score predictions, one for each image of the truth, in its order."""
    masks = {clip: ClipScorer() for clip in dict.fromkeys(truth.clips)}
    oysters = {clip: DetectionScorer() for clip in masks}
    images: list[dict[str, Any]] = []
    for clip, mask, instances, prediction in zip(truth.clips, truth.masks, truth.instances, predictions, strict=True):
        found = masks[clip].add(mask, EstimateImage(mask.name, oyster=prediction.mask))
        scores = {k + 1: float(value) for k, value in enumerate(prediction.scores)}
        oysters[clip].add(instances, from_planes(mask.name, prediction.labels, scores=scores))
        tally = {key: found.tally[f"{key}_px"] for key in ("true_positive", "false_positive", "false_negative")}
        counts = {"oysters": sum(not one.crowd for one in instances.instances), "found": len(prediction.scores)}
        images.append({"name": mask.name, "clip": clip, **tally, **counts})
    of_masks = {clip: scorer.result() for clip, scorer in masks.items()}
    of_oysters = {clip: scorer.result() for clip, scorer in oysters.items()}
    of_masks[WHOLE] = join(list(of_masks.values()))
    of_oysters[WHOLE] = over_clips(list(of_oysters.values()))[0]
    return Score(
        {clip: {**of_masks[clip].metrics, **of_oysters[clip].metrics} for clip in of_masks},
        {clip: {**of_masks[clip].reasons, **of_oysters[clip].reasons} for clip in of_masks},
        tuple(images),
    )
