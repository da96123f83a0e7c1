"""The track steering where policies fail: limits of time, names in results, and where a failure ranks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oysterbench.core.errors import MachineError, MethodError, RecipeError
from oysterbench.evaluate.steering import Commands, Labels, failed_metrics, score_pictures
from oysterbench.exploration.rollout_store import unpacked
from oysterbench.methods.policy import classes_of
from oysterbench.methods.steering import Steering
from oysterbench.results.comparison import boards
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.scheduling import run_here
from oysterbench.tracks import Request, steering_rollouts
from oysterbench.tracks.steering import TRACK
from oysterbench.tracks.steering_rollouts import RolloutJob, make_rollout, plan_rollouts, run_rollouts
from tests.helpers.exploring_made import made_explore, made_split
from tests.helpers.exploring_policies import Reader

SPLIT = made_split()
TASK: Any = SPLIT.steering
POLICIES = "tests.helpers.exploring_policies"


class Random(Reader):
    """Has the name of a reference."""

    name = "random"


def test_a_split_of_another_track_has_no_rollouts(tiny_split):
    with pytest.raises(RecipeError, match="is of the track 'slam'"):
        plan_rollouts(tiny_split)


def test_a_rollout_that_takes_too_long_is_ended_and_the_others_go_on(tmp_path):
    plan = plan_rollouts(SPLIT, explore=made_explore, limit_s=1.5)
    failed, fine = run_rollouts(plan, ["one"], [f"{POLICIES}:Hanging", "random"], tmp_path)
    assert failed.record.failure == "method 'hanging': time limit of 1.5 s reached: killed"
    assert fine.record.failure is None


def test_a_policy_that_is_killed_from_outside_has_not_failed_and_what_was_made_before_is_kept(tmp_path):
    plan = plan_rollouts(SPLIT, 2, explore=made_explore)
    with pytest.raises(MachineError, match=r"^method 'killed': killed by SIGKILL .* the rollout is not counted"):
        run_rollouts(plan, ["one"], ["random", f"{POLICIES}:Killed"], tmp_path)
    said: list[str] = []
    run_rollouts(plan, ["one"], ["random"], tmp_path, announce=said.append)
    assert "kept 1 of 1 rollouts" in said[0]


def test_the_time_of_a_rollout_includes_that_of_its_policy():
    plan, job = plan_rollouts(SPLIT, 2, explore=made_explore), RolloutJob("one", f"{POLICIES}:Busy")
    assert unpacked(make_rollout(plan, job)).cpu_s > 0.4 + 0.3, "that of the loop, and its own"


def test_the_time_limit_that_is_asked_for_is_that_of_each_rollout(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "oysterbench.tracks.steering.run_rollouts", lambda plan, *rest: asked.append(plan.limit_s) or []
    )
    monkeypatch.setattr("oysterbench.tracks.steering.show_rollouts", lambda runs, out: None)
    for limit_s in (6.0, None):
        TRACK.evaluate(Request(tmp_path, SPLIT, options={"closed_loop": True}, limit_s=limit_s))
    assert asked == [6.0, 4 * 3600.0]


def test_policies_of_rollouts_side_by_side_share_the_cores(tmp_path, monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr(steering_rollouts, "default_workers", lambda: 6)
    monkeypatch.setattr(steering_rollouts, "run_in_processes", lambda task, jobs, *others: run_here(task, jobs))
    plan = plan_rollouts(SPLIT, 2, explore=made_explore)
    for workers, threads in ((4, 3), (1, None)):
        runs = run_rollouts(plan, ["one", "two"], [f"{POLICIES}:Threads"], tmp_path, workers)
        assert all(f"threads: {threads}" in run.record.failure for run in runs)


def test_a_policy_has_one_name_however_it_is_referred_to(tmp_path):
    runs = run_rollouts(
        plan_rollouts(SPLIT, 2, explore=made_explore), ["one"], [f"{POLICIES}:Short", "straight"], tmp_path
    )
    assert [run.record.method for run in runs] == ["short", "straight"]
    assert runs[0].record.failure.startswith("method 'short' on one: expected 2 commands")


def test_the_name_of_a_reference_is_refused(tmp_path):
    request = Request(tmp_path, SPLIT, methods=[f"{__name__}:Random"], options={"closed_loop": True})
    with pytest.raises(MethodError, match="'random' is the name of a reference"):
        TRACK.evaluate(request)


def shares(*most: int) -> np.ndarray:
    return np.isin(np.arange(7), most).astype(float)


def test_a_class_that_contradicts_its_probabilities_is_refused():
    with pytest.raises(
        MethodError, match="there: yaw: expected a class or probabilities, got 6 and, as most probable, 0"
    ):
        classes_of(Steering("a", yaw=6, pitch=3, yaw_probability=shares(0)), TASK, "there")
    with pytest.raises(MethodError, match=r"pitch: .* got 2\.5 and"):
        classes_of(Steering("a", yaw=6, pitch=2.5, pitch_probability=shares(2)), TASK, "there")


def test_a_class_that_agrees_with_its_probabilities_is_taken():
    assert classes_of(Steering("a", 6, 3, shares(6), shares(3)), TASK, "there") == (6, 3)
    assert classes_of(Steering("a", 6, 3, shares(1, 6)), TASK, "there") == (6, 3), "one of two that are most probable"
    assert classes_of(Steering("a", None, 3, shares(1, 6)), TASK, "there") in {(1, 3), (6, 3)}


def made_labels(seed: int) -> Labels:
    values = np.random.default_rng(seed).gamma(2.0, 5.0, (20, 7, 7))
    best = values.reshape(20, -1).argmax(axis=1)
    return Labels(np.column_stack(np.unravel_index(best, (7, 7))).astype(np.int64), values, TASK)


def test_no_answer_has_less_skill_than_a_failure():
    truth = made_labels(1)
    failed = failed_metrics(truth)["skill"]
    for yaw in range(7):
        for pitch in range(7):
            one_hot = [np.tile(np.eye(7)[k], (20, 1)) for k in (yaw, pitch)]
            found = score_pictures(truth, Commands(np.tile([yaw, pitch], (20, 1)), *one_hot))
            assert found.metrics["skill"] > failed
    worst = np.column_stack(np.unravel_index(truth.action_values.reshape(20, -1).argmin(axis=1), (7, 7)))
    even = np.full((20, 7), 1 / 7)
    assert score_pictures(truth, Commands(worst.astype(np.int64), even, even)).metrics["skill"] == failed < 0
    assert failed_metrics(Labels(truth.classes, np.ones((20, 7, 7)), TASK)) == {"skill": 0.0}, "no command matters"
    assert failed_metrics(Labels(truth.classes[:0], truth.action_values[:0], TASK)) == {"skill": 0.0}


def test_a_policy_that_fails_ranks_below_one_that_is_worse_than_chance():
    about = {"track": "steering", "split": "made"}
    records = []
    for k in range(8):
        failed = failed_metrics(made_labels(k))
        records.append(ResultRecord(**about, sequence=f"r{k}", method="crash", failure="it ended", metrics=failed))
        records.append(ResultRecord(**about, sequence=f"r{k}", method="bad", metrics={"skill": 0.9 * failed["skill"]}))
    (board,) = boards(records)
    assert [(row.label, row.standing.place, row.standing.rank) for row in board.standings] == [
        ("bad", 1, 1),
        ("crash", 2, 2),
    ]


def test_a_failure_never_has_more_than_nothing():
    for track, key in (("steering", "skill"), ("slam", "score")):
        claims = ResultRecord(
            track=track, split="made", sequence="one", method="bold", failure="it ended", metrics={key: 0.9}
        )
        assert claims.metrics[key] == 0.0
        assert replace(claims, metrics={}).metrics[key] == 0.0
