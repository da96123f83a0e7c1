"""Scoring of closed-loop rollouts, and comparison of policies over the same reefs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.evaluate.statistics import (
    Interval,
    Sample,
    resample_counts,
    resampled_interval,
    sequence_means,
    too_few,
)
from oysterbench.evaluate.steering.log import RolloutLog
from oysterbench.evaluate.values import Measures, Score
from oysterbench.recipe.steering import SteeringRecipe


@dataclass(frozen=True)
class NormalisedScore:
    """Score of a policy relative to two others: 0 if it is as good as the lower, 1 as the upper; it may lie beyond.

    NaN, with the reason, if the upper is not above the lower.
    """

    value: float
    interval: Interval
    reefs: int
    reason: str = ""


def score_rollout(log: RolloutLog, task: SteeringRecipe) -> Score:
    """Score a rollout: values by keys of `metrics.ROLLOUTS`."""
    measures = Measures()
    steps = len(log.commands)
    minutes = steps * log.step_s / 60.0
    none_done, not_moved = "no command was carried out", "the vehicle did not move"
    seen = int(log.seen.sum())
    contacts = episodes(log.contact)
    after = log.altitude[1:]
    low, high = task.altitude_m
    path_length_m = float(np.linalg.norm(np.diff(log.states[:, :3], axis=0), axis=1).sum())
    measures.ratio("oysters_per_min", seen, minutes, none_done)
    measures["oysters_seen"] = float(seen)
    measures.ratio("found_share", float(log.found.sum()), len(log.found), "no live oyster is in the area")
    measures["covered_share"] = float(log.covered[-1])
    measures["contacts"] = float(contacts)
    measures.ratio("contacts_per_min", contacts, minutes, none_done)
    measures.ratio("contact_share", float(log.contact[1:].sum()), steps, none_done)
    measures.ratio("in_band_share", float(((after >= low) & (after <= high)).sum()), steps, none_done)
    measures["turned_back"] = float(episodes(log.turned))
    measures["distance_m"] = path_length_m
    measures.ratio("oysters_per_m", seen, path_length_m, not_moved)
    measures.ratio("steps_per_s", steps, log.wall_s, "no time was measured")
    measures["rollout_s"] = steps * log.step_s
    measures["wall_s"], measures["cpu_s"] = float(log.wall_s), float(log.cpu_s)
    return Score(measures.values, measures.reasons)


def episodes(marked: NDArray[np.bool_]) -> int:
    """Number of runs of consecutive True in (N,)."""
    return int((np.diff(np.concatenate([[False], marked]).astype(int)) == 1).sum())


def seen_so_far(log: RolloutLog) -> tuple[Array, Array]:
    """Times in s (K + 1,) and number of live oysters seen by then (K + 1,)."""
    return np.arange(len(log.seen), dtype=float) * log.step_s, np.cumsum(log.seen).astype(float)


def normalised_score(policy: Sample, lower: Sample, upper: Sample) -> NormalisedScore:
    """(policy - lower) / (upper - lower), each the mean over the reefs common to all three.

    Samples: reef -> values of a metric. The interval is that of the ratio over resamples of the reefs, each with all
    three policies (expanded percentiles, as for every mean: `statistics`); a resample in which the upper is not above
    the lower has no ratio.
    """
    means = [sequence_means(sample) for sample in (policy, lower, upper)]
    reefs = [name for name in means[0] if all(name in of for of in means)]
    if not reefs:
        reason = "no reef in common"
        return NormalisedScore(math.nan, Interval(math.nan, math.nan, reason), 0, reason)
    own, low, high = (np.array([of[name] for name in reefs]) for of in means)
    gap = float(np.mean(high - low))
    if not gap > 0:
        reason = "the upper policy is not above the lower"
        return NormalisedScore(math.nan, Interval(math.nan, math.nan, reason), len(reefs), reason)
    value = float(np.mean(own - low)) / gap
    counts = resample_counts(len(reefs))
    if counts is None:
        return NormalisedScore(value, Interval(math.nan, math.nan, too_few(len(reefs), "reef")), len(reefs))
    gaps = counts @ (high - low)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(gaps > 0, (counts @ (own - low)) / gaps, np.nan)
    return NormalisedScore(value, resampled_interval(ratios, len(reefs)), len(reefs))
