"""Rollouts in a rendered reef: repeatable, fair to all policies, and refused where a policy misbehaves."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.exploration.references import REFERENCES
from oysterbench.exploration.rollout import explore
from oysterbench.methods.steering import Steering
from oysterbench.recipe import load_split
from oysterbench.render.camera import CameraRenderer
from oysterbench.simulation.simulated_sequence import build_sequence
from oysterbench.simulation.steering.site import build_site

SPLIT = load_split("steer-mini")
REEF = "mini-01"
SECONDS = 8.0


class Ahead:
    """Straight on, whatever it sees; keeps what it saw."""

    name, track = "ahead", "steering"

    def __init__(self):
        self.views = []

    def run(self, views):
        for view in views:
            self.views.append(view)
            yield Steering(view.name, yaw=views.task.yaw_deg.index(0.0), pitch=views.task.pitch_deg.index(0.0))


@pytest.fixture(scope="module")
def logs():
    return {policy: explore(SPLIT, REEF, policy, seconds=16.0)[0] for policy in REFERENCES}


@pytest.fixture(scope="module")
def ahead():
    policy = Ahead()
    log, _ = explore(SPLIT, REEF, policy, seconds=SECONDS)
    return policy, log


def same(one, other):
    return all(
        np.array_equal(getattr(one, f.name), getattr(other, f.name))
        for f in fields(one)
        if f.name not in ("wall_s", "cpu_s")
    )


def test_all_policies_begin_at_the_same_place(logs, ahead):
    starts = [log.states[0] for log in (*logs.values(), ahead[1])]
    assert all(np.array_equal(start, starts[0]) for start in starts)
    other, _ = explore(SPLIT, REEF, "random", seconds=1.0, start=1)
    assert not np.allclose(other.states[0], starts[0])


@pytest.mark.parametrize(
    "policy", [name if name == "random" else pytest.param(name, marks=pytest.mark.slow) for name in REFERENCES]
)
def test_the_same_rollout_twice_is_the_same(policy):
    first, second = (explore(SPLIT, REEF, policy, seconds=4.0)[0] for _ in range(2))
    assert same(first, second)


def test_the_expert_sees_more_than_lawnmower_and_random_walk(logs):
    seen = {policy: int(log.seen.sum()) for policy, log in logs.items()}
    assert seen["expert"] > 1.5 * max(seen["lawnmower"], seen["random"])


def test_a_log_adds_up(logs):
    for log in logs.values():
        steps = len(log.commands)
        assert log.states.shape == (steps + 1, 5)
        assert {len(log.altitude), len(log.seen), len(log.contact), len(log.turned), len(log.covered)} == {steps + 1}
        assert log.seen.sum() == log.found.sum()
        assert np.all(np.diff(log.covered) >= 0)
        assert 0 < log.covered[-1] < 1
        assert np.abs(log.states[:, :2]).max() <= log.half_m
        assert np.abs(log.oysters[:, :2]).max() <= log.half_m
        lengths = np.linalg.norm(np.diff(log.states[:, :3], axis=0), axis=1)
        free = ~(log.contact | log.turned)[1:]
        assert lengths[free].max() <= SPLIT.steering.speed_m_s * log.step_s + 1e-9


def test_the_hull_is_never_below_what_it_would_touch(logs):
    site = build_site(build_sequence(SPLIT, REEF, b""), SPLIT.steering)
    for log in logs.values():
        assert np.all(log.states[:, 2] >= site.floor(log.states[:, 0], log.states[:, 1]) - 1e-9)


def test_a_method_sees_pictures_and_what_its_sensors_tell(ahead):
    policy, log = ahead
    camera = SPLIT.rig.camera[0]
    assert len(policy.views) == len(log.commands) == SECONDS
    assert [view.name for view in policy.views] == [f"{k:06d}" for k in range(8)]
    for view, state, altitude in zip(policy.views, log.states, log.altitude, strict=False):
        assert view.pixels.shape == (camera.height, camera.width, 3)
        assert view.pixels.std() > 5
        assert view.state.altitude == pytest.approx(altitude, abs=1e-3)
        assert view.state.depth == pytest.approx(-state[2], abs=1e-3)
        assert view.state.heading == pytest.approx(state[3], abs=1e-3)
    assert not np.array_equal(policy.views[0].pixels, policy.views[1].pixels)


@pytest.mark.slow
def test_a_teacher_tells_the_action_values_and_takes_the_helm_as_often_as_asked():
    log, examples = explore(SPLIT, REEF, Ahead(), seconds=6.0, teacher=True)
    assert [view.name for view, _ in examples] == [f"{k:06d}" for k in range(6)]
    assert all(values.shape == (7, 7) for _, values in examples)
    assert {tuple(command) for command in log.commands.tolist()} == {(3, 3)}
    taught, _ = explore(SPLIT, REEF, Ahead(), seconds=6.0, mixture=1.0)
    expert, _ = explore(SPLIT, REEF, "expert", seconds=6.0)
    assert np.array_equal(taught.commands, expert.commands)


class Wrong(Ahead):
    def __init__(self, predict):
        super().__init__()
        self.predict = predict

    def run(self, views):
        views = iter(views)
        for view in views:
            if self.predict == "greedy":
                next(views)
            if self.predict == "crash":
                raise KeyError("weights")
            if self.predict == "stop":
                return
            yield self.predict(view)


@pytest.mark.parametrize(
    ("predict", "message"),
    [
        (lambda view: Steering(view.name, yaw=7, pitch=0), r"yaw: expected a class from 0 to 6, got 7"),
        (lambda view: Steering(view.name, yaw=1), r"pitch: expected a class from 0 to 6, got None"),
        (lambda view: Steering("x", yaw=1, pitch=1), r"expected a Steering of the view 000000, got Steering\(name='x'"),
        (lambda view: (3, 3), r"expected a Steering of the view 000000, got \(3, 3\)"),
        (
            lambda view: Steering(view.name, yaw_probability=np.array([0, 0, np.nan, 1, 0, 0, 0]), pitch=1),
            r"yaw_probability: expected 7 numbers",
        ),
        (lambda view: Steering(view.name, yaw_probability=np.ones(6), pitch=1), r"yaw_probability: expected 7 numbers"),
        (lambda view: Steering(view.name, yaw_probability=-np.ones(7), pitch=1), r"none below 0"),
        ("greedy", r"requested another view before giving a command at 000000"),
        ("crash", r"'ahead' failed, mini-01: rollout: KeyError"),
        ("stop", r"expected 2 commands, got 0"),
    ],
)
def test_a_policy_that_misbehaves_is_named(predict, message):
    with pytest.raises(MethodError, match=message):
        explore(SPLIT, REEF, Wrong(predict), seconds=2.0)


def test_of_equal_probabilities_the_one_nearest_to_straight_on_is_taken():
    class Unsure(Ahead):
        def run(self, views):
            for view in views:
                yield Steering(view.name, yaw_probability=np.array([1, 0, 1, 0, 0, 0, 1]), pitch_probability=np.ones(7))

    log, _ = explore(SPLIT, REEF, Unsure(), seconds=1.0)
    assert log.commands.tolist() == [[2, 3]]


def test_requests_that_cannot_be_met_are_refused():
    with pytest.raises(RecipeError, match="slam-mini has no table"):
        explore(load_split("slam-mini"), "mini-01", "expert")
    with pytest.raises(RecipeError, match="at least a step of 1 s, got 0"):
        explore(SPLIT, REEF, "expert", seconds=0.0)
    hasty = replace(SPLIT, steering=replace(SPLIT.steering, rollout_s=0.1))
    with pytest.raises(RecipeError, match=r"at least a step of 1 s, got 0\.1"):
        explore(hasty, REEF, "expert")
    with pytest.raises(ValueError, match="no reference policy 'shark'"):
        explore(SPLIT, REEF, "shark", seconds=1.0)
    with pytest.raises(RecipeError, match="no sequence 'reef-9'"):
        explore(SPLIT, "reef-9", "expert")


def test_with_another_salt_the_reef_is_another_and_so_is_the_start(ahead):
    """Last here: a process keeps one reef, and all others are over the one without a salt."""
    salted, _ = explore(SPLIT, REEF, "random", seconds=1.0, salt=b"another reef of the same kind")
    assert not np.allclose(salted.states[0], ahead[1].states[0])
    assert salted.oysters.shape != ahead[1].oysters.shape


def test_references_see_the_plants_as_they_sway_at_the_time(monkeypatch):
    times: list[float] = []
    truth = CameraRenderer.truth
    monkeypatch.setattr(
        CameraRenderer, "truth", lambda self, pose, time_s=0.0: times.append(time_s) or truth(self, pose, time_s)
    )
    explore(SPLIT, REEF, "random", seconds=4.0)
    assert times == [k * SPLIT.steering.step_s for k in range(len(times))]
    assert len(times) > 1
