"""The segmentation track: each method over each clip, or masks read from files, scored and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.annotations import LabelledSequence, labelled_sequence, open_predictions, open_truth, read_coco
from oysterbench.annotations.masks import Form, check_names
from oysterbench.core.errors import LabelError, MethodError
from oysterbench.evaluate.segmentation import EVALUATOR, ClipResult, ClipScorer, EstimateImage, SegmentationSettings
from oysterbench.evaluate.segmentation.dataset import over_dataset
from oysterbench.recipe import SplitRecipe
from oysterbench.report.images import DatasetRow, ImageRun, Sample
from oysterbench.report.overlay import overlay, sampled
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import digest
from oysterbench.tracks.image_predictions import Cost, answers_of, segmentation_of

SAMPLES = 3  # pictures of a clip in the report
Announce = Callable[[str], None]


def split_clips(split: SplitRecipe, files: Mapping[str, Path]) -> list[LabelledSequence]:
    """The rendered sequences of a split, a clip each."""
    return [labelled_sequence(path, conditions(split, name)) for name, path in files.items()]


def about(
    track: str, split: SplitRecipe | None, clip: LabelledSequence, settings: Any, evaluator: str
) -> dict[str, Any]:
    """What every record of a clip says."""
    return {
        "track": track,
        "split": "" if split is None else split.name,
        "split_digest": "" if split is None else digest(split),
        "sequence": clip.name,
        "truth_digest": clip.digest,
        "conditions": clip.conditions,
        "settings": settings.as_dict(),
        "evaluator_version": evaluator,
    }


def evaluate_segmentation(
    split: SplitRecipe | None,
    clips: Sequence[LabelledSequence],
    methods: Sequence[Any],
    settings: SegmentationSettings,
    announce: Announce = lambda text: None,
) -> tuple[list[ImageRun], list[DatasetRow]]:
    """Run each method on each clip; a run that fails leaves a record with `failure`, in which all oysters are missed.

    Returns the runs, clip by clip, and for each method that failed on none the result over the data set.
    """
    runs = []
    for clip in clips:
        for method in methods:
            announce(f"running {method.name} on {clip.name}")
            runs.append(_run(split, clip, method, settings))
    return runs, dataset_rows(runs)


def _run(split: SplitRecipe | None, clip: LabelledSequence, method: Any, settings: SegmentationSettings) -> ImageRun:
    record = {
        **about("segmentation", split, clip, settings, EVALUATOR),
        "method": method.name,
        "seed": getattr(method, "seed", None),
        "method_settings": getattr(method, "as_dict", dict)(),
    }
    scorer, cost = ClipScorer(settings), Cost()
    wanted, samples = sampled(clip.names, SAMPLES), []
    try:
        for truth, pixels, answer in answers_of(method, clip, cost):
            estimate = segmentation_of(answer, method.name)
            scorer.add(truth, estimate)
            if truth.name in wanted:
                samples.append(overlay(truth, pixels, estimate.mask(settings.threshold), method.name))
    except (MethodError, LabelError) as error:
        missed = all_missed(clip, settings)
        return ImageRun(ResultRecord(**record, failure=str(error), metrics=missed))
    return _recorded(record, scorer.result(), samples, cost.metrics)


def all_missed(clip: LabelledSequence, settings: SegmentationSettings) -> dict[str, float]:
    """By what a failed run counts in a mean over clips: the pixels of the truth, none of which it found."""
    scorer = ClipScorer(settings)
    for truth, _ in clip.images():
        scorer.add(truth, EstimateImage(truth.name, oyster=np.zeros(truth.classes.shape, dtype=bool)))
    metrics = scorer.result().metrics
    return {key: value for key, value in metrics.items() if key.endswith(("_px", "images"))}


def _recorded(
    record: Mapping[str, Any], result: ClipResult, samples: Sequence[Sample], cost: Mapping[str, float]
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
        results = [run.result for run in group if isinstance(run.result, ClipResult)]
        if len(results) == len(group):
            found = over_dataset(results)
            rows.append(
                DatasetRow(method, found.whole.metrics, found.whole.reasons, found.intervals, found.clips, found.whole)
            )
    return rows


def score_segmentation_files(
    truth: Path,
    estimate: Path,
    settings: SegmentationSettings,
    form: Form = "auto",
    labels: str = "mask",
    ignore_value: int | None = None,
) -> tuple[list[ImageRun], list[DatasetRow]]:
    """Score answers in a folder, an .npz or COCO annotations against any truth (`answers.open_truth`). Raises
    LabelError, in one line, where a pair is missing, or a file is not what it should be."""
    clips = open_truth(truth, labels, ignore_value)
    get, names = _reader(estimate, clips, settings, form)
    check_names((name for clip in clips for name in clip.names), names, estimate)
    runs = []
    for clip in clips:
        scorer = ClipScorer(settings)
        wanted, samples = sampled(clip.names, SAMPLES), []
        for true, pixels in clip.images():
            answer = get(true.name)
            scorer.add(true, answer)
            if true.name in wanted:
                samples.append(overlay(true, pixels, answer.mask(settings.threshold), estimate.name))
        record = {**about("segmentation", None, clip, settings, EVALUATOR), "method": estimate.name}
        runs.append(_recorded(record, scorer.result(), samples, {}))
    return runs, dataset_rows(runs)


def _reader(
    place: Path, clips: Sequence[LabelledSequence], settings: SegmentationSettings, form: Form
) -> tuple[Callable[[str], EstimateImage], tuple[str, ...]]:
    """What reads the answer to an image, and the images that are answered."""
    if place.suffix.lower() == ".json":
        coco = next((clip.coco for clip in clips if clip.coco is not None), None)
        file = read_coco(place, None if coco is None else coco.images)
        return lambda name: file.mask(name, settings.threshold), file.names
    files = open_predictions(place, form)
    return files.get, files.names
