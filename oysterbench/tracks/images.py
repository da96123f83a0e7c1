"""Common base of the image tracks: images in, a prediction for each out, scored against labelled sequences."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from oysterbench.annotations import LabelledSequence, labelled_sequence, open_predictions, open_truth, read_coco
from oysterbench.annotations.forms import FORMS, Form
from oysterbench.annotations.masks import MaskFiles, check_names
from oysterbench.annotations.parts import connected_parts
from oysterbench.core.errors import LabelError, MethodError
from oysterbench.core.masks import as_mask
from oysterbench.evaluate.detection import ImageInstances
from oysterbench.evaluate.detection.instances import Instance, from_mask, from_planes, instance_numbers, renumbered
from oysterbench.evaluate.segmentation import EstimateImage, check_size
from oysterbench.methods.checks import check_count, check_shape, checked_boxes, checked_masks, checked_scores
from oysterbench.methods.images import Detections, Picture, Segmentation
from oysterbench.methods.interfaces import RunSequence
from oysterbench.methods.interfaces.images import (
    LIMIT_OF_PICTURE_S,
    Prediction,
    read_predictions,
    write_pictures,
)
from oysterbench.methods.outcomes import Job, Outcome
from oysterbench.methods.processes import Processes
from oysterbench.recipe import SplitRecipe
from oysterbench.report import images_csv
from oysterbench.report.images import DatasetRow, ImageRun, Sample, dataset_tables, lacking_table
from oysterbench.report.tables import failures_and_notes
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import digest
from oysterbench.tracks.track import (
    Evaluation,
    Option,
    Track,
    about_run,
    about_sequence,
    check_names_differ,
    cost_of,
    shown_tables,
)

SAMPLES = 3  # sample images per sequence in the report

THRESHOLD = Option("threshold", "--threshold", "Minimum score of an oyster.  [default: 0.5]", float)
KIND = Option(
    "form",
    "--estimate-kind",
    "Meaning of the estimate's values; auto: of floats probabilities, of 0 and one other number a mask, of small 16-bit"
    " numbers in patches oysters, else probabilities (255 or 65535 is 1).  [default: auto]",
    FORMS,
    files=True,
)


class PictureSequence(RunSequence):
    """A labelled sequence whose images are given to methods; places: its files; split: the split that it belongs to,
    None for one of the user's own."""

    def __init__(
        self, labelled: LabelledSequence, places: Sequence[Path] = (), split: SplitRecipe | None = None
    ) -> None:
        self.name = labelled.name
        self.labelled, self.places, self.split = labelled, tuple(places), split
        self._given = labelled.digest_given() if split is None else ""

    @property
    def origin(self) -> str:
        """Split, digest of its recipe, and name for a sequence of a public split; for others the digest of the files,
        and for one's own also of the names of the images, by which methods are given them, and name them in files."""
        if self.split is None:
            return self._given
        if self.split.hidden:
            return self.labelled.digest
        return f"{self.split.name} {digest(self.split)} {self.name}"

    @property
    def hidden(self) -> tuple[Path, ...]:
        """The labelled files."""
        return self.places

    @property
    def limit_s(self) -> float:
        """Time limit of a run, s: ten seconds per image, at least ten minutes."""
        return max(LIMIT_OF_PICTURE_S * len(self.labelled.names), 600.0)

    def write_input(self, form: str, out: Path, processes: Processes) -> None:
        """Write the images alone, without labels."""
        write_pictures(self._pictures(), out)

    def _pictures(self) -> Iterator[Picture]:
        for name, pixels in self.labelled.pictures():
            if pixels is None:
                raise LabelError(
                    f"{name}: expected an image to run a method on, got only the ground truth; images of COCO "
                    "annotations are found by their file_name, beside these or in images/ there"
                )
            yield Picture(name, pixels)


