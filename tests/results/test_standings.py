"""The one rule of rank: what must hold of it on any board, and how often its intervals hold the truth."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import compare, summarise
from oysterbench.results import standings
from oysterbench.results.standings import ScoreTable, SequenceScores, Standing

BOARDS = arrays(
    float, st.tuples(st.integers(2, 6), st.integers(6, 9)), elements=st.sampled_from(np.linspace(0, 1, 21).tolist())
)


def made(methods: int, sequences: int, spread: float, *names: str | int) -> np.ndarray:
    """(methods, sequences) scores of skills that lie close together, on sequences that are hard for all alike."""
    draw = stream(5, b"", "tests", "standings", *names)
    hard, skills = draw.normal(0, 0.15, sequences), 0.6 + draw.normal(0, spread, methods)
    scatter = draw.uniform(0.02, 0.08, (methods, 1))
    return skills[:, None] + hard + scatter * draw.normal(size=(methods, sequences))


def sample(row: np.ndarray) -> dict[str, list[float]]:
    return {f"{i:02d}": [float(value)] for i, value in enumerate(row)}


def by_definition(values: np.ndarray, weights: np.ndarray | None = None) -> list[Standing]:
    """The definition, pair by pair."""
    count = len(values)
    of: list[Any] = [None if weights is None else sample(row) for row in (values if weights is None else weights)]
    means = [summarise(sample(row), w).mean for row, w in zip(values, of, strict=True)]
    better = [
        {
            j
            for j in range(count)
            if j != i
            and compare(
                sample(values[j]), sample(values[i]), "higher", (of[j], of[i]) if weights is not None else None
            ).verdict
            == "better"
        }
        for i in range(count)
    ]
    found = []
    for i in range(count):
        place = 1 + sum(mean > means[i] for mean in means)
        rank = max(1 + len(better[j]) for j in range(count) if means[j] >= means[i])
        worst = min(count - sum(j in b for b in better) for j in range(count) if means[j] <= means[i])
        found.append(Standing(place, min(rank, place), max(worst, place)))
    return found


@pytest.mark.parametrize("weighed", [False, True])
def test_ranks_are_those_of_the_definition_pair_by_pair(weighed):
    for k in range(8):
        values = made(7, 8, 0.05, k)
        weights = stream(6, b"", "weights", k).integers(1000, 90_000, values.shape).astype(float) if weighed else None
        assert ScoreTable(values, weights).standings("higher") == by_definition(values, weights)


@settings(max_examples=25, deadline=None)
@given(BOARDS)
def test_ranks_follow_the_means_and_lie_between_one_and_the_place(values):
    found = ScoreTable(values).standings("higher")
    for one in found:
        assert one.place is not None
        assert one.rank is not None
        assert one.worst is not None
        assert 1 <= one.rank <= one.place <= one.worst <= len(values)
    order = sorted(found, key=lambda one: one.place or 0)
    for a, b in pairwise(order):
        assert (a.rank or 0) <= (b.rank or 0)
        assert (a.worst or 0) <= (b.worst or 0)


@settings(max_examples=25, deadline=None)
@given(BOARDS, st.randoms(use_true_random=False))
def test_names_and_orders_of_methods_do_not_matter(values, random):
    order = list(range(len(values)))
    random.shuffle(order)
    found = ScoreTable(values).standings("higher")
    assert ScoreTable(values[order]).standings("higher") == [found[i] for i in order]
    assert ScoreTable(-values).standings("lower") == found


@settings(max_examples=25, deadline=None)
@given(BOARDS)
def test_equal_methods_share_place_and_rank(values):
    found = ScoreTable(np.concatenate([values, values[:1]])).standings("higher")
    assert found[0] == found[-1]


def test_a_method_that_joins_changes_no_comparison_of_others():
    values = made(4, 12, 0.06, "joins")
    last = values.min(axis=0) - 1
    before = [one.rank for one in ScoreTable(values).standings("higher")]
    assert [one.rank for one in ScoreTable(np.vstack([values, last])).standings("higher")] == [*before, 5]


def test_a_method_ranks_no_better_than_one_placed_above_it():
    """b is just worse than a on every sequence; c, whose mean is less, is so scattered that nothing is said of it."""
    a = np.linspace(0.5, 0.9, 8)
    c = a - 0.3 + 0.55 * np.where(np.arange(8) % 2, 1, -1)
    found = ScoreTable(np.array([a, a - 0.02, c])).standings("higher")
    assert compare(sample(a), sample(c), "higher").verdict == "not significantly different"
    assert [(one.place, one.rank, one.worst) for one in found] == [(1, 1, 2), (2, 2, 3), (3, 2, 3)]


def test_with_few_sequences_there_are_places_and_no_ranks():
    found = ScoreTable(made(4, 5, 0.1, "few")).standings("higher")
    assert sorted(one.place or 0 for one in found) == [1, 2, 3, 4]
    assert all(one.rank is None and one.worst is None for one in found)


def test_without_a_value_there_is_no_standing_and_what_is_missing_is_left_out():
    values = made(3, 9, 0.1, "missing")
    values[1] = math.nan
    values[2, 4] = math.nan
    found = ScoreTable(values).standings("higher")
    assert found[1] == Standing(None, None, None)
    verdict = compare(sample(values[0]), sample(values[2]), "higher").verdict
    first = 0 if (found[0].place, found[2].place) == (1, 2) else 2
    assert found[2 - first].rank == (1 if verdict == "not significantly different" else 2)
    assert ScoreTable(np.zeros((0, 7))).standings("higher") == []


def test_a_sequence_that_a_method_lacks_counts_as_failed():
    names = [f"{i:02d}" for i in range(8)]
    scores = [SequenceScores(dict(zip(names, row, strict=True))) for row in made(2, 8, 0.1, "lacks").tolist()]
    lacking = SequenceScores({name: value for name, value in scores[1].values.items() if name != "03"})
    table = ScoreTable.of([scores[0], lacking], names[::-1], "slam")
    assert table.values[1].tolist() == [0.0 if name == "03" else scores[1].values[name] for name in names]


def test_leaving_out_a_sequence_is_no_better_than_any_answer_to_it():
    """Skills of steering may be below 0."""
    bad, lost = SequenceScores({"a": 0.5, "b": -0.4}), SequenceScores({"a": 0.5, "b": -1.9})
    lacking = SequenceScores({"a": 0.5})
    table = ScoreTable.of([bad, lost, lacking], ["a", "b"], "steering")
    assert table.values[:, 1].tolist() == [-0.4, -1.9, -1.9]
    assert ScoreTable.of([bad, lost, lacking], ["a", "b"], "steering", [bad]).values[2, 1] == -0.4
    assert ScoreTable.of([lacking, SequenceScores({"b": float("nan")})], ["a", "b"], "steering").values[0, 1] == 0.0


def test_a_sequence_that_a_method_lacks_weighs_what_is_true_there():
    whole = SequenceScores({"a": 0.9, "b": 0.8}, {"a": 1000.0, "b": 3000.0}, {"a": 800.0, "b": 700.0})
    lacking = SequenceScores({"a": 0.5}, {"a": 2000.0})
    table = ScoreTable.of([whole, lacking], ["a", "b"], "segmentation")
    assert table.means()[1] == pytest.approx(0.5 * 2000 / 2700)


def test_only_trusted_methods_say_what_a_lacking_sequence_weighs():
    whole = SequenceScores({"a": 0.9, "b": 0.8}, {"a": 1000.0, "b": 3000.0}, {"a": 800.0, "b": 700.0})
    forged = SequenceScores({"a": 0.5, "b": 0.5}, {"a": 1.0, "b": 1.0}, {"a": 1e-9, "b": 1e-9})
    lacking = SequenceScores({"a": 0.5}, {"a": 2000.0})
    table = ScoreTable.of([whole, lacking, forged], ["a", "b"], "segmentation", [whole, lacking])
    assert table.means()[1] == pytest.approx(0.5 * 2000 / 2700)


def test_on_a_large_board_the_first_methods_are_what_others_are_tested_against(monkeypatch):
    values = made(40, 8, 0.2, "large")
    whole = ScoreTable(values).standings("higher")
    monkeypatch.setattr(standings, "REFERENCES", 5)
    monkeypatch.setattr(standings, "BATCH", 8)
    found = ScoreTable(values).standings("higher")
    assert [one.place for one in found] == [one.place for one in whole]
    assert all((one.rank or 0) <= min(6, every.rank or 0) for one, every in zip(found, whole, strict=True))
    assert max(one.rank or 0 for one in found) == 6


@pytest.mark.parametrize(("methods", "least"), [(2, 0.95), (4, 0.88)])
def test_methods_of_equal_skill_are_mostly_held_for_the_first(methods, least):
    """How often the interval from rank to worst holds the true rank, 1, on twelve sequences: each pair is tested at
    95 %, two-sided, so that of two methods one in forty is held for second; more methods are more pairs."""
    held = 0
    for k in range(150):
        draw = stream(7, b"", "tests", "coverage", k, methods, 12)
        values = draw.normal(0, 0.15, 12) + draw.normal(0, 0.06, (methods, 12))
        held += sum(one.rank == 1 for one in ScoreTable(values).standings("higher"))
    assert least <= held / (150 * methods) < 1
