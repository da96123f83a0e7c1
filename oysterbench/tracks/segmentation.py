"""The segmentation track: images in, masks or probabilities out, scored against labelled pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oysterbench.annotations import CocoFile, LabelledSequence
from oysterbench.evaluate.segmentation import EVALUATOR, ClipResult, ClipScorer, EstimateImage, SegmentationSettings
from oysterbench.evaluate.segmentation.clip import means_of_runs
from oysterbench.evaluate.segmentation.dataset import over_dataset
from oysterbench.methods.interfaces.images import Prediction
from oysterbench.report.images import DatasetRow, Sample
from oysterbench.report.overlay import overlay, sampled
from oysterbench.tracks.images import (
    KIND,
    SAMPLES,
    THRESHOLD,
    ImageTrack,
    Predictor,
    segmentation_of,
)
from oysterbench.tracks.track import Option


class SegmentationTrack(ImageTrack):
    """Segmentation track: which pixels are oysters."""

    name = "segmentation"
    title = "Which pixels of images are oysters."
    takes = ("segmentation",)
    evaluator = EVALUATOR
    options = (
        THRESHOLD,
        KIND,
        Option(
            "labels",
            "--truth-kind",
            "Meaning of the ground truth's values.  [default: mask]",
            ("mask", "classes"),
            files=True,
        ),
        Option("ignore_value", "--ignore-value", "Ground-truth value that is not scored.", int, files=True),
    )
    examples = """
      oysterbench eval segmentation --method my_net:MyNet --split seg-val
      oysterbench eval segmentation --truth masks/ --estimate probabilities/ --threshold 0.4"""

    def settings(self, options: Mapping[str, Any]) -> SegmentationSettings:
        """Settings of the evaluator."""
        return SegmentationSettings(**{key: options[key] for key in ("threshold",) if key in options})

    def of_prediction(
        self, prediction: Prediction, method: str, shape: tuple[int, int], settings: SegmentationSettings
    ) -> EstimateImage:
        """Masks, probabilities or classes of a prediction."""
        return segmentation_of(prediction, method)

    def of_coco(self, file: CocoFile, name: str, settings: SegmentationSettings) -> EstimateImage:
        """Union of the instances of an image whose score reaches the threshold."""
        return file.mask(name, settings.threshold)

    def score_sequence(
        self,
        labelled: LabelledSequence,
        get: Predictor,
        settings: SegmentationSettings,
        method: str,
        samples_wanted: int = SAMPLES,
    ) -> tuple[ClipResult, list[Sample]]:
        """Score pixel by pixel."""
        scorer, wanted, samples = ClipScorer(settings), sampled(labelled.names, samples_wanted), []
        for truth, pixels in labelled.images():
            estimate = get(truth.name, truth.classes.shape)
            scorer.add(truth, estimate)
            if truth.name in wanted:
                shown = labelled.shown(truth.name, pixels)
                samples.append(overlay(truth, shown, estimate.mask(settings.threshold), method))
        return scorer.result(), samples

    def failed_metrics(self, labelled: LabelledSequence, settings: SegmentationSettings) -> Mapping[str, float]:
        """Pixel and image counts of a run that found no oyster pixels."""
        scorer = ClipScorer(settings)
        for truth, _ in labelled.images():
            scorer.add(truth, EstimateImage(truth.name, oyster=np.zeros(truth.classes.shape, dtype=bool)))
        metrics = scorer.result().metrics
        return {key: value for key, value in metrics.items() if key.endswith(("_px", "images"))}

    def over_dataset(self, method: str, results: Sequence[Sequence[ClipResult]]) -> DatasetRow:
        """Result over all images together."""
        found = over_dataset(means_of_runs(results))
        whole, runs = found.whole, [len(one) for one in results]
        return DatasetRow(self.name, method, whole.metrics, whole.reasons, found.intervals, found.clips, whole, runs)


TRACK = SegmentationTrack()
