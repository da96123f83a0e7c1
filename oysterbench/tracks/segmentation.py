"""The segmentation track: pictures in, masks or probabilities out, held against labelled pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oysterbench.annotations import CocoFile, LabelledSequence
from oysterbench.evaluate.segmentation import EVALUATOR, ClipResult, ClipScorer, EstimateImage, SegmentationSettings
from oysterbench.evaluate.segmentation.dataset import over_dataset
from oysterbench.methods.interfaces.images import Prediction
from oysterbench.report.images import DatasetRow, ImageRun, Sample
from oysterbench.report.overlay import overlay
from oysterbench.tracks.images import (
    KIND,
    THRESHOLD,
    ImageTrack,
    Predictor,
    by_method,
    sampled_pictures,
    segmentation_of,
)
from oysterbench.tracks.track import Option


class SegmentationTrack(ImageTrack):
    """Which pixels are oysters."""

    name = "segmentation"
    title = "Which pixels of pictures are oysters."
    takes = ("segmentation",)
    folder = "results-segmentation"
    options = (
        THRESHOLD,
        KIND,
        Option(
            "labels", "--truth-kind", "What the truth's numbers are.  [default: mask]", ("mask", "classes"), files=True
        ),
        Option("ignore_value", "--ignore-value", "Number in the truth that is not asked about.", int, files=True),
    )
    examples = """
      oysterbench eval segmentation --method my_net:MyNet --split seg-val
      oysterbench eval segmentation --truth masks/ --estimate probabilities/ --threshold 0.4"""

    def evaluator(self) -> str:
        """Name and version."""
        return EVALUATOR

    def settings(self, options: Mapping[str, Any]) -> SegmentationSettings:
        """Of the evaluator."""
        return SegmentationSettings(**{key: options[key] for key in ("threshold",) if key in options})

    def of_prediction(
        self, prediction: Prediction, method: str, shape: tuple[int, int], settings: SegmentationSettings
    ) -> EstimateImage:
        """Masks, probabilities or classes."""
        return segmentation_of(prediction, method)

    def of_coco(self, file: CocoFile, name: str, settings: SegmentationSettings) -> EstimateImage:
        """The union of its instances that score enough."""
        return file.mask(name, settings.threshold)

    def score_sequence(
        self, labelled: LabelledSequence, get: Predictor, settings: SegmentationSettings, method: str
    ) -> tuple[ClipResult, list[Sample]]:
        """Pixel by pixel."""
        scorer, wanted, samples = ClipScorer(settings), sampled_pictures(labelled), []
        for truth, pixels in labelled.images():
            estimate = get(truth.name, truth.classes.shape)
            scorer.add(truth, estimate)
            if truth.name in wanted:
                samples.append(overlay(truth, pixels, estimate.mask(settings.threshold), method))
        return scorer.result(), samples

    def failed_metrics(self, labelled: LabelledSequence, settings: SegmentationSettings) -> Mapping[str, float]:
        """All oysters are missed."""
        return all_missed(labelled, settings)

    def dataset_rows(self, runs: Sequence[ImageRun]) -> list[DatasetRow]:
        """All pictures together."""
        return dataset_rows(runs)


def all_missed(labelled: LabelledSequence, settings: SegmentationSettings) -> dict[str, float]:
    """By what a failed run counts in a mean over sequences: the pixels of the truth, none of which it found."""
    scorer = ClipScorer(settings)
    for truth, _ in labelled.images():
        scorer.add(truth, EstimateImage(truth.name, oyster=np.zeros(truth.classes.shape, dtype=bool)))
    metrics = scorer.result().metrics
    return {key: value for key, value in metrics.items() if key.endswith(("_px", "images"))}


def dataset_rows(runs: Sequence[ImageRun]) -> list[DatasetRow]:
    """The result over all sequences of each method that could be scored on all of them."""
    rows = []
    for method, group in by_method(runs).items():
        results = [run.result for run in group if isinstance(run.result, ClipResult)]
        if len(results) == len(group):
            found = over_dataset(results)
            whole = found.whole
            rows.append(DatasetRow(method, whole.metrics, whole.reasons, found.intervals, found.clips, whole))
    return rows


TRACK = SegmentationTrack()