class ImageTrack(Track):
    """Base class of the image tracks."""

    splits = ("segmentation",)
    default_split = "seg-mini"
    default_methods = ("all", "none", "colour")
    files = "masks, or annotations,"
    single: ClassVar[bool] = False
    """Whether individual oysters are distinguished."""

    @abstractmethod
    def score_sequence(
        self, labelled: LabelledSequence, get: Predictor, settings: Any, method: str, samples_wanted: int = SAMPLES
    ) -> tuple[Any, list[Sample]]:
        """Score a sequence; return the result and up to `samples_wanted` sample images with the prediction drawn in.

        get: returns the prediction for the name and the size (H, W) of an image
        """

    @abstractmethod
    def of_prediction(self, prediction: Prediction, method: str, shape: tuple[int, int], settings: Any) -> Any:
        """Convert a method's prediction to the evaluator's type."""

    @abstractmethod
    def of_coco(self, file: Any, name: str, settings: Any) -> Any:
        """Convert the COCO annotations of an image to the evaluator's type."""

    @abstractmethod
    def over_dataset(self, method: str, results: Sequence[Sequence[Any]]) -> DatasetRow:
        """The result of a method over all sequences, from those of its runs on each."""

    def dataset_rows(self, runs: Sequence[ImageRun]) -> list[DatasetRow]:
        """Result over all sequences for each method that could be scored on all of them: one that lacks runs on a
        sequence that others ran on, as it was killed there, is left out, as that may be a hard one, and named."""
        groups = _groups(runs)
        left_out = _lacking(runs)
        return [
            replace(self.over_dataset(method, list(found.values())), left_out=left_out)
            for method, found in groups.items()
            if method not in left_out
        ]

    def failed_metrics(self, labelled: LabelledSequence, settings: Any) -> Mapping[str, float]:
        """Metrics with which a failed run counts in a mean over sequences."""
        return {}

    def run_sequences(
        self, split: SplitRecipe | None, files: Mapping[str, Path], options: Mapping[str, Any]
    ) -> Sequence[PictureSequence]:
        """Sequences of a split, or the user's own: any labelled images that `annotations.open_truth` reads."""
        if split is not None:
            named = files.items()
            return [PictureSequence(labelled_sequence(p, conditions(split, n)), [p], split) for n, p in named]
        reading = {key: options[key] for key in ("labels", "ignore_value") if key in options}
        found = [PictureSequence(one, [path]) for path in files.values() for one in open_truth(path, **reading)]
        check_names_differ(found)
        for sequence in found:
            # An error would come too late after all runs, and would seem to be the method's.
            sequence.labelled.check_annotations(masks=not self.single)
        return found

    def score(self, job: Job, outcome: Outcome, out: Path, settings: Any) -> ImageRun:
        """Score the predictions of a run, image by image."""
        sequence = job.sequence
        assert isinstance(sequence, PictureSequence)
        record = self._about(sequence.split, sequence.labelled, settings) | about_run(job, outcome)
        failure = outcome.failure
        if failure is None:
            try:
                get, notes = self._predictor(job.folder(out), outcome, sequence.labelled, settings, job.adapter.name)
                result, samples = self.score_sequence(sequence.labelled, get, settings, job.adapter.name)
                notes = (*outcome.notes, *notes, *self._notes_on(sequence.labelled))
                metrics = {**result.metrics, **cost_of(outcome, "images_per_s", len(sequence.labelled.names))}
                done = ResultRecord(**record, metrics=metrics, reasons=result.reasons, notes=notes)
                return ImageRun(done, result, tuple(samples))
            except (MethodError, LabelError) as error:
                failure = str(error)
        missed = self.failed_metrics(sequence.labelled, settings)
        return ImageRun(ResultRecord(**record, failure=failure, metrics=missed, notes=tuple(outcome.notes)))

    def _predictor(
        self, folder: Path, outcome: Outcome, labelled: LabelledSequence, settings: Any, method: str
    ) -> tuple[Predictor, tuple[str, ...]]:
        if not outcome.prediction.get("arrays"):
            # Always within the folder, whatever path the method's process reported.
            place = Path(str(outcome.prediction.get("place"))).name
            return self.file_predictor(folder / place, [labelled], settings)
        coming = read_predictions(folder, labelled.names)

        def get(name: str, shape: tuple[int, int]) -> Any:
            return self.of_prediction(next(coming), method, shape, settings)

        return get, ()

    def _notes_on(self, labelled: LabelledSequence) -> tuple[str, ...]:
        sides = (labelled.sides,) if labelled.sides else ()
        return (*sides, *labelled.notes) if self.single else sides

    def file_predictor(
        self, place: Path, labelled: Sequence[LabelledSequence], settings: Any, form: Form = "auto"
    ) -> tuple[Predictor, tuple[str, ...]]:
        """Return a function that reads the prediction for an image from files, and notes on these. Raises LabelError
        where an image has none, or where there is one too many."""
        wanted = [name for one in labelled for name in one.names]
        unscored = [name for one in labelled for name in one.unscored]
        if place.suffix.lower() != ".json":
            files = open_predictions(place, form)
            check_names(wanted, files.names, place, unscored)
            return lambda name, shape: self.of_masks(files, name, shape, settings), files.notes
        coco = next((one.coco for one in labelled if one.coco is not None), None)
        file = read_coco(place, coco)
        check_names(wanted, file.names, place, unscored)
        notes = file.notes
        outlined = any(one.coco is None or not one.coco.boxes_alone for one in labelled)
        if self.single and outlined and file.boxes_alone:
            notes += (f"oysters with a box alone overlap no mask: {file.without_mask}",)
        return lambda name, shape: self.of_coco(file, name, settings), notes

    def of_masks(self, files: MaskFiles, name: str, shape: tuple[int, int], settings: Any) -> Any:
        """Return the prediction for an image of size (H, W) from mask files, in the evaluator's type. Raises LabelError
        naming its file."""
        found = files.get(name)
        check_size(found, shape, files.where(name))
        numbers = files.numbers(name)
        prediction: Prediction = Segmentation(name, found.oyster, found.probability, found.classes)
        if numbers is not None and self.single:
            known, numbers = renumbered(numbers)
            prediction = Detections(name, np.ones(len(known)), numbers=numbers)
        return self.of_prediction(prediction, str(files.place), shape, settings)

    def score_files(self, truth: Path, estimate: Path, options: Mapping[str, Any]) -> Evaluation:
        """Score predictions in a folder, an .npz or COCO file against any ground truth (`annotations.open_truth`).

        Raises LabelError, in one line, where one of a pair is missing, or a file is not as expected.
        """
        settings = self.settings(options)
        reading = {key: options[key] for key in ("labels", "ignore_value") if key in options}
        sequences = open_truth(truth, **reading)
        get, notes = self.file_predictor(estimate, sequences, settings, cast(Form, options.get("form", "auto")))
        runs = []
        for labelled in sequences:
            result, samples = self.score_sequence(labelled, get, settings, estimate.name)
            about = {**self._about(None, labelled, settings), "method": estimate.name}
            said = (*notes, *self._notes_on(labelled))
            record = ResultRecord(**about, metrics=result.metrics, reasons=result.reasons, notes=said)
            runs.append(ImageRun(record, result, tuple(samples)))
        return self.show(runs, (), None)

    def _about(self, split: SplitRecipe | None, labelled: LabelledSequence, settings: Any) -> dict[str, Any]:
        about = about_sequence(self.name, split, labelled.name, labelled.digest, settings.as_dict(), self.evaluator)
        return {**about, "conditions": labelled.conditions}

    def show(self, runs: Sequence[ImageRun], sequences: Sequence[RunSequence], out: Path | None) -> Evaluation:
        """Show the results over the whole data set, and by sequence where there are several."""
        rows = self.dataset_rows(runs)
        records = [run.record for run in runs]
        several = len({record.sequence for record in records}) > 1
        first = dataset_tables(rows)
        lacking = [lacking_table(_lacking(runs))] if several and not rows else []
        if not several and rows:
            printed = [replace(first[0], notes=(*first[0].notes, *failures_and_notes(records))), *first[1:]]
        else:
            printed = shown_tables(records, [*lacking, *first])
        return Evaluation(runs, rows, lacking, printed, files={"images.csv": images_csv(runs)})


