"""Results are written as JSON that every reader takes, read back as they were, and averaged without silent zeros."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import json
import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from oysterbench.core.errors import ResultError
from oysterbench.core.hardware import hardware
from oysterbench.results.records import (
    FORMAT,
    ResultRecord,
    add_results,
    aggregate,
    document,
    read_results,
    write_results,
)


def record(**changes) -> ResultRecord:
    values = {
        "track": "slam",
        "split": "slam-mini",
        "split_digest": "ab" * 32,
        "sequence": "mini-01",
        "method": "dead_reckoning",
        "metrics": {"ate_rmse_m": 0.5, "coverage": 1.0},
        "evaluator_version": "slam 1",
        "settings": {"align": "posyaw"},
        "hardware": {"cpu": "x", "cores": 2},
        "created": "2026-01-01T00:00:00Z",
    }
    return ResultRecord(**{**values, **changes})


def failed(**changes) -> ResultRecord:
    return record(metrics={}, failure="the method crashed", **changes)


def test_a_record_survives_json():
    first = record(
        metrics={"ate_rmse_m": 0.1 + 0.2, "matched": np.int64(7), "scale": math.nan},
        reasons={"scale": "not aligned by scale"},
        notes=["watch out: Ⅸ <b>"],
        info={"path": np.arange(3), "nested": {"nan": math.nan}},
    )
    again = ResultRecord.from_dict(json.loads(first.to_json()))
    assert again.to_json() == first.to_json()
    assert again.metrics["ate_rmse_m"] == 0.1 + 0.2
    assert math.isnan(again.metrics["scale"])
    assert again.notes == ("watch out: Ⅸ <b>",)
    assert again.info == {"path": [0, 1, 2], "nested": {"nan": None}}


def test_nan_is_null_in_json_and_has_a_reason():
    values = json.loads(record(metrics={"scale": math.nan}, reasons={"scale": "why"}).to_json())
    assert values["metrics"] == {"scale": None}
    assert values["reasons"] == {"scale": "why"}
    with pytest.raises(ResultError, match="'scale' of dead_reckoning on mini-01 is NaN: expected the reason"):
        record(metrics={"scale": math.nan})
    with pytest.raises(ResultError, match="got inf"):
        record(metrics={"scale": math.inf})


def test_a_record_does_not_change():
    metrics = {"ate_rmse_m": 0.5}
    kept = record(metrics=metrics)
    metrics["ate_rmse_m"] = 0.0
    assert kept.metrics["ate_rmse_m"] == 0.5
    with pytest.raises(dataclasses.FrozenInstanceError):
        kept.method = "mine"


def test_a_record_says_where_and_when_it_was_made():
    fresh = ResultRecord(track="slam", split="s", sequence="q", method="m")
    assert fresh.hardware.keys() == hardware().keys() == {"cpu", "cores", "platform", "python"}
    assert fresh.hardware["cores"] >= 1
    assert fresh.created.endswith("Z")
    assert fresh.oysterbench_version


def test_results_are_written_and_read(tmp_path):
    path = tmp_path / "new" / "results.json"
    records = [record(), failed(method="other")]
    write_results(path, records)
    assert read_results(path) == records
    assert json.loads(path.read_text()) == document(records)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other/9"}, "key 'format': expected 'oysterbench-result/2', got 'other/9'"),
        ({"extra": 1}, "unknown key 'extra'"),
        ({"method": 3}, "key 'method': expected `str`, got `int`"),
        ({"metrics": [1]}, "key 'metrics': expected `object`, got `array`"),
        ({"metrics": {"ate_rmse_m": "0.1"}}, "key 'metrics.ate_rmse_m': expected `int | float`, got `str`"),
        ({"metrics": {"ate_rmse_m": True}}, "key 'metrics.ate_rmse_m'"),
        ({"metrics": {"ate_rmse_m": None}}, "expected the reason"),
        ({"notes": "one"}, "key 'notes': expected `array`, got `str`"),
        ({"run": -1}, "key 'run': expected `int` >= 0"),
        ({"seed": "7"}, "key 'seed': expected `int | null`"),
        ({"conditions": {"water": ["3C"]}}, "key 'conditions.water': expected `int | float | str`"),
        ({"failure": 1}, "key 'failure': expected `str | null`"),
    ],
)
def test_a_damaged_result_is_refused_with_file_and_key(tmp_path, change, message):
    path = tmp_path / "results.json"
    good = record().to_dict()
    path.write_text(json.dumps({"results": [good, {**good, **change}]}))
    with pytest.raises(ResultError) as caught:
        read_results(path)
    assert str(caught.value).startswith(f"{path}: results[1]: ")
    assert message in str(caught.value)


def test_a_missing_key_is_refused_by_name():
    values = {key: value for key, value in record().to_dict().items() if key != "sequence"}
    with pytest.raises(ResultError, match="missing key 'sequence'"):
        ResultRecord.from_dict(values)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"results": [\n}', ":2: not valid JSON"),
        (b"[]", "expected an object with the list 'results'"),
        (b"\xff\xfe", "is not text"),
        (b"[" * 100_000, "not valid JSON: it is nested too deep"),
        (b'{"results": ["\\ud800"]}', "not valid JSON: .* surrogates not allowed"),
    ],
)
def test_a_file_that_is_no_result_is_refused(tmp_path, content, message):
    path = tmp_path / "results.json"
    path.write_bytes(content)
    with pytest.raises(ResultError, match=message):
        read_results(path)
    with pytest.raises(ResultError, match="no such file"):
        read_results(tmp_path / "absent.json")


def test_results_are_added_to_those_of_other_methods_sequences_and_splits(tmp_path):
    path = tmp_path / "results.json"
    before = [record(run=0), record(run=1), record(sequence="mini-02"), record(split="other"), record(method="b")]
    assert add_results(path, before, [{"method": "dead_reckoning"}, {"method": "b"}]) == []
    assert read_results(path) == before
    kept = add_results(path, [record(metrics={"ate_rmse_m": 0.25})], [{"method": "dead_reckoning", "clips": 1}])
    assert kept == before[2:]
    assert [each.metrics["ate_rmse_m"] for each in read_results(path)] == [0.5, 0.5, 0.5, 0.25]
    assert json.loads(path.read_text())["data_set"] == [{"method": "b"}, {"method": "dead_reckoning", "clips": 1}]


def test_results_that_are_added_at_once_are_all_kept(tmp_path):
    path = tmp_path / "out" / "results.json"

    def add(method):
        for number in range(10):
            add_results(path, [record(method=method, sequence=f"mini-{number:02d}")], [{"method": method}])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(add, "abcd"))
    found = sorted((each.method, each.sequence) for each in read_results(path))
    assert found == [(method, f"mini-{number:02d}") for method in "abcd" for number in range(10)]
    assert sorted(row["method"] for row in json.loads(path.read_text())["data_set"]) == list("abcd")
    assert sorted(file.name for file in path.parent.iterdir()) == [".results.json.lock", "results.json"]


def test_results_are_added_on_a_disk_without_locks(tmp_path, monkeypatch):
    def no_lock(handle, how):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", no_lock)
    add_results(tmp_path / "results.json", [record()])
    add_results(tmp_path / "results.json", [record(method="b")])
    assert [each.method for each in read_results(tmp_path / "results.json")] == ["dead_reckoning", "b"]


def test_aggregate_is_the_mean_over_sequences():
    rows = aggregate([record(), record(sequence="mini-02", metrics={"ate_rmse_m": 1.5, "coverage": 0.5})])
    (row,) = rows
    assert row["metrics"] == {"ate_rmse_m": 1.0, "coverage": 0.75}
    assert (row["sequences"], row["runs"], row["failures"]) == (2, 2, 0)
    assert (row["track"], row["split"], row["method"]) == ("slam", "slam-mini", "dead_reckoning")


def test_several_runs_on_one_sequence_have_one_vote():
    runs = [record(metrics={"ate_rmse_m": value}) for value in (1.0, 3.0)]
    (row,) = aggregate([*runs, record(sequence="mini-02", metrics={"ate_rmse_m": 4.0})])
    assert row["metrics"]["ate_rmse_m"] == 3.0
    assert (row["sequences"], row["runs"], row["counts"]["ate_rmse_m"]) == (2, 3, 2)


def test_a_failed_run_has_no_speed_whatever_it_says():
    metrics = {"wall_s": 4.0, "cpu_s": 1.5, "realtime_factor": 75.6, "cpu_s_per_s": 0.005}
    lost = record(metrics=metrics, failure="it answers nothing")
    assert lost.metrics == {"wall_s": 4.0, "cpu_s": 1.5, "score": 0.0, "coverage": 0.0}
    again = ResultRecord.from_dict({**lost.to_dict(), "metrics": metrics})
    assert again.metrics == lost.metrics


def test_a_failed_run_counts_with_score_and_coverage_zero_and_has_no_error():
    scored = record(metrics={"ate_rmse_m": 0.5, "score": 0.8, "coverage": 1.0})
    (row,) = aggregate([scored, failed(sequence="mini-02")])
    assert row["failures"] == 1
    assert row["metrics"] == {"ate_rmse_m": 0.5, "score": 0.4, "coverage": 0.5}
    assert row["counts"] == {"ate_rmse_m": 1, "score": 2, "coverage": 2}


def test_an_empty_sample_is_none_with_the_reason():
    (row,) = aggregate([record(metrics={"scale": math.nan, "coverage": 1.0}, reasons={"scale": "not asked for"})])
    assert row["metrics"]["scale"] is None
    assert row["reasons"]["scale"] == "not asked for"
    (row,) = aggregate([failed()])
    assert row["metrics"] == {"score": 0.0, "coverage": 0.0}
    assert "no run of dead_reckoning on slam-mini could be scored" in row["reasons"]["*"]
    assert aggregate([]) == []


def test_the_aggregate_holds_spread_and_says_why_there_is_no_interval():
    runs = [record(metrics={"ate_rmse_m": value}, run=i, seed=i) for i, value in enumerate((1.0, 3.0))]
    (row,) = aggregate(runs)
    found = row["statistics"]["ate_rmse_m"]
    assert (found["runs"], found["sequences"], found["low"], found["high"]) == (2, 1, 2.0, 2.0)
    assert found["run_deviation"] == pytest.approx(math.sqrt(2))
    assert found["interval"]["low"] is None
    assert found["interval"]["reason"].startswith("1 sequence")


def test_many_sequences_have_an_interval():
    (row,) = aggregate([record(sequence=f"s{i}", metrics={"ate_rmse_m": float(i)}) for i in range(9)])
    interval = row["statistics"]["ate_rmse_m"]["interval"]
    assert interval["low"] < row["metrics"]["ate_rmse_m"] == 4.0 < interval["high"]


def test_conditions_run_and_seed_survive_json():
    first = record(conditions={"water": "clear", "secchi_m": 6.1}, run=3, seed=17, truth_digest="cd")
    assert ResultRecord.from_dict(json.loads(first.to_json())) == first


@pytest.mark.parametrize(
    "change", [{"split_digest": "cd" * 32}, {"evaluator_version": "slam 2"}, {"settings": {"align": "se3"}}]
)
def test_what_cannot_be_compared_is_not_averaged(change):
    assert len(aggregate([record(), record(sequence="mini-02", **change)])) == 2


def test_the_document_is_strict_json():
    text = json.dumps(document([record(), failed()]), allow_nan=False)
    values = json.loads(text)
    assert values.keys() == {"results", "aggregate"}
    assert values["results"][0]["format"] == FORMAT
