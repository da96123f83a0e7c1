"""Scoring of predictions against the ground truth, in a sandbox that has access to it.

Only metrics, and sentences from a closed list, leave the sandbox: no message made with knowledge of the ground truth.
For a hidden split only a few metrics leave, and coarsely rounded ones (`hidden.discreet`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import LabelError, MethodError, TrajectoryError
from oysterbench.results.records import ResultRecord, plain
from oysterbench.tracks import TRACKS
from oysterbench_leaderboard.publishing.folders import without_folders
from oysterbench_leaderboard.publishing.hidden import discreet
from oysterbench_leaderboard.submissions.catalogue import SCORED, Kind, Wanted, why
from oysterbench_leaderboard.submissions.reading.predictions import Predictions, Reader, image_track
from oysterbench_leaderboard.submissions.reading.refusals import Refusal

MISSING = "no estimate was sent for this sequence"
NOT_SCORED: dict[Kind, str] = {
    "poses": "the path cannot be aligned with the ground truth: too few of its poses are at times of the sequence, or "
    "its motion determines no alignment; `oysterbench eval` on a public split says which",
    "predictions": "the predictions cannot be compared with the ground truth; `oysterbench eval` on a public split "
    "says why",
    "commands": "the commands cannot be compared with the ground truth",
}

CAUSES = {
    "time-unit": "its timestamps are not in the unit of its file layout (seconds or nanoseconds)",
    "no-overlap": "it has no pose at the times of the sequence",
    "length-unit": "its positions are not in metres",
    "quaternion-order": "its quaternions are not in the order x y z w",
    "frame": "its poses are not those of base_link",
    "turned": "its poses are not those of base_link",
    "inverted": "its poses take points of the world into the body, not of the body into the world",
}
"""Cause of a finding -> sentence on a path that `oysterbench eval` would refuse (`evaluate.diagnose`)."""

READ_AS = "it was read so that {} no longer holds"
"""Note on a path that has only one possible interpretation."""


def evaluator(track: str) -> tuple[str, dict[str, Any]]:
    """Name and version of a track's evaluator, and its settings: those that boards rank by. Raises Refusal for a track
    that cannot be submitted."""
    if track not in SCORED:
        raise Refusal("split", f"the track {track!r:.60} cannot be submitted{why(track)}")
    settings = TRACKS[track].settings({})
    return TRACKS[track].evaluator, {} if settings is None else settings.as_dict()


@dataclass(frozen=True)
class Scored:
    """Results; what is computed over all sequences together, for tracks that have it; and, for paths on public splits,
    the curves to be drawn."""

    results: tuple[ResultRecord, ...]
    data_set: Any = None
    curves: Any = None


@dataclass(frozen=True)
class Found:
    """Score of a sequence's predictions, as in `ResultRecord`."""

    metrics: Mapping[str, float]
    reasons: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class Scorer(ABC):
    """Scorer of one kind of predictions, over the sequences of a split one after the other."""

    def __init__(self, wanted: Wanted, method: str) -> None:
        self.wanted, self.method = wanted, method

    @abstractmethod
    def open(self, path: Path, sequence: str) -> str:
        """Open a sequence's ground truth, for the next call of `score`; return its digest."""

    @abstractmethod
    def score(self, readers: Mapping[str, Reader]) -> Found:
        """Compare the predictions with the ground truth. Raises Refusal, TrajectoryError, LabelError, MethodError."""

    def failed(self) -> Mapping[str, float]:
        """Metrics with which a sequence that could not be scored counts."""
        return {}

    @abstractmethod
    def whole(self, results: tuple[ResultRecord, ...]) -> Scored:
        """Results together with what is computed over all sequences."""


def score_predictions(
    predictions: Predictions, wanted: Wanted, truth: Mapping[str, Path], method: str, created: str
) -> Scored:
    """Score predictions; deterministic: the same input gives the same bytes, whenever and wherever it is scored.

    created: when the submission was made, UTC
    """
    if predictions.kind == "results":
        return _reported(predictions.results, wanted, truth, method)
    version, settings = evaluator(wanted.track)
    common: dict[str, Any] = {
        "track": wanted.track,
        "split": wanted.split,
        "split_digest": wanted.split_digest,
        "hidden": wanted.hidden,
        "method": method,
        "hardware": {},
        "created": created,
        "settings": settings,
        "evaluator_version": version,
    }
    scorer = SCORERS[predictions.kind](wanted, method)
    given = predictions.sequences(wanted)
    results = []
    for sequence in wanted.sequences:
        digest = scorer.open(truth[sequence], sequence)
        about = {**common, "sequence": sequence, "truth_digest": digest, "conditions": wanted.conditions[sequence]}
        try:
            if sequence not in given:
                raise Refusal("absent", MISSING)
            found = scorer.score(predictions.readers)
            results.append(
                ResultRecord(**about, metrics=found.metrics, reasons=found.reasons, notes=tuple(found.notes))
            )
        except (Refusal, TrajectoryError, LabelError, MethodError) as error:
            failure = error.reason if isinstance(error, Refusal) else NOT_SCORED[predictions.kind]
            results.append(ResultRecord(**about, failure=failure, metrics=scorer.failed()))
    scored = scorer.whole(tuple(results))
    if not wanted.hidden:
        return scored
    told, over_split = discreet(scored.results, scored.data_set, judged=True)
    return Scored(tuple(told), over_split)