def _groups(runs: Sequence[ImageRun]) -> dict[str, dict[str, list[Any]]]:
    """Results by method and sequence."""
    groups: dict[str, dict[str, list[Any]]] = {}
    for run in runs:
        groups.setdefault(run.record.method, {}).setdefault(run.record.sequence, []).append(run.result)
    return groups


def _lacking(runs: Sequence[ImageRun]) -> dict[str, list[str]]:
    """Names of the sequences on which each method lacks a result, of the methods that lack one."""
    every = dict.fromkeys(run.record.sequence for run in runs)
    lacking = {
        method: [name for name in every if any(result is None for result in found.get(name, [None]))]
        for method, found in _groups(runs).items()
    }
    return {method: names for method, names in lacking.items() if names}


Predictor = Callable[[str, tuple[int, int]], Any]
"""Returns the prediction for an image, given its name and size (H, W), in the evaluator's type."""


def segmentation_of(prediction: Prediction, method: str) -> EstimateImage:
    """Check the prediction of a segmentation method and convert it. Raises MethodError where it is of another type."""
    if not isinstance(prediction, Segmentation):
        raise MethodError(f"method {method!r}: expected a Segmentation, got {type(prediction).__name__}")
    return EstimateImage(prediction.name, prediction.oyster, prediction.probability, prediction.classes)


