"""Scoring the oysters of a clip, and of a data set of clips."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array
from oysterbench.evaluate.detection.counting import ImageCount, count, count_metrics
from oysterbench.evaluate.detection.instances import ImageInstances, mask_tools, numpy_2
from oysterbench.evaluate.detection.matching import Matches, match
from oysterbench.evaluate.detection.panoptic import PanopticCounts, pair
from oysterbench.evaluate.detection.precision import PrecisionCurve, average_precision
from oysterbench.evaluate.detection.precision import join as join_matches
from oysterbench.evaluate.detection.settings import DetectionSettings
from oysterbench.evaluate.detection.states import STATE_METRICS, StateCounts, state_metrics, states_of
from oysterbench.evaluate.runs import sum_as_of_one_run, times_of
from oysterbench.evaluate.statistics import Interval, resample_counts, resampled_interval, too_few

NO_TRUTH = "the ground truth has no such oyster"
NO_MASKS = "the ground truth has boxes, and no masks"
NOTHING = "there is neither a true nor an estimated oyster"
NO_MATCH = "no estimate matches an oyster"
RESAMPLES = 1000  # for the interval of AP: each needs a curve of its own
TOTALS = ("images", "count_truth", "count_estimate", "count_error", "live_error")
"""Metrics that are sums over images."""


@dataclass(frozen=True)
class DetectionClip:
    """Result of scoring a clip: metrics by keys of `DETECTION`, NaN with a reason; and what they are computed from.

    matches: by kind ("box", "mask") and the names of `matching.AREAS`; curve: precision (101,) of masks, or of boxes
    if there are no masks, at the overlap 0.5 and the recalls of `precision.RECALLS`
    """

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]
    matches: Mapping[str, Mapping[str, Matches]]
    counts: tuple[ImageCount, ...]
    panoptic: PanopticCounts | None
    states: StateCounts | None
    curve: Array
    settings: DetectionSettings


class DetectionScorer:
    """Scorer that takes the images of a clip one by one; it keeps run lengths and numbers, but no pixels."""

    def __init__(self, settings: DetectionSettings | None = None) -> None:
        self.settings = settings or DetectionSettings()
        self._truths: list[ImageInstances] = []
        self._estimates: list[ImageInstances] = []

    def add(self, truth: ImageInstances, estimate: ImageInstances) -> None:
        """Add an image. Raises LabelError if the two are not of the same image and size, or scores are not finite."""
        if truth.name != estimate.name:
            raise LabelError(f"expected the estimate of image {truth.name}, got that of {estimate.name}")
        if (truth.height, truth.width) != (estimate.height, estimate.width):
            raise LabelError(
                f"{truth.name}: expected an estimate of the truth's size, {truth.width} x {truth.height}, got "
                f"{estimate.width} x {estimate.height}"
            )
        for k, one in enumerate(estimate.instances):
            if not math.isfinite(one.score):
                raise LabelError(f"{truth.name}: instance {k}: expected a score, got {one.score}")
        self._truths.append(truth)
        self._estimates.append(estimate)

    def result(self) -> DetectionClip:
        """Return the result over all images so far. Raises LabelError if there is none."""
        if not self._truths:
            raise LabelError("expected at least one image to score, got none")
        masks = all(one.mask is not None for image in self._truths for one in image.instances)
        threshold, most = self.settings.threshold, self.settings.max_detections
        matches: dict[str, Mapping[str, Matches]] = {}
        pairings = None
        if masks:
            masked = [_with_masks(image) for image in self._estimates]
            matches["mask"] = match(self._truths, masked, "mask", most)
            pairings = [pair(*image, threshold) for image in zip(self._truths, masked, strict=True)]
        matches["box"] = match(self._truths, self._estimates, "box", most)
        images = zip(self._truths, self._estimates, strict=True)
        return finish(
            matches,
            tuple(count(*image, threshold) for image in images),
            None if pairings is None else sum((one.counts for one in pairings), PanopticCounts()),
            None if pairings is None else sum(map(states_of, pairings), StateCounts()),
            self.settings,
        )


def _with_masks(estimate: ImageInstances) -> ImageInstances:
    """Give detections without a mask an empty one, which overlaps nothing. Were masks not scored instead, one box would
    take a whole clip out of a method's mean."""
    if all(one.mask is not None for one in estimate.instances):
        return estimate
    tools = mask_tools()
    with numpy_2():
        empty = tools.encode(np.zeros((estimate.height, estimate.width), dtype=np.uint8, order="F"))
    found = (one if one.mask is not None else replace(one, mask=empty) for one in estimate.instances)
    return replace(estimate, instances=tuple(found))


