"""The detection track: each method over each clip, or COCO annotations read from a file, scored and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from oysterbench.annotations import LabelledSequence, open_predictions, open_truth, read_coco
from oysterbench.annotations.masks import Form, check_names
from oysterbench.core.errors import LabelError, MethodError
from oysterbench.evaluate.detection import EVALUATOR, DetectionClip, DetectionScorer, DetectionSettings, ImageInstances
from oysterbench.evaluate.detection.clip import over_clips
from oysterbench.evaluate.detection.panoptic import paint
from oysterbench.evaluate.segmentation import TruthImage
from oysterbench.methods.images import Segmentation
from oysterbench.recipe import SplitRecipe
from oysterbench.report.images import DatasetRow, ImageRun, Sample
from oysterbench.report.overlay import overlay, sampled
from oysterbench.results.records import ResultRecord
from oysterbench.tracks.image_predictions import Cost, answers_of, instances_of
from oysterbench.tracks.segmentation import SAMPLES, Announce, about


def evaluate_detection(
    split: SplitRecipe | None,
    clips: Sequence[LabelledSequence],
    methods: Sequence[Any],
    settings: DetectionSettings,
    announce: Announce = lambda text: None,
) -> tuple[list[ImageRun], list[DatasetRow]]:
    """Run each method on each clip; a run that fails leaves a record with `failure`. Methods of the track segmentation
    take part by what hangs together in their masks."""
    runs = []
    for clip in clips:
        for method in methods:
            announce(f"running {method.name} on {clip.name}")
            runs.append(_run(split, clip, method, settings))
    return runs, dataset_rows(runs)


def _run(split: SplitRecipe | None, clip: LabelledSequence, method: Any, settings: DetectionSettings) -> ImageRun:
    record = {
        **about("detection", split, clip, settings, EVALUATOR),
        "method": method.name,
        "seed": getattr(method, "seed", None),
        "method_settings": getattr(method, "as_dict", dict)(),
    }
    scorer, cost = DetectionScorer(settings), Cost()
    wanted, samples = sampled(clip.names, SAMPLES), []
    try:
        for truth, pixels, answer in answers_of(method, clip, cost):
            height, width = truth.classes.shape
            estimate = instances_of(answer, method.name, (height, width), settings.threshold)
            scorer.add(clip.instances(truth), estimate)
            if truth.name in wanted:
                samples += _sample(truth, pixels, estimate, settings, method.name)
    except (MethodError, LabelError) as error:
        return ImageRun(ResultRecord(**record, failure=str(error)))
    return _recorded(record, scorer.result(), samples, cost.metrics)


def _sample(
    truth: TruthImage, pixels: Any, estimate: ImageInstances, settings: DetectionSettings, method: str
) -> list[Sample]:
    """A picture, where there are masks to paint."""
    counted = [one for one in estimate.instances if one.score >= settings.threshold]
    if any(one.mask is None for one in counted):
        return []
    return [overlay(truth, pixels, paint(estimate, counted) > 0, method)]


def _recorded(
    record: Mapping[str, Any], result: DetectionClip, samples: Sequence[Sample], cost: Mapping[str, float]
) -> ImageRun:
    metrics = {**result.metrics, **cost}
    return ImageRun(ResultRecord(**record, metrics=metrics, reasons=result.reasons), result, tuple(samples))


def dataset_rows(runs: Iterable[ImageRun]) -> list[DatasetRow]:
    """The result over all clips of each method that could be scored on all of them."""
    groups: dict[str, list[ImageRun]] = {}
    for run in runs:
        groups.setdefault(run.record.method, []).append(run)
    rows = []
    for method, group in groups.items():
        results = [run.result for run in group if isinstance(run.result, DetectionClip)]
        if len(results) == len(group):
            whole, intervals = over_clips(results)
            rows.append(DatasetRow(method, whole.metrics, whole.reasons, intervals, len(results), whole))
    return rows


def score_detection_files(
    truth: Path, estimate: Path, settings: DetectionSettings, form: Form = "auto"
) -> tuple[list[ImageRun], list[DatasetRow]]:
    """Score COCO annotations, or masks whose connected components are taken for oysters, against any truth that tells
    oysters apart (`answers.open_truth`). Raises LabelError, in one line, naming the item that is wrong."""
    clips = open_truth(truth)
    get, names = _reader(estimate, clips, settings, form)
    check_names((name for clip in clips for name in clip.names), names, estimate)
    runs = []
    for clip in clips:
        scorer = DetectionScorer(settings)
        wanted, samples = sampled(clip.names, SAMPLES), []
        for instances, seen in clip.single():
            answer = get(instances)
            scorer.add(instances, answer)
            if seen is not None and instances.name in wanted:
                samples += _sample(*seen, answer, settings, estimate.name)
        record = {**about("detection", None, clip, settings, EVALUATOR), "method": estimate.name}
        runs.append(_recorded(record, scorer.result(), samples, {}))
    return runs, dataset_rows(runs)


def _reader(
    place: Path, clips: Sequence[LabelledSequence], settings: DetectionSettings, form: Form
) -> tuple[Callable[[ImageInstances], ImageInstances], tuple[str, ...]]:
    """What reads the oysters of an image, and the images that are answered."""
    if place.suffix.lower() == ".json":
        coco = next((clip.coco for clip in clips if clip.coco is not None), None)
        file = read_coco(place, None if coco is None else coco.images)
        return lambda truth: file.instances(truth.name, scored=True), file.names
    files = open_predictions(place, form)

    def cut(truth: ImageInstances) -> ImageInstances:
        found = files.get(truth.name)
        answer = Segmentation(found.name, found.oyster, found.probability, found.classes)
        return instances_of(answer, str(place), (truth.height, truth.width), settings.threshold)

    return cut, files.names
