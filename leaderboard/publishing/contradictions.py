"""Contradictions within a record: parts of it that one program, scoring one method, cannot have written together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from oysterbench.core.errors import RecipeError, ResultError
from oysterbench.core.names import PLAIN, is_plain, listed
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import sequence_means
from oysterbench.hub.canonical import SHA256
from oysterbench.recipe import SplitRecipe, load_split
from oysterbench.results.lost import kept_median
from oysterbench.results.plausible import check_plausible, check_range
from oysterbench.results.records import ResultRecord, samples
from oysterbench.simulation.generate import digest
from oysterbench_leaderboard.publishing.folders import without_folders
from oysterbench_leaderboard.publishing.hidden import DIGITS, STEP, discreet, over_split
from oysterbench_leaderboard.storage.curves import Curve, Curves
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.record_summary import means_over_sequences

WHOLE = ("segmentation", "detection", "steering")
"""Tracks with values over all sequences together."""

HALF_STEP = STEP / 2
"""Greatest distance of a published share or score of a hidden split from the exact one."""

RELATIVE = {name: 0.5 * 10.0 ** (1 - digits) for name, digits in DIGITS.items()}
"""Greatest distance of other published values of a hidden split from the exact ones, as a share of them."""

PUBLISHED = {"method", "metrics", "means"}
"""What is published of the whole of a hidden split."""

LEAST_POINTS, SAME_SCORE = 100, 0.05
"""Number of points from which a curve gives the score of its run, and to which difference: one point in many is drawn,
which changes the score by less than 0.01 in all that we have published."""


def check_contradictions(record: Record) -> None:
    """Raise ResultError, in one line, for the first contradiction within a record.

    Passing proves nothing: a forgery whose parts agree passes too.
    """
    for check in CHECKS:
        check(record)


def _check_numbers(record: Record) -> None:
    """The numbers of each run are plausible."""
    for result in record.results:
        check_plausible(result, f"run {result.run + 1} on {result.sequence}")


def _check_method(record: Record) -> None:
    """All parts are of one method."""
    named = [result.method for result in record.results]
    if isinstance(record.data_set, Mapping) and "method" in record.data_set:
        named.append(record.data_set["method"])
    if odd := [name for name in named if name != record.method]:
        raise ResultError(f"expected results of {record.method}, got some of {odd[0]!r:.80}")


def _check_sequences(record: Record) -> None:
    """Split and sequences have names that a recipe can give; the sequences are those of the recipe, if known here."""
    names = dict.fromkeys(result.sequence for result in record.results)
    for kind, name in (("split", record.split), *(("sequence", name) for name in names)):
        if not is_plain(name):
            raise ResultError(f"expected the name of a {kind}: {PLAIN}; got {name!r:.60}")
    if not SHA256.fullmatch(record.split_digest):
        raise ResultError(f"key 'split_digest': expected a SHA-256 (64 hex digits), got {record.split_digest!r:.80}")
    known = _sequences_of(record.split, record.split_digest)
    if known is not None and (odd := sorted(names.keys() - known)):
        raise ResultError(f"it has results on {listed(odd)}, which {record.split} does not have")


@lru_cache
def _shipped(split: str) -> SplitRecipe | None:
    """Recipe that this version has of a split; None where it has none."""
    try:
        return load_split(split)
    except RecipeError:
        return None


@lru_cache
def _sequences_of(split: str, split_digest: str) -> frozenset[str] | None:
    """Sequences of a split; None where this version has no recipe of that digest."""
    recipe = _shipped(split)
    if recipe is None or digest(recipe) != split_digest:
        return None
    return frozenset(sequence.name for sequence in recipe.sequence)


def _is_hidden(record: Record) -> bool:
    recipe = _shipped(record.split)
    return (recipe is not None and recipe.hidden) or any(result.hidden for result in record.results)


def _check_estimates(record: Record) -> None:
    """Kept estimates are of runs that the record has."""
    runs = {f"{result.sequence}/{result.run + 1}" for result in record.results}
    for name, sha in record.estimates.items():
        if name not in runs:
            raise ResultError(f"it names an estimate of {name!r:.60}, but has no such run")
        if not SHA256.fullmatch(sha):
            raise ResultError(f"estimate of {name}: expected a SHA-256 (64 hex digits), got {sha!r:.60}")


def _check_whole(record: Record) -> None:
    """Values over all sequences together are those of a track that has them, and each within its range."""
    metrics = _part(record, "metrics")
    if metrics and record.track not in WHOLE:
        raise ResultError(f"key 'data_set.metrics': the track {record.track} has none, got {listed(metrics)}")
    for key, value in metrics.items():
        _check_value(record, f"key 'data_set.metrics.{key}'", key, value)


def _check_means(record: Record) -> None:
    """Means over sequences are within their ranges and, where the results have the values, the means of these to the
    digits that are published."""
    means = _part(record, "means")
    for key, value in means.items():
        _check_value(record, f"key 'data_set.means.{key}'", key, value)
    said = [key for key in means if any(key in result.metrics for result in record.results)]
    for key, expected in means_over_sequences(record.results, said).items():
        share = RELATIVE["sequence" if key in TRACKS[record.track].errors else "split"]
        if not _same(means[key], expected, share):
            got = f"expected {expected}, as the results give, got {means[key]}"
            raise ResultError(f"key 'data_set.means.{key}': {got}")


def _same(value: float | None, expected: float | None, share: float) -> bool:
    if value is None or expected is None:
        return value is expected
    return abs(value - expected) <= HALF_STEP + share * abs(expected)


def _check_errors(record: Record) -> None:
    """Errors, of which a hidden split has only the median over the sequences that are not lost, exist only where one
    may not be lost, and are not less than the scores allow."""
    track, means = TRACKS[record.track], _part(record, "means")
    if track.lost_below is None:
        return
    scores = sequence_means(samples(record.results, track.ranking))
    highest = max(scores.values(), default=0.0)
    for key in track.errors:
        if highest + HALF_STEP < track.lost_below and means.get(key) is not None:
            raise ResultError(f"key 'data_set.means.{key}': expected none, as all sequences are lost, got {means[key]}")
    percent, least = means.get("ate_percent"), _least_percent(record.results, scores, track.lost_below)
    if percent is not None and percent * (1.0 + RELATIVE["sequence"]) < least:
        got = f"expected at least {least:.2g}, as the scores give, got {percent:g}"
        raise ResultError(f"key 'data_set.means.ate_percent': {got}")


def _least_percent(results: Sequence[ResultRecord], scores: Mapping[str, float], lost_below: float) -> float:
    """Least median of the position errors, RMSE in % of the path, that published scores and coverages allow.

    The score is the coverage times the mean of 1 / (1 + e / e0) over the errors e, which is convex in e, and so is at
    least the coverage times that of the mean error, which the RMSE is at least (Jensen's inequality). A sequence that
    may be lost counts with 0.
    """
    least: dict[str, list[float]] = {}
    for result in results:
        score, coverage = result.metrics.get("score", math.nan), result.metrics.get("coverage", math.nan)
        if result.failure is not None or math.isnan(score) or math.isnan(coverage):
            continue
        scale = float(result.settings.get("recall_scale_percent", 1.0))
        kept = scores[result.sequence] - HALF_STEP >= lost_below
        ratio = (coverage - HALF_STEP) / (score + HALF_STEP) if kept else 0.0
        least.setdefault(result.sequence, []).append(scale * max(0.0, ratio - 1.0))
    return kept_median(least, ()) if least else 0.0


def _check_hidden(record: Record) -> None:
    """All results say alike whether the split is hidden; those of a hidden one hold what is published, and no more.
    Not checked: whether the masks have too few pixels for a precision, whose exact number is not published."""
    if len({result.hidden for result in record.results}) > 1:
        raise ResultError("expected all results to say alike whether the split is hidden, got some that differ")
    if not _is_hidden(record):
        return
    for result, published in zip(record.results, discreet(record.results)[0], strict=True):
        if record.tier == "scored":  # the sandbox's sentences, which say nothing of the ground truth, are published
            told = without_folders(result)
            published = replace(published, failure=told.failure, notes=told.notes)
        has, expected = result.to_dict(), published.to_dict()
        if odd := [key for key in expected if has[key] != expected[key]]:
            where = f"run {result.run + 1} on {result.sequence}: key {odd[0]!r}"
            raise ResultError(f"{where}: expected only what is published of a hidden split, got more")
    if odd := sorted(set(record.data_set or ()) - PUBLISHED):
        raise ResultError(f"key 'data_set.{odd[0]:.60}': expected only what is published of a hidden split, got more")
    for part in ("metrics", "means"):
        for key, value in _part(record, part).items():
            if value is not None and value != (rounded := over_split(key, record.track, value)):
                got = f"expected {rounded}, as published of a hidden split, got {value}"
                raise ResultError(f"key 'data_set.{part}.{key}': {got}")


def _part(record: Record, name: str) -> Mapping[str, Any]:
    """A part of a record's `data_set`; empty where there is none."""
    part = (record.data_set or {}).get(name) or {}
    if not isinstance(part, Mapping):
        raise ResultError(f"key 'data_set.{name}': expected values by metric, got {type(part).__name__}")
    return part


def _check_value(record: Record, where: str, key: str, value: Any) -> None:
    """Refuse what is neither null nor a number within the range of its metric. Raises ResultError."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ResultError(f"{where}: expected a number or null, got {value!r:.60}")
    check_range(key, value, record.track, where)


CHECKS: tuple[Callable[[Record], None], ...] = (
    _check_numbers,
    _check_method,
    _check_sequences,
    _check_estimates,
    _check_whole,
    _check_means,
    _check_errors,
    _check_hidden,
)
"""Checks of a record by itself; each raises ResultError."""


def check_drawn(record: Record, curves: Curves) -> None:
    """Raise ResultError where a record's curves are not of its runs: of a hidden split, of other sequences or runs, or
    with errors that give another score."""
    if _is_hidden(record):
        raise ResultError("expected no curves, as its split is hidden: they show the ground truth")
    runs = {(result.sequence, result.run): result for result in record.results if result.failure is None}
    for name, curve in curves.sequences.items():
        result = runs.get((name, curve.run))
        if result is None:
            raise ResultError(f"its curves are also of run {curve.run + 1} on {name!r:.60}, which it did not score")
        score, drawn = result.metrics.get("score"), _drawn_score(result, curve)
        if score is not None and drawn is not None and abs(drawn - score) > SAME_SCORE:
            got = f"expected errors that give about the score {score:.3f}, got {drawn:.3f}"
            raise ResultError(f"its curve of {name}: {got}")


def _drawn_score(result: ResultRecord, curve: Curve) -> float | None:
    """Score that the points of a curve give (`evaluate.slam.recall`); None where they are too few to tell, or it is
    not known how long the true path is."""
    length_m = result.metrics.get("path_length_m", 0.0)
    if len(curve.error_m) < LEAST_POINTS or not length_m > 0:
        return None
    scale_m = float(result.settings.get("recall_scale_percent", 1.0)) / 100 * length_m
    return math.fsum(1.0 / (1.0 + error / scale_m) for error in curve.error_m if error is not None) / len(curve.error_m)
