"""Scoring what was sent against the truth: what the limited process does that sees the truth.

What leaves it are metrics, and sentences out of a closed list: no message that was made with the truth in sight. Of a
hidden split the metrics that describe the truth itself are left out, and the others are rounded, as a hundred exact
errors of chosen estimates would tell where the truth lies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import LabelError, MethodError, TrajectoryError
from oysterbench.results.records import ResultRecord, plain
from oysterbench_leaderboard.submissions.bundle import Bundle
from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.evaluators import evaluator
from oysterbench_leaderboard.submissions.refusals import Refusal

UNANSWERED = "nothing was sent for this sequence"
NOT_SCORED = (
    "the path cannot be brought to the truth: too few of its poses are at times of the sequence, or its motion "
    "determines no alignment; `oysterbench eval` on a public split says which"
)
NOT_SCORED_IMAGES = "the answers cannot be held against the truth; `oysterbench eval` on a public split says why"
NO_VALUE = "has no value for this estimate on this sequence"

CAUSES = {
    "time-unit": "its stamps are in another unit than seconds or nanoseconds, as the layout of the file has them",
    "no-overlap": "it has no pose at the times of the sequence",
    "length-unit": "its positions are in another unit than metres",
    "quaternion-order": "its quaternions are in another order than x y z w",
    "frame": "its poses are not those of base_link",
    "turned": "its poses are not those of base_link",
    "swapped": "its axes are swapped",
}
"""Why a path is refused that `oysterbench eval` would refuse (`evaluate.diagnose`)."""

READ_AS = "it was read so that {} no longer holds"
"""Of a path that can be meant in one way only."""

OF_TRUTH = ("path_length_m", "cover", "count_truth", "density_truth_per_m2")
"""Metrics that say nothing of the estimate, and are left out of results on hidden splits."""

DIGITS = 4
"""Significant digits of metrics on hidden splits."""


@dataclass(frozen=True)
class Scored:
    """Results; what is known over all sequences together, for tracks that have such a thing; and what is drawn of
    paths, on public splits."""

    results: tuple[ResultRecord, ...]
    data_set: Any = None
    curves: Any = None


def score_bundle(
    bundle: Bundle, wanted: Wanted, truth: Mapping[str, Path], method: str, created: str, hidden: bool
) -> Scored:
    """The same bytes for the same input, whenever and wherever it is scored. created: of the submission, UTC."""
    common = {
        "track": wanted.track,
        "split": wanted.split,
        "split_digest": wanted.split_digest,
        "method": method,
        "hardware": {},
        "created": created,
    }
    if bundle.kind == "results":
        return Scored(tuple(_reported(record, wanted, method) for record in bundle.results))
    scored = {"poses": _score_poses, "answers": _score_answers, "commands": _score_commands}[bundle.kind](
        bundle, wanted, truth, common
    )
    if not hidden:
        return scored
    results = tuple(_discreet(record) for record in scored.results)
    return Scored(results, _rounded(scored.data_set))


def _reported(record: ResultRecord, wanted: Wanted, method: str) -> ResultRecord:
    """As its authors computed it; what the split is like says the server."""
    return replace(record, method=method, conditions=dict(wanted.conditions[record.sequence]))


# Paths:


def _score_poses(bundle: Bundle, wanted: Wanted, truth: Mapping[str, Path], common: dict[str, Any]) -> Scored:
    from oysterbench.evaluate.slam.scoring import SlamSettings, score
    from oysterbench.sequence import open_sequence
    from oysterbench.tracks.slam import truth_digest
    from oysterbench_leaderboard.curves import curves_document, sequence_curve

    version, settings = evaluator("slam")
    results = []
    curves = {}
    for sequence in wanted.sequences:
        true = open_sequence(truth[sequence]).truth()
        record = {
            **common,
            "sequence": sequence,
            "truth_digest": truth_digest(true),
            "conditions": wanted.conditions[sequence],
            "settings": settings,
            "evaluator_version": version,
        }
        read = bundle.poses.get(sequence)
        if read is None:
            results.append(ResultRecord(**record, failure=UNANSWERED))
            continue
        try:
            estimate, notes = _read_for(true, read)
            found = score(true, estimate, SlamSettings())
        except Refusal as refusal:
            results.append(ResultRecord(**record, failure=refusal.reason))
        except TrajectoryError:
            results.append(ResultRecord(**record, failure=NOT_SCORED))
        else:
            results.append(ResultRecord(**record, metrics=found.metrics, reasons=found.reasons, notes=tuple(notes)))
            if not wanted.hidden:
                curves[sequence] = sequence_curve(found, 0)
    return Scored(tuple(results), curves=curves_document(curves, settings["align"]) if curves else None)


def _read_for(truth: Any, read: Any) -> tuple[Any, list[str]]:
    """The path, read in the one way that makes sense of it, and what was decided. Raises Refusal where none does."""
    from oysterbench.evaluate.slam.diagnose import diagnose

    estimate = read()
    notes = list(estimate.notes)
    options: dict[str, Any] = {}
    for finding in diagnose(truth, estimate):
        cause = CAUSES.get(finding.cause, NOT_SCORED)
        if finding.severity == "refuse":
            raise Refusal("format", f"the path is refused: {cause}")
        if finding.severity == "certain":
            options |= finding.changes
            estimate = read(**options)
            notes.append(READ_AS.format(f"'{cause}'"))
    return replace(estimate, notes=()), list(dict.fromkeys(notes))


# Images:


def _score_answers(bundle: Bundle, wanted: Wanted, truth: Mapping[str, Path], common: dict[str, Any]) -> Scored:
    from oysterbench.annotations import labelled_sequence
    from oysterbench.report.images import ImageRun

    version, settings = evaluator(wanted.track)
    run = _segment if wanted.track == "segmentation" else _detect
    answered = bundle.answered(wanted)
    runs = []
    for sequence in wanted.sequences:
        clip = labelled_sequence(truth[sequence], wanted.conditions[sequence])
        record = {
            **common,
            "sequence": sequence,
            "truth_digest": clip.digest,
            "conditions": clip.conditions,
            "settings": settings,
            "evaluator_version": version,
        }
        if sequence not in answered:
            runs.append(ImageRun(ResultRecord(**record, failure=UNANSWERED, metrics=_missed(clip, wanted))))
            continue
        try:
            found = run(clip, bundle)
        except (LabelError, MethodError):
            runs.append(ImageRun(ResultRecord(**record, failure=NOT_SCORED_IMAGES, metrics=_missed(clip, wanted))))
        else:
            runs.append(ImageRun(ResultRecord(**record, metrics=found.metrics, reasons=found.reasons), found))
    return Scored(tuple(each.record for each in runs), _data_set(wanted.track, runs))


def _segment(clip: Any, bundle: Bundle) -> Any:
    from oysterbench.evaluate.segmentation import ClipScorer, SegmentationSettings

    scorer = ClipScorer(SegmentationSettings())
    for true, _ in clip.images():
        scorer.add(true, bundle.answers[true.name].mask())
    return scorer.result()


def _detect(clip: Any, bundle: Bundle) -> Any:
    from oysterbench.evaluate.detection import DetectionScorer, DetectionSettings

    scorer = DetectionScorer(DetectionSettings())
    for true, _ in clip.single():
        scorer.add(true, bundle.answers[true.name].instances((true.height, true.width)))
    return scorer.result()


def _missed(clip: Any, wanted: Wanted) -> dict[str, float]:
    """By what a clip that was not answered counts."""
    if wanted.track != "segmentation":
        return {}
    from oysterbench.evaluate.segmentation import SegmentationSettings
    from oysterbench.tracks.segmentation import all_missed

    return all_missed(clip, SegmentationSettings())


def _data_set(track: str, runs: list[Any]) -> Any:
    if track == "segmentation":
        from oysterbench.tracks.segmentation import dataset_rows
    else:
        from oysterbench.tracks.detection import dataset_rows
    rows = dataset_rows(runs)
    return plain(rows[0].as_plain()) if rows else None


# Commands at pictures:


def _score_commands(bundle: Bundle, wanted: Wanted, truth: Mapping[str, Path], common: dict[str, Any]) -> Scored:
    from oysterbench.evaluate.steering import Commands, Labels, score_pictures
    from oysterbench.exploration.labelled_views import labelled_views
    from oysterbench_leaderboard.submissions.commands import commands_of, task_of

    version, settings = evaluator(wanted.track)
    task = task_of(wanted.task)
    results: list[ResultRecord] = []
    parts: list[tuple[Labels, Commands]] = []
    for sequence in wanted.sequences:
        views = labelled_views(truth[sequence], task)
        record = {
            **common,
            "sequence": sequence,
            "truth_digest": views.digest,
            "conditions": wanted.conditions[sequence],
            "settings": settings,
            "evaluator_version": version,
        }
        read = bundle.commands.get(sequence)
        if read is None:
            results.append(ResultRecord(**record, failure=UNANSWERED))
            continue
        parts.append((views.labels, commands_of(read(), task)))
        found = score_pictures(*parts[-1])
        results.append(ResultRecord(**record, metrics=found.metrics, reasons=found.reasons))
    return Scored(tuple(results), _all_pictures(common["method"], parts) if len(parts) == len(results) else None)


def _all_pictures(method: str, parts: list[Any]) -> dict[str, Any]:
    """Over all pictures of all sequences together, in the words of other tracks."""
    from oysterbench.evaluate.steering.dataset import over_sequences

    whole = over_sequences(parts)
    intervals = {k: {"low": v.low, "high": v.high, "reason": v.reason} for k, v in whole.intervals.items()}
    known = {"metrics": whole.score.metrics, "reasons": whole.score.reasons, "intervals": intervals}
    found: dict[str, Any] = plain({"method": method, "clips": whole.sequences, **known})
    return found


# What leaves of a hidden split:


def _discreet(record: ResultRecord) -> ResultRecord:
    """With the metrics that speak of the estimate, rounded, and no sentence that was made in sight of the truth."""
    metrics = {key: significant(value) for key, value in record.metrics.items() if key not in OF_TRUTH}
    reasons = {key: NO_VALUE for key, value in metrics.items() if math.isnan(value)}
    return replace(record, metrics=metrics, reasons=reasons)


def significant(value: float) -> float:
    """A number to DIGITS significant digits; whole numbers, such as counts, as they are."""
    if not math.isfinite(value) or value == 0 or float(value).is_integer():
        return float(value)
    return float(f"{value:.{DIGITS}g}")


def _rounded(value: Any) -> Any:
    """The same of what is known over all sequences together."""
    if not isinstance(value, dict):
        return value
    metrics = {k: None if v is None else significant(v) for k, v in value["metrics"].items() if k not in OF_TRUTH}
    intervals = {
        key: {k: significant(v) if isinstance(v, float) else None for k, v in found.items() if k != "reason"}
        | {"reason": NO_VALUE if found["reason"] else ""}
        for key, found in value["intervals"].items()
        if key not in OF_TRUTH
    }
    reasons = {key: NO_VALUE for key, number in metrics.items() if number is None}
    return {**value, "metrics": metrics, "reasons": reasons, "intervals": intervals}