def instances_of(prediction: Prediction, method: str, shape: tuple[int, int], threshold: float) -> ImageInstances:
    """Individual oysters of a prediction. In a mask, or in probabilities thresholded at `threshold`, each 8-connected
    component is one, scored by its mean probability, or 1 if there are no probabilities."""
    where = f"method {method!r} on {prediction.name}"
    if isinstance(prediction, Detections):
        return _detections(prediction, where, shape)
    estimate = segmentation_of(prediction, method)
    check_shape(estimate.shape, shape, where)
    numbers, means = connected_parts(estimate.mask(threshold), estimate.probability)
    scores = np.ones(numbers.max(initial=0)) if means is None else means
    return from_planes(prediction.name, numbers, scores=dict(enumerate(scores.tolist(), start=1)))


def _detections(prediction: Detections, where: str, shape: tuple[int, int]) -> ImageInstances:
    """Convert detections from untrusted arrays, checking sizes, types and ranges. Raises MethodError or LabelError."""
    name = prediction.name
    scores, live = (each.tolist() for each in checked_scores(prediction, where))
    given = [np.asarray(one) for one in (prediction.numbers, prediction.masks, prediction.boxes) if one is not None]
    if len(given) != 1:
        raise MethodError(f"{where}: expected one of numbers, masks and boxes, got {len(given)}")
    if prediction.numbers is not None:
        numbers = instance_numbers(given[0], where)
        check_shape(numbers.shape, shape, where)
        check_count(int(numbers.max(initial=0)), len(scores), where, at_most=True)
        by_number = (dict(enumerate(values, start=1)) for values in (scores, live))
        return from_planes(name, numbers, None, None, *by_number)
    found: list[Instance] = []
    if prediction.masks is not None:
        masks = as_mask(checked_masks(given[0], len(scores), shape, where), where)
        found = [from_mask(m, s, live=a) for m, s, a in zip(masks, scores, live, strict=True) if m.any()]
    else:
        each = zip(checked_boxes(given[0], len(scores), where).tolist(), scores, live, strict=True)
        found = [Instance((x, y, w, h), None, w * h, score, live=alive) for (x, y, w, h), score, alive in each]
    return ImageInstances(name, *shape, tuple(found))