def finish(
    matches: Mapping[str, Mapping[str, Matches]],
    counts: tuple[ImageCount, ...],
    quality: PanopticCounts | None,
    states: StateCounts | None,
    settings: DetectionSettings,
    uneven: tuple[Sequence[DetectionClip], Sequence[int]] | None = None,
) -> DetectionClip:
    """Compute the result from matches and counts. uneven: the clips that these are of, and how often each counts; by
    default all count alike."""
    metrics: dict[str, float] = {}
    reasons: dict[str, str] = {}
    curve = np.full(101, np.nan)
    for kind in ("mask", "box"):
        if kind not in matches:
            missing = [*(f"ap{part}_{kind}" for part in ("", "50", "75", "_small", "_medium", "_large")), f"ar_{kind}"]
            metrics |= dict.fromkeys(missing, math.nan)
            reasons |= dict.fromkeys(missing, NO_MASKS)
            continue
        for area, found in matches[kind].items():
            if uneven is None:
                precision, recall = PrecisionCurve([found]).at()
            else:
                parts, times = [clip.matches[kind][area] for clip in uneven[0]], np.array(uneven[1], dtype=float)
                precision, recall = PrecisionCurve(parts).at(times)
            if area == "all":
                metrics[f"ap_{kind}"] = average_precision(precision)
                metrics[f"ap50_{kind}"] = average_precision(precision, 0.5)
                metrics[f"ap75_{kind}"] = average_precision(precision, 0.75)
                metrics[f"ar_{kind}"] = float(recall.mean())
                curve = precision[0] if np.isnan(curve).all() else curve
            else:
                metrics[f"ap_{area}_{kind}"] = average_precision(precision)
    for key, value in metrics.items():
        if math.isnan(value):
            reasons.setdefault(key, NO_TRUTH)
    of_counts, why = count_metrics(counts, None if uneven is None else _for_each_image(*uneven))
    names = ("pq", "sq", "rq")
    values = quality.quality if quality is not None else (math.nan,) * 3
    for key, value in zip(names, values, strict=True):
        if math.isnan(value):
            why[key] = NO_MASKS if quality is None else NO_MATCH if key == "sq" and values[0] == 0 else NOTHING
    if states is None:
        of_states, untold = dict.fromkeys(STATE_METRICS, math.nan), dict.fromkeys(STATE_METRICS, NO_MASKS)
    else:
        of_states, untold = state_metrics(states)
    metrics |= {**dict(zip(names, values, strict=True)), **of_counts, **of_states, "images": float(len(counts))}
    return DetectionClip(metrics, {**reasons, **why, **untold}, matches, counts, quality, states, curve, settings)


def _for_each_image(clips: Sequence[DetectionClip], times: Sequence[int]) -> Array:
    return np.repeat(np.array(times, dtype=float), [len(clip.counts) for clip in clips])


