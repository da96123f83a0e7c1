"""The index over records that nobody measured: they change nothing of others, and stop no board but their own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from oysterbench.core.geometry import Array
from oysterbench.results.standings import ScoreTable
from oysterbench_leaderboard.boards.memory import MemoryIndex
from tests.helpers.boards_opened import opened, pages
from tests.helpers.records_made import fill, record_made


@pytest.mark.parametrize("key", ["union_px", "truth_px"])
def test_a_record_with_a_negative_weight_is_left_out(store, key):
    whole = record_made(track="segmentation", split="seg-val")
    first, *others = whole.results
    odd = replace(first, metrics={**first.metrics, key: -1e5})
    forged = store.add(replace(whole, team="somebody", tier="reported", results=(odd, *others)))
    index = opened(store)
    assert index.problems() == MemoryIndex(store).problems()
    assert f"has {key} = -100000: expected 0 or more" in index.problems()[forged]


def test_a_board_that_cannot_be_ranked_is_left_out_and_the_others_go_on(store, monkeypatch):
    digests = fill(store)
    whole = ScoreTable.means

    def means(table: ScoreTable) -> Array:
        return whole(table) if table.weights is None else math.fsum([1e308, 1e308])  # type: ignore[return-value]

    with monkeypatch.context() as patched:
        patched.setattr(ScoreTable, "means", means)
        index, memory = opened(store), MemoryIndex(store)
    assert index.problems() == memory.problems()
    assert set(index.problems()) == {digests["unet"], digests["colour"]}
    assert "its board could not be ranked: " in index.problems()[digests["unet"]]
    assert index.row(digests["cod"]).state == "current"
    assert index.boards() == memory.boards()
    store.add(record_made("another"))
    index.refresh()
    assert index.problems() == {}
    assert pages(index) == pages(opened(store, "fresh.sqlite"))


@pytest.mark.parametrize("action", ["reported", "withdrawn", "superseded"])
def test_a_record_that_is_not_ranked_gives_no_weights_to_those_that_are(store, action):
    masks: dict[str, Any] = {"track": "segmentation", "split": "seg-val"}
    store.add(record_made("whole", skill=0.7, **masks))
    store.add(record_made("part", skill=0.9, without=("clip-01", "clip-02", "clip-03"), **masks))
    index = opened(store)
    before = {row.method: row for row in pages(index)[0].rows}
    record = record_made("forged", skill=0.5, tier="reported" if action == "reported" else "scored", **masks)
    tiny = [replace(one, metrics={**one.metrics, "union_px": 1e-9, "truth_px": 1e-9}) for one in record.results]
    digest = store.add(replace(record, results=tuple(tiny)))
    if action == "withdrawn":
        store.change_status(digest, "withdrawn", "A mistake.")
    elif action == "superseded":
        store.add(replace(record, created="2026-11-02T12:00:00Z"))
    index.refresh()
    after = {row.method: row for row in pages(index)[0].rows}
    for method, row in before.items():
        assert (after[method].score, after[method].low, after[method].high) == (row.score, row.low, row.high)


@pytest.mark.parametrize(
    ("metrics", "changes", "said"),
    [
        ({"score": 1.5}, {}, "run 1 on val-01: metric 'score': expected 0 to 1, got 1.5"),
        ({"coverage": 2.0}, {}, "run 1 on val-01: metric 'coverage': expected 0 to 1, got 2"),
        ({}, {"method": "other"}, "expected results of other, got some of 'carp'"),
        ({}, {"data_set": {"means": {"ate_percent": -1.0}}}, "metric 'ate_percent': expected 0 or more, got -1"),
        ({}, {"data_set": {"means": {"ate_percent": "<b>"}}}, "ate_percent over all sequences: expected a number"),
        ({}, {"data_set": {"metrics": {"score": 7.0}}}, "over all sequences: metric 'score': expected 0 to 1, got 7"),
    ],
)
def test_a_record_is_left_out_that_would_show_what_cannot_be(store, metrics, changes, said):
    made = record_made("carp")
    first, *others = made.results
    odd = replace(first, metrics={**first.metrics, **metrics})
    forged = store.add(replace(made, results=(odd, *others), **changes))
    other = store.add(record_made("cod"))
    index = opened(store)
    assert index.problems() == MemoryIndex(store).problems()
    assert set(index.problems()) == {forged}
    assert said in index.problems()[forged]
    assert index.row(other).place == 1
