"""The order of a board, held against the statistics of single records and pairs."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest

from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import Sample, compare, summarise
from oysterbench_leaderboard.ranking import Answers, Standing, standings

NAMES = tuple(f"val-{i:02d}" for i in range(1, 9))


def answers_made(count: int, spread: float = 0.03, names: tuple[str, ...] = NAMES, weighed: bool = False):
    """Records whose skills lie close together, on sequences that are hard for all alike."""
    draw = stream(5, b"", "tests", "ranking", count, len(names))
    hard = draw.normal(0, 0.1, len(names))
    skills = draw.uniform(0.2, 0.8, count)
    found = []
    for k in range(count):
        values = np.clip(skills[k] + hard + draw.normal(0, spread, len(names)), 0, 1)
        weights = dict(zip(names, draw.integers(1000, 90_000, len(names)).astype(float).tolist(), strict=True))
        found.append(
            Answers(
                f"{draw.integers(1 << 60):064x}",
                dict(zip(names, values.tolist(), strict=True)),
                weights if weighed else None,
                dict.fromkeys(names, 700.0) if weighed else None,
            )
        )
    return found


def walk(answers: list[Answers], better: Literal["higher", "lower"] = "higher") -> list[tuple[str, int, int | None]]:
    """Digest, place and rank by the plain statistics, record by record: what `standings` does at once."""

    def sample(values: dict[str, float]) -> Sample:
        return {name: [value] for name, value in values.items()}

    def mean(one: Answers) -> float:
        return summarise(sample(one.values), sample(one.weights) if one.weights else None).mean

    means = {one.digest: mean(one) for one in answers}
    order = sorted(answers, key=lambda one: (-means[one.digest], one.digest))
    found, leader, rank = [], order[0], 1
    for k, one in enumerate(order):
        place = 1 + sum(other > means[one.digest] for other in means.values())
        if k:
            weights = (sample(leader.weights), sample(one.weights)) if one.weights and leader.weights else None
            verdict = compare(sample(leader.values), sample(one.values), better, weights).verdict
            if verdict != "not significantly different":
                leader, rank = one, place
        found.append((one.digest, place, rank))
    return found


def of(found: list[Standing]) -> list[tuple[str, int | None, int | None]]:
    return [(one.digest, one.place, one.rank) for one in found]


@pytest.mark.parametrize("weighed", [False, True])
@pytest.mark.parametrize("count", [1, 2, 150])
def test_ranks_are_those_of_the_paired_bootstrap(count, weighed):
    answers = answers_made(count, weighed=weighed)
    found = standings(answers, NAMES, "segmentation" if weighed else "slam", [one.digest for one in answers])
    assert of(found) == walk(answers)
    if count == 150:
        assert 1 < len({one.rank for one in found}) < count


@pytest.mark.parametrize("weighed", [False, True])
def test_scores_and_intervals_are_those_of_summarise(weighed):
    answers = answers_made(50, weighed=weighed)
    found = {one.digest: one for one in standings(answers, NAMES, "segmentation" if weighed else "slam", [])}
    for one in answers:
        weights = {name: [w] for name, w in one.weights.items()} if one.weights else None
        expected = summarise({name: [v] for name, v in one.values.items()}, weights)
        standing = found[one.digest]
        assert standing.score == expected.mean
        assert (standing.low, standing.high) == pytest.approx(
            (expected.interval.low, expected.interval.high), rel=1e-11
        )


def test_a_lacking_sequence_counts_as_failed():
    whole, partial = answers_made(2)
    values = {name: value for name, value in partial.values.items() if name != "val-03"}
    digests = [whole.digest, partial.digest]
    lacking = standings([whole, Answers(partial.digest, values)], NAMES, "slam", digests)
    zero = standings([whole, Answers(partial.digest, {**values, "val-03": 0.0})], NAMES, "slam", digests)
    assert lacking == zero
    score = next(one.score for one in lacking if one.digest == partial.digest)
    assert score == math.fsum(values.values()) / len(NAMES)


def test_a_lacking_sequence_weighs_what_is_true_there():
    whole, partial = answers_made(2, weighed=True)
    assert partial.weights is not None
    values = {name: value for name, value in partial.values.items() if name != "val-03"}
    weights = {name: weight for name, weight in partial.weights.items() if name != "val-03"}
    found = standings([whole, Answers(partial.digest, values, weights)], NAMES, "segmentation", [])
    expected = sum(values[n] * weights[n] for n in values) / (sum(weights.values()) + 700.0)
    assert next(one.score for one in found if one.digest == partial.digest) == pytest.approx(expected, rel=1e-12)


def test_the_order_of_the_records_changes_nothing():
    answers = answers_made(120)
    ranked = [one.digest for one in answers[:100]]
    found = standings(answers, NAMES, "slam", ranked)
    assert standings(answers[::-1], NAMES[::-1], "slam", set(ranked)) == found
    assert standings(answers[60:] + answers[:60], NAMES, "slam", ranked) == found


def test_equal_scores_share_place_and_rank_and_stand_by_digest():
    values = answers_made(1)[0].values
    twins = [Answers(digit * 64, values) for digit in "c3a"]
    worse = Answers("0" * 64, {name: value / 2 for name, value in values.items()})
    found = standings([*twins, worse], NAMES, "slam", [one.digest for one in (*twins, worse)])
    assert of(found) == [("3" * 64, 1, 1), ("a" * 64, 1, 1), ("c" * 64, 1, 1), ("0" * 64, 4, 4)]


def test_with_too_few_sequences_there_are_places_and_no_ranks():
    answers = answers_made(4, names=NAMES[:5])
    found = standings(answers, NAMES[:5], "slam", [one.digest for one in answers])
    assert [one.place for one in found] == [1, 2, 3, 4]
    assert all(one.rank is None and math.isnan(one.low) for one in found)


def test_what_is_not_ranked_has_a_score_and_no_place():
    answers = answers_made(5)
    best = max(answers, key=lambda one: math.fsum(one.values.values()))
    found = standings(answers, NAMES, "slam", [one.digest for one in answers if one is not best])
    assert [one.place for one in found] == [1, 2, 3, 4, None]
    assert found[-1].digest == best.digest
    assert found[-1].score == max(one.score for one in found)


def test_records_without_a_value_on_some_sequences_are_compared_on_the_others():
    answers = answers_made(30)
    answers[3] = Answers(answers[3].digest, {**answers[3].values, "val-02": math.nan})
    found = {one.digest: one for one in standings(answers, NAMES, "slam", [one.digest for one in answers])}
    expected = summarise({name: [value] for name, value in answers[3].values.items()})
    standing = found[answers[3].digest]
    assert (standing.score, standing.low, standing.high) == (
        expected.mean,
        expected.interval.low,
        expected.interval.high,
    )
    assert [(one.digest, one.place, one.rank) for one in found.values()] == walk(answers)


def test_a_board_without_records_is_empty():
    assert standings([], NAMES, "slam", []) == []