def join(clips: Sequence[DetectionClip], times: Sequence[int] | None = None) -> DetectionClip:
    """Compute the result over all images of several clips, or of several runs on one. times: how often each clip counts
    in metrics that are no sums over images; None: once."""
    if len(clips) == 1:
        return clips[0]
    kinds = [kind for kind in ("mask", "box") if all(kind in clip.matches for clip in clips)]
    matches = {
        kind: {area: join_matches([clip.matches[kind][area] for clip in clips]) for area in clips[0].matches[kind]}
        for kind in kinds
    }
    often = times or (1,) * len(clips)
    parts = [clip.panoptic * n for clip, n in zip(clips, often, strict=True) if clip.panoptic is not None]
    quality = sum(parts, PanopticCounts()) if len(parts) == len(clips) else None
    told = [clip.states * n for clip, n in zip(clips, often, strict=True) if clip.states is not None]
    states = sum(told, StateCounts()) if len(told) == len(clips) else None
    counts = tuple(one for clip in clips for one in clip.counts)
    return finish(matches, counts, quality, states, clips[0].settings, None if times is None else (clips, times))


def over_clips(
    clips: Sequence[DetectionClip], runs: Sequence[int] | None = None
) -> tuple[DetectionClip, dict[str, Interval]]:
    """Compute the result over all clips, and intervals of AP, panoptic quality and counts by resampling clips, each
    with all its images. runs: (C,) number of runs joined in each clip, None for one: each clip counts as often as
    any other, and totals over images are as of one run."""
    times = times_of(runs, len(clips))
    whole = join(clips)
    if set(times) != {1}:
        even = join(clips, times)
        whole = replace(whole, metrics=even.metrics, reasons=even.reasons, curve=even.curve)
    totals = {key: sum_as_of_one_run([clip.metrics[key] for clip in clips], runs) for key in TOTALS}
    whole = replace(whole, metrics={**whole.metrics, **totals})
    kinds = whole.matches
    parts = [clip.panoptic for clip in clips if clip.panoptic is not None]
    often = np.array(times)
    intervals = {f"ap_{kind}": _interval([clip.matches[kind]["all"] for clip in clips], often) for kind in kinds}
    counts = _count_intervals([clip.counts for clip in clips], often)
    return whole, {**intervals, **counts, **_quality_interval(parts, clips, often)}


def _interval(clips: Sequence[Matches], often: Array) -> Interval:
    drawn = resample_counts(len(clips))
    if drawn is None:
        return Interval(math.nan, math.nan, too_few(len(clips)))
    curve = PrecisionCurve(clips)
    values = np.array([average_precision(curve.at(times * often)[0]) for times in drawn[:RESAMPLES]])
    return resampled_interval(values, len(clips))


def _count_intervals(clips: Sequence[tuple[ImageCount, ...]], often: Array) -> dict[str, Interval]:
    """Intervals of the mean over images of the error in the number of oysters, and of its absolute value."""
    errors = [np.array([one.error for one in counts], dtype=float) for counts in clips]
    sums = np.array([[len(of), of.sum(), np.abs(of).sum()] for of in errors]) * often[:, None]
    return {key: _ratio_interval(sums[:, column], sums[:, 0]) for key, column in (("count_bias", 1), ("count_mae", 2))}


def _quality_interval(
    parts: Sequence[PanopticCounts], clips: Sequence[DetectionClip], often: Array
) -> dict[str, Interval]:
    if len(parts) < len(clips):
        return {}
    overlap = np.array([part.overlap for part in parts])
    whole = np.array([part.matched + 0.5 * (part.extra + part.missed) for part in parts])
    return {"pq": _ratio_interval(often * overlap, often * whole)}


def _ratio_interval(over: Array, under: Array) -> Interval:
    """Interval of the sum of `over` divided by that of `under`, each (C,), one value per clip."""
    drawn = resample_counts(len(over))
    if drawn is None:
        return Interval(math.nan, math.nan, too_few(len(over)))
    total = drawn @ under
    values = np.where(total > 0, drawn @ over / np.where(total > 0, total, 1), math.nan)
    return resampled_interval(values, len(over))
