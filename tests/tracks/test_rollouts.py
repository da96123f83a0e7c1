"""Rollouts of policies in closed loop: kept, resumed, made anew, and what their records say."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError, ResultError
from oysterbench.exploration.rollout_store import packed, unpacked
from oysterbench.results.records import ResultRecord
from oysterbench.tracks.steering_rollouts import REFERENCES, plan_rollouts, run_rollouts
from tests.helpers.exploring_made import made_explore, made_log, made_split

SPLIT = made_split()

POLICIES = "tests.helpers.exploring_policies"


def test_a_rollout_is_read_as_it_was_written():
    log = made_log("one", "expert", 5, [1, 2, 3])
    data = packed(log)
    assert data == packed(log)
    back = unpacked(data)
    for field in dataclasses.fields(log):
        own, read = getattr(log, field.name), getattr(back, field.name)
        assert np.array_equal(own, read)
        assert type(own) is type(read)
        assert getattr(own, "dtype", None) == getattr(read, "dtype", None)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nothing", b"\x93NUMPY"])
def test_a_damaged_rollout_is_refused_by_name(tmp_path, damage):
    plan = plan_rollouts(SPLIT, explore=made_explore)
    run_rollouts(plan, ["one"], ["expert"], tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(damage)
    with pytest.raises(ResultError, match=rf"{file.name}.*--again"):
        run_rollouts(plan, ["one"], ["expert"], tmp_path)
    assert run_rollouts(plan, ["one"], ["expert"], tmp_path, again=True)[0].log is not None


def counted(calls):
    """`made_explore`, which notes what it was asked for."""

    def explore(split, reef, policy, **options):
        calls.append((reef, policy if isinstance(policy, str) else policy.name, options["seconds"]))
        return made_explore(split, reef, policy, **options)

    return explore


def test_finished_rollouts_are_kept_and_made_anew_where_anything_is_different(tmp_path):
    calls: list = []
    plan = plan_rollouts(SPLIT, explore=counted(calls))
    policies = [POLICIES + ":WithOption", *REFERENCES]
    told: list = []
    first = run_rollouts(
        plan, ["one", "two"], policies, tmp_path, progress=lambda done, total: told.append((done, total))
    )
    assert len(calls) == 8
    assert told == [(k, 8) for k in range(9)]
    names = ["with-option", *REFERENCES]
    assert [(run.record.sequence, run.record.method) for run in first[:4]] == [("one", name) for name in names]
    calls.clear()
    again = run_rollouts(plan, ["one", "two"], policies, tmp_path, announce=calls.append)
    assert [calls.pop()[-20:], *calls] == ["--again repeats them"], "told of, and none made"
    assert [run.record.metrics for run in again] == [run.record.metrics for run in first]

    run_rollouts(plan_rollouts(SPLIT, 7, explore=counted(calls)), ["one"], policies, tmp_path)
    assert {seconds for _, _, seconds in calls} == {7.0}
    assert len(calls) == 4
    calls.clear()
    run_rollouts(plan, ["one"], [POLICIES + ":WithOption[gain=2]"], tmp_path)
    assert len(calls) == 1
    calls.clear()
    other = dataclasses.replace(SPLIT, seed=8, source=SPLIT.source.replace("seed = 7", "seed = 8"))
    run_rollouts(plan_rollouts(other, explore=counted(calls)), ["one"], ["expert"], tmp_path)
    assert len(calls) == 1
    calls.clear()
    run_rollouts(plan, ["one"], ["expert"], tmp_path, again=True)
    assert len(calls) == 1


def test_what_again_began_is_resumed_without_the_rollouts_of_before(tmp_path):
    calls: list = []
    run_rollouts(plan_rollouts(SPLIT, explore=counted([])), ["one", "two"], ["expert"], tmp_path)

    def stopped(split, reef, policy, **options):
        if calls:
            raise KeyboardInterrupt
        return counted(calls)(split, reef, policy, **options)

    with pytest.raises(KeyboardInterrupt):
        run_rollouts(plan_rollouts(SPLIT, explore=stopped), ["one", "two"], ["expert"], tmp_path, again=True)
    calls.clear()
    run_rollouts(plan_rollouts(SPLIT, explore=counted(calls)), ["one", "two"], ["expert"], tmp_path)
    assert [reef for reef, *_ in calls] == ["two"]


def test_an_interrupted_evaluation_goes_on_from_there(tmp_path):
    calls: list = []

    def stopped(split, reef, policy, **options):
        if len(calls) == 2:
            raise KeyboardInterrupt
        return counted(calls)(split, reef, policy, **options)

    with pytest.raises(KeyboardInterrupt):
        run_rollouts(plan_rollouts(SPLIT, explore=stopped), ["one", "two"], REFERENCES, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    calls.clear()
    runs = run_rollouts(plan_rollouts(SPLIT, explore=counted(calls)), ["one", "two"], REFERENCES, tmp_path)
    assert [call[:2] for call in calls] == [("one", "random"), *(("two", policy) for policy in REFERENCES)]
    assert all(run.log is not None for run in runs)


@pytest.mark.slow
def test_processes_make_the_rollouts_that_one_makes(tmp_path):
    plan = plan_rollouts(SPLIT, explore=made_explore)
    policies = [POLICIES + ":Reader", *REFERENCES]
    alone = run_rollouts(plan, ["one", "two"], policies, tmp_path / "1")
    several = run_rollouts(plan, ["one", "two"], policies, tmp_path / "2", workers=2)
    metrics = [[{**run.record.metrics, "cpu_s": None} for run in runs] for runs in (alone, several)]  # it is measured
    assert metrics[0] == metrics[1]
    names = [sorted(path.name for path in (tmp_path / name).iterdir()) for name in "12"]
    assert names[0] == names[1]
    for name in names[0]:
        one, other = (unpacked((tmp_path / number / name).read_bytes()) for number in "12")
        assert packed(dataclasses.replace(one, cpu_s=0.0)) == packed(dataclasses.replace(other, cpu_s=0.0))


@pytest.mark.parametrize(
    ("policy", "message"),
    [pytest.param("Broken", "no such weight", marks=pytest.mark.slow), ("Short", "12 commands, got 1")],
)
def test_a_policy_that_fails_leaves_a_failure_and_is_tried_again(tmp_path, policy, message):
    plan = plan_rollouts(SPLIT, explore=made_explore)
    failed, fine = run_rollouts(plan, ["one"], [f"{POLICIES}:{policy}", "random"], tmp_path)
    assert message in failed.record.failure
    assert failed.record.metrics == {"oysters_per_min": 0.0}
    assert failed.log is None
    assert fine.record.metrics["oysters_per_min"] == 13 / 0.2
    assert len(list(tmp_path.iterdir())) == 1
    calls: list = []
    run_rollouts(
        plan_rollouts(SPLIT, explore=counted(calls)),
        ["one"],
        [f"{POLICIES}:{policy}", "random"],
        tmp_path,
    )
    assert len(calls) == 1


def test_records_of_rollouts_say_all_that_decides_them(tmp_path):
    (run,) = run_rollouts(plan_rollouts(SPLIT, 6, explore=made_explore), ["two"], [POLICIES + ":WithOption"], tmp_path)
    record = run.record
    assert (record.track, record.split, record.sequence) == ("exploration", "made", "two")
    assert record.settings == {"rollout_s": 6.0, "start": 0}
    assert record.method_settings == {"gain": 1.0}
    assert record.conditions["water_type"] == "5C"
    assert record.truth_digest
    assert ResultRecord.from_dict(json.loads(record.to_json())) == record


@pytest.mark.slow
def test_rollouts_over_a_rendered_reef_fit_what_they_are_scored_by(tmp_path):
    """The real loop, small: what a log says of itself agrees, and a second evaluation finds the same rollouts."""
    plan = plan_rollouts(SPLIT, 4)
    policies = ["straight", "random"]
    runs = run_rollouts(plan, ["one"], policies, tmp_path)
    for run in runs:
        log = run.log
        assert run.record.failure is None
        assert len(log.commands) == 4
        assert len(log.states) == len(log.seen) == len(log.altitude) == len(log.covered) == 5
        assert log.seen.sum() == log.found.sum()
        assert (np.diff(log.covered) >= 0).all()
        assert (np.abs(log.states[:, :2]) <= log.half_m).all()
        assert run.record.metrics["oysters_seen"] <= len(log.oysters)
        assert run.record.metrics["distance_m"] == pytest.approx(4 * 0.5, rel=0.05)
    first, second = (run.log for run in runs)
    assert (first.commands == 3).all()
    assert (first.states[0] == second.states[0]).all()  # all begin at the same place
    assert runs[0].record.truth_digest == runs[1].record.truth_digest
    anew = run_rollouts(plan, ["one"], policies, tmp_path / "anew")
    for run, other in zip(runs, anew, strict=True):
        for field in dataclasses.fields(run.log):
            if field.name not in ("wall_s", "cpu_s"):
                assert np.array_equal(getattr(run.log, field.name), getattr(other.log, field.name)), field.name


@pytest.mark.parametrize("seconds", [0, -3, float("nan"), float("inf"), 0.4])
def test_a_rollout_without_a_step_is_refused(seconds):
    with pytest.raises(RecipeError, match="--seconds: expected at least 1"):
        plan_rollouts(SPLIT, seconds)
