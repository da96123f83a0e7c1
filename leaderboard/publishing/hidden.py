"""What is published of results on a hidden split: only what a board needs, because a hundred exact numbers for chosen
predictions would reveal the ground truth.

For each sequence: the ranking metric, the coverage, and the weight in the ranking, in steps that a single image or pose
does not change; for the other columns of the board: the means over the split.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from oysterbench.core.errors import RecipeError
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.recipe import load_split
from oysterbench.results.records import ResultRecord
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.storage.record_summary import means_over_sequences

STEP = 0.01
"""Step of dimensionless values of a sequence, such as shares and its score."""

LEAST = -1.0
"""Lowest score that is published: a lower skill is reported as this."""

DIGITS = {"sequence": 2, "split": 3}
"""Significant digits: "sequence" of values of a sequence with a unit, and of medians; "split" of means over the
split."""

COSTS = ("wall_s", "cpu_s", "cpu_s_per_s", "realtime_factor", "peak_memory_mb", "images_per_s", "pictures_per_s")
"""Metrics of the run, not of its estimate: published as measured, as they reveal nothing of the ground truth."""

DECIMALS = 3
"""Decimals of dimensionless values over the split: digits of a small one, that of an answer to a few images, would tell
what is right of it."""

LEAST_ESTIMATE = 0.1
"""Pixels of all masks, as a share of the true ones, from which on what is relative to the former (precision) is
published: of a few chosen pixels it would tell which are right."""

ABOUT = ("method", "run")
"""What of `info` is published: about the method and its run."""

FAILED = "failed, or left no estimate that can be scored"

NO_VALUE = "has no value for this estimate on this sequence"


def significant(value: float, digits: int) -> float:
    """Round a finite number to `digits` significant digits; 0 where its magnitude is below 1e-6."""
    return float(f"{value:.{digits}g}") if abs(value) >= 1e-6 else 0.0


def is_hidden(results: Sequence[ResultRecord], recipe: str | None = None) -> bool | None:
    """Whether results of one split are of a hidden one, by what they or its recipe say; None where neither is known.

    recipe: name or .toml file, by default the name in the results
    """
    try:
        known = load_split(recipe or results[0].split).hidden
    except RecipeError:
        known = None
    said = {known, *(result.hidden for result in results)}
    return True if True in said else None if said == {None} else False


def discreet(
    results: Sequence[ResultRecord], data_set: Mapping[str, Any] | None = None, judged: bool = False
) -> tuple[list[ResultRecord], dict[str, Any]]:
    """Results of one method on a hidden split, reduced to what may be published, and what is known over all sequences
    together: in `metrics` the ranking metric of the data set, if there is one, and `means` of the other columns.

    judged: the sandbox scored them, whose sentences say nothing of the ground truth.
    """
    name = results[0].track
    track, few = TRACKS[name], _has_few_pixels(results)
    means = means_over_sequences(results, track.standing)
    value = (data_set or {}).get("metrics", {}).get(track.ranking)
    whole = {} if value is None or math.isnan(value) else {track.ranking: over_split(track.ranking, name, value)}
    return [_coarse(result, judged) for result in results], {
        "method": results[0].method,
        "metrics": whole,
        "means": {
            key: None if mean is None or (few and _is_of_estimate(key, name)) else over_split(key, name, mean)
            for key, mean in means.items()
        },
    }


def over_split(key: str, track: str, value: float) -> float:
    """Value over the split as it is published: rounded; one that is rounded already stays as it is."""
    # A median is the value of a single sequence.
    rounded = significant(value, DIGITS["sequence" if key in TRACKS[track].errors else "split"])
    metric = find_metric(key, track)
    return rounded if key in COSTS or metric is None or metric.unit else round(rounded, DECIMALS)


def _is_of_estimate(key: str, track: str) -> bool:
    metric = find_metric(key, track)
    return metric is not None and metric.weight == "estimate_px"


def _has_few_pixels(results: Sequence[ResultRecord]) -> bool:
    estimate, truth = (math.fsum(one.metrics.get(key, 0.0) for one in results) for key in ("estimate_px", "truth_px"))
    return estimate < LEAST_ESTIMATE * truth


def _coarse(result: ResultRecord, judged: bool) -> ResultRecord:
    ranking, metrics = PRIMARY[result.track], result.metrics
    kept = {key: _rounded(key, result.track, metrics[key]) for key in (ranking, "coverage") if key in metrics}
    if {"truth_px", "union_px"} <= metrics.keys() and "estimate_px" not in metrics:  # reduced already
        kept["truth_px"] = significant(metrics["truth_px"], DIGITS["sequence"])
        kept["union_px"] = significant(metrics["union_px"], DIGITS["split"])
    elif {"truth_px", "estimate_px", ranking} <= metrics.keys():
        # The union as implied by the published values: it reveals nothing more to one who knows the estimate.
        kept["truth_px"] = significant(metrics["truth_px"], DIGITS["sequence"])
        union = (kept["truth_px"] + metrics["estimate_px"]) / (1.0 + kept[ranking])
        kept["union_px"] = significant(union, DIGITS["split"])
    kept |= {key: metrics[key] for key in COSTS if key in metrics}
    reasons = {key: result.reasons[key] if key in COSTS else NO_VALUE for key, v in kept.items() if math.isnan(v)}
    # Without the hash of the ground truth, against which guesses could be tested offline, one sequence at a time.
    result = replace(result, metrics=kept, reasons=reasons, truth_digest="")
    if judged:
        return result
    # Notes, and what the evaluation adds to `info`, have exact errors of the estimate and of the method's other paths.
    info = {key: result.info[key] for key in ABOUT if key in result.info}
    return replace(result, failure=result.failure and FAILED, notes=(), info=info)


def _rounded(key: str, track: str, value: float) -> float:
    metric = find_metric(key, track)
    if math.isnan(value):
        return value
    if metric is not None and not metric.unit:
        return max(LEAST, round(round(value / STEP) * STEP, 6))
    return significant(value, DIGITS["sequence"])
