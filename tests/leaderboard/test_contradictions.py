"""`leaderboard verify` finds records whose parts contradict each other, each named by its right hash."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from oysterbench.recipe import load_split
from oysterbench.simulation.generate import digest
from oysterbench_leaderboard.publishing.contradictions import CHECKS
from oysterbench_leaderboard.publishing.hidden import discreet
from oysterbench_leaderboard.publishing.verifying import verify
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import curves_made, record_made

Forge = Callable[[dict[str, Any]], object]


def hidden_made(skill: float = 0.8, **of_record: Any) -> Record:
    """A record of a hidden split, as published."""
    made = record_made(skill=skill, split="reef-test", **of_record)
    exact = [replace(one, hidden=True) for one in made.results]
    results, data_set = discreet(exact, made.data_set, judged=made.tier == "scored")
    return replace(made, results=tuple(results), data_set=data_set)


def said_of(folder: Path, record: Record, forge: Forge) -> str:
    """What `verify` says of a record that was forged; empty where nothing."""
    values = record.to_dict()
    forge(values)
    store = RecordStore(folder)
    forged = store.add(Record.from_dict(values))
    return verify(store).problems.get(f"records/{forged}.json", "")


def means(**changes: Any) -> Forge:
    return lambda values: values["data_set"]["means"].update(changes)


def first(**changes: Any) -> Forge:
    return lambda values: values["results"][0].update(changes)


def every(**changes: Any) -> Forge:
    return lambda values: [one.update(changes) for one in values["results"]]


def metric(**changes: Any) -> Forge:
    return lambda values: values["results"][0]["metrics"].update(changes)


HIDDEN: list[tuple[Forge, str]] = [
    (means(coverage=0.5), "key 'data_set.means.coverage': expected 0.9"),
    (means(coverage=None), "key 'data_set.means.coverage': expected 0.9"),
    (means(coverage=True), "coverage over all sequences: expected a number or null, got True"),
    (means(ate_percent=0.001), "key 'data_set.means.ate_percent': expected at least 0."),
    (means(ate_percent=-1.0), "metric 'ate_percent': expected 0 or more, got -1"),
    (means(ate_percent=0.4567), "expected 0.46, as published of a hidden split, got 0.4567"),
    (lambda values: values["data_set"].update(means=[]), ""),
    (lambda values: values["data_set"].update(means=[1]), "key 'data_set.means': expected values by metric, got list"),
    (lambda values: values["data_set"].update(metrics={"score": 0.99}), "the track slam has none, got score"),
    (lambda values: values["data_set"].update(method="other"), "expected results of carp, got some of 'other'"),
    (lambda values: values["data_set"].update(method=[]), "expected results of carp, got some of []"),
    (first(hidden=False), "expected all results to say alike whether the split is hidden"),
    (metric(score=0.8123456), "run 1 on val-01: key 'metrics': expected only what is published of a hidden split"),
    (metric(ate_rmse_m=3.1), "run 1 on val-01: key 'metrics': expected only what is published of a hidden split"),
    (first(notes=["see /home/me/x/y for more"]), "run 1 on val-01: key 'notes': expected only what is published"),
    (first(truth_digest="ab" * 32), "run 1 on val-01: key 'truth_digest': expected only what is published"),
    (first(info={"errors": [0.1234]}), "run 1 on val-01: key 'info': expected only what is published"),
    (lambda values: values.update(curves="CURVES"), "expected no curves, as its split is hidden"),
]


@pytest.mark.parametrize(("forge", "said"), HIDDEN)
def test_of_a_hidden_split(tmp_path, forge, said):
    kept = RecordStore(tmp_path).add_curves(curves_made("carp", 0.8))

    def forged(values: dict[str, Any]) -> None:
        forge(values)
        values["curves"] = values["curves"] and kept

    found = said_of(tmp_path, hidden_made(), forged)
    assert said in found if said else not found


@pytest.mark.parametrize("track", ["slam", "segmentation", "steering"])
@pytest.mark.parametrize("key", ["intervals", "per_image", "truth_px"])
def test_more_of_a_hidden_split_as_a_whole_than_is_published(tmp_path, track, key):
    def add(values: dict[str, Any]) -> None:
        values["data_set"][key] = {"score": {"low": 0.123456789, "high": 0.2}}

    made = hidden_made(track=track)
    assert said_of(tmp_path, made, lambda values: None) == ""
    assert f"key 'data_set.{key}': expected only what is published of a hidden" in said_of(tmp_path, made, add)


@pytest.mark.parametrize("tier", ["scored", "baseline"])
def test_a_failure_on_a_hidden_split_that_tells_folders(tmp_path, tier):
    assert said_of(tmp_path, hidden_made(tier=tier, failed=("val-02",)), lambda values: None) == ""
    for failure, tiers in (("/home/me/x failed", ("scored", "baseline")), ("no pose", ("baseline",))):
        made = hidden_made(tier=tier, failed=("val-02",))
        results = [replace(one, failure=one.failure and failure) for one in made.results]
        found = said_of(tmp_path, replace(made, results=results), lambda values: None)
        assert ("key 'failure': expected only what is published" in found) == (tier in tiers)


def test_an_error_over_sequences_that_are_all_lost(tmp_path):
    made = hidden_made(0.05)
    assert said_of(tmp_path, made, lambda values: None) == ""
    assert "expected none, as all sequences are lost, got 0.001" in said_of(tmp_path, made, means(ate_percent=0.001))


PUBLIC: list[tuple[Forge, str]] = [
    (lambda values: values.update(method="other"), "expected results of other, got some of 'carp'"),
    (first(sequence="../x"), "expected the name of a sequence: letters, digits, '-' and '_'"),
    (first(sequence="val-99"), "it has results on val-99, which slam-val does not have"),
    (first(hidden=False), "expected all results to say alike whether the split is hidden"),
    (lambda values: values.update(estimates={"x": "y"}), "it names an estimate of 'x', but has no such run"),
    (lambda values: values.update(estimates={"val-01/1": "y"}), "estimate of val-01/1: expected a SHA-256"),
    (lambda values: values.update(data_set={"metrics": {"score": 0.99}}), "the track slam has none, got score"),
    (lambda values: values.update(data_set={"means": {"ate_percent": 0.001}}), "as the results give, got 0.001"),
    (every(split="../x"), "expected the name of a split"),
    (every(split_digest="x"), "key 'split_digest': expected a SHA"),
    (every(evaluator_version="slam 4"), "key 'evaluator_version': expected slam 1 to 3, got 'slam 4'"),
    (every(evaluator_version="mine 1"), "key 'evaluator_version': expected slam 1 to 3, got 'mine 1'"),
    (lambda values: values.update(created="2999-01-01T00:00:00Z"), "expected a time that has come, got 2999"),
    (first(created="2026-11-20T00:00:00Z"), "expected a time after that of its results, 2026-11-20"),
    (first(created="soon"), "key 'results.created': expected a UTC time"),
]


@pytest.mark.parametrize(("forge", "said"), PUBLIC)
def test_of_a_public_split(tmp_path, forge, said):
    made = record_made()
    here = [replace(one, split_digest=digest(load_split("slam-val"))) for one in made.results]
    assert said_of(tmp_path, replace(made, results=here), lambda values: None) == ""
    assert said in said_of(tmp_path, replace(made, results=here), forge)


def test_a_record_of_a_hidden_split_of_masks_as_it_is_published_contradicts_nothing(tmp_path):
    made = hidden_made(track="segmentation")
    assert {"truth_px", "union_px"} <= made.results[0].metrics.keys()
    assert said_of(tmp_path, made, lambda values: None) == ""
    expected = "key 'data_set.means.recall': expected 0.0, as published of a hidden split, got 1.23e-05"
    assert expected in said_of(tmp_path, made, means(recall=1.23e-05))


def zeroed(sequences: dict[str, Any]) -> None:
    for curve in sequences.values():
        curve["error_m"] = [0.0 if error is not None else None for error in curve["error_m"]]


def perfect(sequences: dict[str, Any]) -> None:
    zeroed(sequences)
    for curve in sequences.values():
        curve["path"] = [place and truth for place, truth in zip(curve["path"], curve["truth"], strict=True)]


def unanswered(sequences: dict[str, Any]) -> None:
    sequences["val-01"]["error_m"][3] = None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda sequences: None, ""),
        (zeroed, "cannot be used: curve of val-01: at 0.0 s: expected the error 0.0"),
        (unanswered, "cannot be used: curve of val-01: at 1.5 s: expected the error 0.0"),
        (perfect, "its curve of val-01: expected errors that give about the score 0."),
        (lambda sequences: sequences.update(nope=sequences.pop("val-01")), "also of run 1 on 'nope', which it did not"),
        (lambda sequences: sequences["val-02"].update(run=1), "also of run 2 on 'val-02', which it did not score"),
    ],
)
def test_curves_that_are_not_of_the_record(tmp_path, change, said):
    document = curves_made("carp", 0.8)
    change(document["sequences"])
    kept = RecordStore(tmp_path).add_curves(document)
    found = said_of(tmp_path, record_made(curves=kept), lambda values: None)
    assert said in found if said else not found


def test_each_check_says_what_it_is_for():
    assert all(check.__doc__ for check in CHECKS)
