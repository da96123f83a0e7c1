"""Intervals cover what they promise, ties are called ties, and a sample without values never becomes a zero."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import bootstrap as scipy_bootstrap

from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import (
    LEAST_SEQUENCES,
    bootstrap_interval,
    compare,
    sequence_means,
    significant_signs,
    summarise,
)


def sample(values, runs=1) -> dict[str, list[float]]:
    return {f"s{i:02d}": [float(value)] * runs for i, value in enumerate(values)}


@pytest.mark.parametrize(
    ("sequences", "runs", "between", "within"), [(8, 1, 1.0, 0.0), (20, 1, 1.0, 0.0), (10, 3, 1.0, 1.0), (10, 3, 0, 1)]
)
def test_an_interval_of_95_percent_covers_the_mean_in_95_percent_of_cases(sequences, runs, between, within):
    rng = stream(3, b"", "coverage", sequences, runs)
    cases, hits = 400, 0
    for _ in range(cases):
        means = between * rng.normal(0, 1, sequences)
        values = means[:, None] + within * rng.normal(0, 1, (sequences, runs))
        interval = bootstrap_interval(values.mean(axis=1))
        hits += interval.low <= 0 <= interval.high
    # Three standard deviations of a share of 400 are 3.3 %; 8 sequences are known to fall short by 1 to 2 %.
    assert 0.91 <= hits / cases <= 0.98


def test_methods_that_are_equal_are_told_apart_in_few_cases_and_unequal_ones_in_most():
    rng = stream(4, b"", "errors of the first kind")
    verdicts = {0.0: [], 1.5: []}
    for gain, found in verdicts.items():
        for _ in range(200):
            difficulty = rng.normal(0, 5, 10)  # shared by both: pairing must take it out
            a, b = sample(difficulty + gain + rng.normal(0, 1, 10)), sample(difficulty + rng.normal(0, 1, 10))
            found.append(compare(a, b, "higher").verdict)
    assert verdicts[0.0].count("not significantly different") >= 180
    assert verdicts[1.5].count("better") >= 150
    assert verdicts[1.5].count("worse") == 0


def test_for_many_sequences_the_interval_is_that_of_an_independent_implementation():
    values = stream(5, b"", "many").gamma(2.0, 1.0, 200)
    interval = bootstrap_interval(values)
    theirs = scipy_bootstrap(
        (values,), np.mean, confidence_level=0.95, method="percentile", rng=stream(6, b"", "theirs")
    ).confidence_interval
    assert interval.low == pytest.approx(theirs.low, abs=0.03)
    assert interval.high == pytest.approx(theirs.high, abs=0.03)


def test_the_same_values_give_the_same_interval_in_any_order_of_sequences():
    forwards = {name: [float(i), i + 0.1] for i, name in enumerate("abcdefgh")}
    backwards = dict(reversed(forwards.items()))
    assert summarise(forwards) == summarise(backwards)
    compared = [compare(values, sample(range(8)), "lower") for values in (forwards, backwards)]
    assert repr(compared[0]) == repr(compared[1])  # not equal from Python 3.13 on, as NaNs differ


def test_every_sequence_has_one_vote():
    assert sequence_means({"b": [1.0, 3.0], "a": [4.0, math.nan]}) == {"a": 4.0, "b": 2.0}
    assert summarise({"b": [1.0, 3.0], "a": [4.0]}).mean == 3.0


@pytest.mark.parametrize("sequences", range(1, LEAST_SEQUENCES))
def test_few_sequences_have_a_mean_and_no_interval_and_say_so(sequences):
    summary = summarise(sample(range(sequences), runs=2))
    assert summary.mean == pytest.approx((sequences - 1) / 2)
    assert not summary.interval.known
    assert math.isnan(summary.interval.low)
    assert summary.interval.reason.startswith(f"{sequences} sequence")
    assert "fewer than 6" in summary.interval.reason
    assert math.isnan(summary.sequence_deviation) == (sequences == 1)
    assert compare(sample(range(sequences)), sample([9] * sequences), "higher").verdict == "not significantly different"


@pytest.mark.parametrize("empty", [{}, {"a": []}, {"a": [math.nan, math.nan], "b": [math.nan]}])
def test_an_empty_sample_is_nan_with_a_reason_and_never_zero(empty):
    summary = summarise(empty)
    assert summary.reason == "no run has a value"
    assert all(math.isnan(v) for v in (summary.mean, summary.median, summary.low, summary.high, summary.run_deviation))
    assert not summary.interval.known
    assert (summary.sequences, summary.runs) == (0, 0)
    against = compare(empty, sample([1, 2]), "lower")
    assert math.isnan(against.difference)
    assert against.interval.reason == "no common sequence"


def test_spread_of_runs_is_told_from_spread_of_sequences():
    summary = summarise({"a": [0.0, 2.0], "b": [10.0, 12.0], "c": [5.0, math.nan]})
    assert summary.run_deviation == pytest.approx(math.sqrt(2))
    assert summary.sequence_deviation == pytest.approx(np.std([1, 11, 5], ddof=1))
    assert (summary.runs, summary.of_runs, summary.sequences) == (5, 6, 3)
    assert (summary.low, summary.median, summary.high) == (1, 5, 11)
    assert math.isnan(summarise(sample([1, 2])).run_deviation)


def test_wins_ties_and_losses_are_counted_by_the_direction_of_the_metric():
    a, b = sample([1, 2, 3, 4]), sample([2, 2, 1, 1])
    higher, lower = compare(a, b, "higher"), compare(a, b, "lower")
    assert (higher.wins, higher.ties, higher.losses) == (2, 1, 1)
    assert (lower.wins, lower.ties, lower.losses) == (1, 1, 2)
    assert higher.difference == lower.difference == 1.0


def test_a_verdict_turns_with_direction_and_order():
    a, b = sample(np.arange(8) + 1.0), sample(np.arange(8))
    assert compare(a, b, "higher").verdict == compare(b, a, "lower").verdict == "better"
    assert compare(b, a, "higher").verdict == compare(a, b, "lower").verdict == "worse"
    assert compare(a, a, "higher").verdict == "not significantly different"


def test_rounding_is_no_victory():
    a = sample(np.arange(8) + 1.0)
    against = compare(a, {name: [values[0] * (1 + 1e-12)] for name, values in a.items()}, "higher")
    assert (against.wins, against.ties, against.losses, against.verdict) == (0, 8, 0, "not significantly different")


@pytest.mark.parametrize("far", [1e3, 1e11, 1e13, 1e18])
def test_who_diverges_on_one_sequence_ties_on_no_other(far):
    mine, theirs = (np.array([start + 0.01 * k for k in range(8)]) for start in (0.5, 1.0))
    theirs[3] = far
    equal = np.ones(8)
    for whole in (None, (sample(equal), sample(equal))):
        found = compare(sample(mine), sample(theirs), "lower", whole)
        assert (found.verdict, found.wins) == ("better", 8)
        assert found.interval.high < -0.4
    assert significant_signs(mine, theirs[None]) == -1
    assert significant_signs(mine, theirs[None], equal, equal[None]) == -1


def test_an_interval_that_ends_at_zero_exactly_tells_nobody_apart_whoever_else_is_compared():
    """Scores in steps of 0.01, as of a hidden split: in whole hundredths the interval of the last pair begins at 0."""
    rows = [
        [0.39, 0.42, 0.45, 0.42, 0.46, 0.47, 0.5, 0.3, 0.42],
        [0.64, 0.62, 0.51, 0.48, 0.45, 0.97, 0.59, 0.8, 0.49],
        [0.7, 0.66, 0.76, 0.51, 0.46, 0.9, 0.73, 0.74, 0.47],
        [0.52, 0.66, 0.46, 0.64, 0.65, 0.52, 0.83, 0.33, 0.59],
        [0.52, 0.63, 0.88, 0.8, 0.5, 0.54, 0.55, 0.75, 0.67],
        [0.3, 0.29, 0.11, 0.39, 0.36, 0.42, 0.26, 0.23, 0.39],
    ]
    mine, others = np.array([0.48, 0.32, 0.3, 0.28, 0.33, 0.4, 0.41, 0.64, 0.69]), np.array(rows)
    weights, equal = np.ones(len(mine)), np.ones(others.shape)
    for many in (others, others[[0, -1]], others[-1:]):
        assert significant_signs(mine, many)[-1] == 0
        assert significant_signs(mine, many, weights, equal[: len(many)])[-1] == 0
    for whole in (None, (sample(weights), sample(weights))):
        found = compare(sample(mine), sample(rows[-1]), "higher", whole)
        assert (found.interval.low, found.verdict) == (0.0, "not significantly different")


def test_only_shared_sequences_are_compared():
    a, b = {**sample(range(6)), "only a": [100.0]}, {**sample(range(6)), "only b": [-100.0]}
    assert compare(a, b, "higher").sequences == 6
    assert compare(a, b, "higher").difference == 0.0
