"""Scores over all images of several sequences, with intervals by resampling sequences, each with all its images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.evaluate.runs import sum_as_of_one_run, times_of
from oysterbench.evaluate.statistics import Interval, resample_counts, resampled_interval, too_few
from oysterbench.evaluate.steering import labels
from oysterbench.evaluate.steering.pictures import (
    AXES,
    Commands,
    Labels,
    PictureScore,
    score_pictures,
)


@dataclass(frozen=True)
class Whole:
    """Result over several sequences. score: over all images; intervals: of its metrics that have one, with the reason
    if it is unknown; runs: (C,) on each sequence, of which images are counted once."""

    score: PictureScore
    intervals: Mapping[str, Interval]
    sequences: int
    runs: Sequence[int] = (1,)


@dataclass(frozen=True)
class Constant:
    """A command that is the same at every image. skill: mean over sequences; whole: result over all their images."""

    classes: tuple[int, int]
    skill: float
    whole: Whole


def best_constant(truths: Sequence[Labels]) -> Constant | None:
    """Find the one pair of classes with the highest mean skill over sequences of the same task, on these very
    sequences: an upper bound for answers that never change. None where no command makes a difference."""
    sizes = truths[0].action_values.shape[1:]
    skills = {pair: _mean_skill([_constant(truth, pair) for truth in truths], truths) for pair in np.ndindex(*sizes)}
    known = {pair: skill for pair, skill in skills.items() if not math.isnan(skill)}
    if not known:
        return None
    best = max(known, key=lambda pair: known[pair])
    whole = over_sequences([(truth, _constant(truth, best)) for truth in truths])
    return Constant((best[0], best[1]), known[best], whole)


def _mean_skill(commands: Sequence[Commands], truths: Sequence[Labels]) -> float:
    """Mean over the sequences that have a skill; NaN if none has."""
    skills = [labels.skill(t.action_values, c.classes) for t, c in zip(truths, commands, strict=True)]
    known = [skill for skill in skills if not math.isnan(skill)]
    return math.fsum(known) / len(known) if known else math.nan


def _constant(truth: Labels, pair: Sequence[int]) -> Commands:
    """The same command at each image, with probability 1."""
    n, sizes = len(truth.classes), truth.action_values.shape[1:]
    yaw, pitch = (np.tile(np.eye(size)[k], (n, 1)) for size, k in zip(sizes, pair, strict=True))
    return Commands(np.tile(np.array(pair, dtype=np.int64), (n, 1)), yaw, pitch)


def over_sequences(parts: Sequence[tuple[Labels, Commands]], runs: Sequence[int] | None = None) -> Whole:
    """Score the commands for the images of one or more sequences together; all are of the same task. runs: (C,) number
    of runs that each part holds (`together`), None for one: each sequence counts as often as any other."""
    score, scores = score_pictures(*together(parts)), [score_pictures(*part) for part in parts]
    pictures = sum_as_of_one_run([one.metrics["pictures"] for one in scores], runs)
    n = len(parts)
    times = times_of(runs, n)
    even = score.metrics if set(times) == {1} else _evened(parts, scores, np.array(times, dtype=float))
    score = replace(score, metrics={**even, "pictures": pictures})
    runs = runs or (1,) * n
    counts = resample_counts(n)
    if counts is None:
        unknown = Interval(math.nan, math.nan, too_few(n))
        return Whole(score, dict.fromkeys((*_sums(parts, scores), *_F1), unknown), n, runs)
    counts, intervals = counts * np.array(times), {}
    with np.errstate(divide="ignore", invalid="ignore"):
        for key, (tops, bottoms) in _sums(parts, scores).items():
            ratios = (counts @ tops) / (counts @ bottoms)
            intervals[key] = resampled_interval(1.0 - ratios if key == "skill" else ratios, n)
    for axis, key in zip(AXES, _F1, strict=True):
        confusions = [getattr(each, axis).astype(float) for each in scores]
        intervals[key] = resampled_interval(_macro_f1(counts, confusions), n)
    return Whole(score, intervals, n, runs)


_F1 = tuple(f"{axis}_macro_f1" for axis in AXES)


def together(parts: Sequence[tuple[Labels, Commands]]) -> tuple[Labels, Commands]:
    """Join labels and commands of several sequences, or of several runs on one."""
    truths, commands = zip(*parts, strict=True)
    return (
        Labels(
            np.concatenate([t.classes for t in truths]),
            np.concatenate([t.action_values for t in truths]),
            truths[0].task,
        ),
        Commands(
            np.concatenate([c.classes for c in commands]),
            np.concatenate([c.yaw_probability for c in commands]),
            np.concatenate([c.pitch_probability for c in commands]),
        ),
    )


def _evened(parts: Sequence[tuple[Labels, Commands]], scores: Sequence[PictureScore], times: Array) -> dict[str, float]:
    """The metrics of `score_pictures` over all images, those of each sequence counted `times` (n,) over."""
    weights = times * [len(truth.classes) for truth, _ in parts]
    metrics = {}
    for key in scores[0].metrics:
        values = np.array([each.metrics[key] for each in scores])
        metrics[key] = float(weights @ np.nan_to_num(values) / weights.sum()) if weights.any() else math.nan
    for axis in AXES:
        confusion = np.tensordot(times, [getattr(each, axis) for each in scores], 1)
        metrics[f"{axis}_balanced_accuracy"] = labels.balanced_accuracy(confusion)
        metrics[f"{axis}_macro_f1"] = labels.macro_f1(confusion)
    regret, chance = _sums(parts, scores)["skill"]
    metrics["skill"] = 1.0 - float(times @ regret) / float(times @ chance) if times @ chance > 0 else math.nan
    return metrics


def _sums(parts: Sequence[tuple[Labels, Commands]], scores: Sequence[PictureScore]) -> dict[str, tuple[Array, Array]]:
    """Metric -> numerators and denominators (n,) of the sequences; for skill, those of 1 - skill."""
    pictures = np.array([len(truth.classes) for truth, _ in parts], dtype=float)
    regret = np.array([labels.regrets(truth.action_values, made.classes).sum() for truth, made in parts])
    chance = np.array([labels.chance_regrets(truth.action_values).sum() for truth, _ in parts])
    found = {"skill": (regret, chance), "regret_oysters": (regret, pictures)}
    for axis in AXES:
        right = np.array([np.trace(getattr(each, axis)) for each in scores], dtype=float)
        found[f"{axis}_accuracy"] = (right, pictures)
        costs = [each.metrics[f"{axis}_cost_deg"] for each in scores]
        found[f"{axis}_cost_deg"] = (np.nan_to_num(np.array(costs)) * pictures, pictures)
    return found


def _macro_f1(counts: Array, confusions: Sequence[Array]) -> Array:
    """Macro F1 (R,), as `labels.macro_f1`, of each resample of the sequences' confusion matrices (C, C)."""
    stacked = np.stack(confusions)
    right = counts @ np.diagonal(stacked, axis1=1, axis2=2)
    met = counts @ (stacked.sum(axis=1) + stacked.sum(axis=2))
    known = met > 0
    f1 = np.where(known, 2 * right / np.where(known, met, 1.0), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(f1.sum(axis=1) / known.sum(axis=1))
