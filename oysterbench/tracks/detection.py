"""The detection track: images in, individual oysters out. Methods of the segmentation track take part with the
connected components of their masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from oysterbench.annotations import CocoFile, LabelledSequence
from oysterbench.evaluate.detection import EVALUATOR, DetectionClip, DetectionScorer, DetectionSettings, ImageInstances
from oysterbench.evaluate.detection.clip import join, over_clips
from oysterbench.evaluate.detection.instances import mask_tools
from oysterbench.evaluate.detection.panoptic import paint
from oysterbench.methods.interfaces.images import Prediction
from oysterbench.report.images import DatasetRow, Sample
from oysterbench.report.overlay import overlay, sampled
from oysterbench.tracks.images import KIND, SAMPLES, THRESHOLD, ImageTrack, Predictor, instances_of
from oysterbench.tracks.track import Option, Request


class DetectionTrack(ImageTrack):
    """Detection track: individual oysters, found and counted."""

    name = "detection"
    title = "Individual oysters in images: found, outlined, counted."
    takes = ("detection", "segmentation")
    evaluator = EVALUATOR
    single = True
    options = (
        THRESHOLD,
        Option("max_detections", "--max-detections", "Maximum detections per image.  [default: 300]", int),
        KIND,
    )
    examples = """
      oysterbench eval detection --method my_net:MyNet --split seg-val
      oysterbench eval detection --truth instances.json --estimate results.json"""

    def check(self, request: Request) -> None:
        """Also refuse to begin without the package that matches oysters: it would be missed after all runs."""
        super().check(request)
        mask_tools()

    def settings(self, options: Mapping[str, Any]) -> DetectionSettings:
        """Settings of the evaluator."""
        return DetectionSettings(**{key: options[key] for key in ("threshold", "max_detections") if key in options})

    def of_prediction(
        self, prediction: Prediction, method: str, shape: tuple[int, int], settings: DetectionSettings
    ) -> ImageInstances:
        """Instances of a prediction: its detections, or the connected components of its masks."""
        return instances_of(prediction, method, shape, settings.threshold)

    def of_coco(self, file: CocoFile, name: str, settings: DetectionSettings) -> ImageInstances:
        """Instances of an image in a COCO file, with their scores."""
        return file.instances(name, scored=True)

    def score_sequence(
        self,
        labelled: LabelledSequence,
        get: Predictor,
        settings: DetectionSettings,
        method: str,
        samples_wanted: int = SAMPLES,
    ) -> tuple[DetectionClip, list[Sample]]:
        """Score oyster by oyster; sample images are drawn if every counted instance has a mask."""
        scorer, wanted, samples = DetectionScorer(settings), sampled(labelled.names, samples_wanted), []
        for instances, seen in labelled.single():
            estimate = get(instances.name, (instances.height, instances.width))
            scorer.add(instances, estimate)
            counted = [one for one in estimate.instances if one.score >= settings.threshold]
            if seen is not None and instances.name in wanted and all(one.mask is not None for one in counted):
                truth, pixels = seen
                shown = labelled.shown(truth.name, pixels)
                samples.append(overlay(truth, shown, paint(estimate, counted) > 0, method))
        return scorer.result(), samples

    def over_dataset(self, method: str, results: Sequence[Sequence[DetectionClip]]) -> DatasetRow:
        """Result over all images together."""
        runs = [len(one) for one in results]
        whole, intervals = over_clips([join(one) for one in results], runs)
        return DatasetRow(self.name, method, whole.metrics, whole.reasons, intervals, len(results), whole, runs)


TRACK = DetectionTrack()
