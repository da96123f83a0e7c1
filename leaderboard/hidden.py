"""What is published of results on a hidden split: what a board needs, and no more, as a hundred exact numbers of chosen
predictions would tell where the truth lies.

Of each sequence the metric that ranks, the share that was answered, and what the ranking weighs it by, in steps that
one image or pose does not move; of the other columns of the board the means over the split.
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
from oysterbench_leaderboard.record_summary import means_over_sequences

STEP = 0.01
"""Of shares of a sequence, its score among them."""

LEAST = -1.0
"""Least score that is told: a skill below it is as bad as that."""

DIGITS = {"sequence": 2, "split": 3}
"""Significant digits of what is no share of a sequence, and of medians; of means over the split."""

COSTS = ("wall_s", "cpu_s", "cpu_s_per_s", "realtime_factor", "peak_memory_mb", "images_per_s", "pictures_per_s")
"""Metrics of the run and not of its estimate: they stay as they were measured, and say nothing of the truth."""

NO_VALUE = "has no value for this estimate on this sequence"


def significant(value: float, digits: int) -> float:
    """A finite number to some significant digits, 0 where it is below 1e-6."""
    return float(f"{value:.{digits}g}") if abs(value) >= 1e-6 else 0.0


def is_hidden(split: str) -> bool:
    """Whether a split, by its name or recipe, is a hidden one of this version."""
    try:
        return load_split(split).hidden
    except RecipeError:
        return False


def discreet(
    results: Sequence[ResultRecord], data_set: Mapping[str, Any] | None = None
) -> tuple[list[ResultRecord], dict[str, Any]]:
    """Results of one method on a hidden split as they may be seen, and what is known over all sequences together: the
    `metrics` of the data set that rank, where it has them, and the `means` of the board's other columns."""
    track = TRACKS[results[0].track]
    means = means_over_sequences(results, track.standing)
    value = (data_set or {}).get("metrics", {}).get(track.ranking)
    whole = {} if value is None or math.isnan(value) else {track.ranking: significant(value, DIGITS["split"])}
    return [_coarse(result) for result in results], {
        "method": results[0].method,
        "metrics": whole,
        "means": {
            # A median is what one sequence has.
            key: None if mean is None else significant(mean, DIGITS["sequence" if key in track.errors else "split"])
            for key, mean in means.items()
        },
    }


def _coarse(result: ResultRecord) -> ResultRecord:
    ranking, metrics = PRIMARY[result.track], result.metrics
    kept = {key: _rounded(key, result.track, metrics[key]) for key in (ranking, "coverage") if key in metrics}
    if {"truth_px", "estimate_px", ranking} <= metrics.keys():
        # The union as it follows from what is told: whoever knows the estimate learns nothing more from it.
        kept["truth_px"] = significant(metrics["truth_px"], DIGITS["sequence"])
        union = (kept["truth_px"] + metrics["estimate_px"]) / (1.0 + kept[ranking])
        kept["union_px"] = significant(union, DIGITS["split"])
    kept |= {key: metrics[key] for key in COSTS if key in metrics}
    reasons = {key: result.reasons[key] if key in COSTS else NO_VALUE for key, v in kept.items() if math.isnan(v)}
    return replace(result, metrics=kept, reasons=reasons)


def _rounded(key: str, track: str, value: float) -> float:
    metric = find_metric(key, track)
    if math.isnan(value):
        return value
    if metric is not None and not metric.unit:
        return max(LEAST, round(round(value / STEP) * STEP, 6))
    return significant(value, DIGITS["sequence"])