def _reported(results: Sequence[ResultRecord], wanted: Wanted, truth: Mapping[str, Path], method: str) -> Scored:
    """Results as their authors computed them, with what the server knows of the split: conditions, and whether it is
    hidden. Raises Refusal where they were computed against another ground truth than the server's."""
    scorer = SCORERS[wanted.kind](wanted, method)
    digests = {name: scorer.open(truth[name], name) for name in {one.sequence for one in results} & truth.keys()}
    for one in results:
        if one.truth_digest != digests.get(one.sequence, one.truth_digest):
            raise Refusal(
                "format", f"{one.sequence}: the results were computed against a ground truth other than the split's"
            )
    told = [without_folders(one) for one in results]  # with the method's own name for it, by which its output is named
    known = [(one, dict(wanted.conditions[one.sequence])) for one in told]
    return Scored(tuple(replace(one, method=method, hidden=wanted.hidden, conditions=like) for one, like in known))


class PathScorer(Scorer):
    """Scorer of the track slam."""

    def __init__(self, wanted: Wanted, method: str) -> None:
        super().__init__(wanted, method)
        self._curves: dict[str, Any] = {}

    def open(self, path: Path, sequence: str) -> str:
        from oysterbench.sequence import open_sequence
        from oysterbench.tracks.slam_truth import truth_digest

        self._truth, self._sequence = open_sequence(path).truth(), sequence
        return truth_digest(self._truth)

    def score(self, readers: Mapping[str, Reader]) -> Found:
        from oysterbench.evaluate.slam.scoring import score
        from oysterbench_leaderboard.storage.curves import sequence_curve

        estimate, notes = self._read(readers[self._sequence])
        found = score(self._truth, estimate, TRACKS[self.wanted.track].settings({}))
        if not self.wanted.hidden:
            self._curves[self._sequence] = sequence_curve(found, 0)
        return Found(found.metrics, found.reasons, notes)

    def _read(self, read: Reader) -> tuple[Any, tuple[str, ...]]:
        """Read the path in its only possible interpretation; return it with notes on what was decided. Raises Refusal
        where it has none."""
        from oysterbench.evaluate.slam.diagnose import diagnose

        estimate = read()
        notes = list(estimate.notes)
        options: dict[str, Any] = {}
        for finding in diagnose(self._truth, estimate):
            cause = CAUSES.get(finding.cause, NOT_SCORED["poses"])
            if finding.severity == "refuse":
                raise Refusal("format", f"the path is refused: {cause}")
            if finding.severity == "certain":
                options |= finding.changes
                estimate = read(**options)
                notes.append(READ_AS.format(f"'{cause}'"))
        return replace(estimate, notes=()), tuple(dict.fromkeys(notes))

    def whole(self, results: tuple[ResultRecord, ...]) -> Scored:
        from oysterbench_leaderboard.storage.curves import curves_document

        align = results[0].settings["align"]
        return Scored(results, curves=curves_document(self._curves, align) if self._curves else None)


class ImageScorer(Scorer):
    """Scorer of the tracks segmentation and detection."""

    def __init__(self, wanted: Wanted, method: str) -> None:
        super().__init__(wanted, method)
        self._track = image_track(wanted.track)
        self._settings = self._track.settings({})
        self._scores: dict[str, Any] = {}

    def open(self, path: Path, sequence: str) -> str:
        from oysterbench.annotations import labelled_sequence

        self._labelled = labelled_sequence(path, self.wanted.conditions[sequence])
        self._sequence = sequence
        return self._labelled.digest

    def score(self, readers: Mapping[str, Reader]) -> Found:
        def get(name: str, shape: tuple[int, int]) -> Any:
            return readers[name]()

        found, _ = self._track.score_sequence(self._labelled, get, self._settings, self.method, samples_wanted=0)
        self._scores[self._sequence] = found
        return Found(found.metrics, found.reasons)

    def failed(self) -> Mapping[str, float]:
        return self._track.failed_metrics(self._labelled, self._settings)

    def whole(self, results: tuple[ResultRecord, ...]) -> Scored:
        from oysterbench.report.images import ImageRun

        rows = self._track.dataset_rows([ImageRun(record, self._scores.get(record.sequence)) for record in results])
        return Scored(results, plain(rows[0].as_plain()) if rows else None)


class CommandScorer(Scorer):
    """Scorer of the track steering, at labelled images."""

    def __init__(self, wanted: Wanted, method: str) -> None:
        super().__init__(wanted, method)
        assert wanted.task is not None, wanted.split
        self._task = wanted.task
        self._parts: list[Any] = []

    def open(self, path: Path, sequence: str) -> str:
        from oysterbench.exploration.labelled_views import labelled_views

        self._views, self._sequence = labelled_views(path, self._task), sequence
        return self._views.digest

    def score(self, readers: Mapping[str, Reader]) -> Found:
        from oysterbench.evaluate.steering import Commands, score_pictures
        from oysterbench.methods.interfaces.steering import command_arrays

        commands = Commands(*command_arrays(readers[self._sequence](), self._task))
        self._parts.append((self._views.labels, commands))
        found = score_pictures(*self._parts[-1])
        return Found(found.metrics, found.reasons)

    def failed(self) -> Mapping[str, float]:
        from oysterbench.evaluate.steering import failed_metrics

        return failed_metrics(self._views.labels)

    def whole(self, results: tuple[ResultRecord, ...]) -> Scored:
        from oysterbench.evaluate.steering.dataset import over_sequences

        if len(self._parts) < len(results):
            return Scored(results)
        whole = over_sequences(self._parts)
        intervals = {k: {"low": v.low, "high": v.high, "reason": v.reason} for k, v in whole.intervals.items()}
        known = {"metrics": whole.score.metrics, "reasons": whole.score.reasons, "intervals": intervals}
        return Scored(results, plain({"method": self.method, "clips": whole.sequences, **known}))


SCORERS: dict[Kind, type[Scorer]] = {
    "poses": PathScorer,
    "predictions": ImageScorer,
    "commands": CommandScorer,
}
"""Kind of predictions -> its scorer."""
