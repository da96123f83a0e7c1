"""The vehicle: arcs at constant speed, a limit of pitch, and a fence that turns it back like a ball."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.recipe import load_split
from oysterbench.simulation.steering.vehicle import advance, folded, nearest_class, rotations, state_of, turns

TASK = load_split("steer-mini").steering
START = np.array([[1.0, 2.0, -3.0, 0.4, 0.0]])


def step(states, yaw_deg, pitch_deg=0.0):
    return advance(states, np.radians([yaw_deg]), np.radians([pitch_deg]), TASK)[:, -1]


def test_straight_on_goes_along_the_bow_at_the_speed_of_the_task():
    end = step(START, 0.0)
    way = TASK.speed_m_s * TASK.step_s
    assert end[0] == pytest.approx([1 + way * np.cos(0.4), 2 + way * np.sin(0.4), -3, 0.4, 0])


def test_a_turn_to_the_left_is_an_arc_that_turns_counter_clockwise():
    end = step(START, 30.0)[0]
    radius = TASK.speed_m_s * TASK.step_s / np.radians(30)
    centre = START[0, :2] + radius * np.array([-np.sin(0.4), np.cos(0.4)])
    assert np.linalg.norm(end[:2] - centre) == pytest.approx(radius, rel=1e-3)
    assert end[3] == pytest.approx(0.4 + np.radians(30))


def test_twelve_equal_turns_of_thirty_degrees_close_a_circle():
    states = START
    for _ in range(12):
        states = step(states, -30.0)
    assert states[0, :3] == pytest.approx(START[0, :3], abs=1e-9)


def test_bow_down_goes_down_and_stops_at_the_limit():
    states = START
    depths = []
    for _ in range(4):
        states = step(states, 0.0, 24.0)
        depths.append(states[0, 2])
    assert np.degrees(states[0, 4]) == pytest.approx(TASK.max_pitch_deg)
    assert np.all(np.diff(depths) < 0)
    fall = TASK.speed_m_s * TASK.step_s * np.sin(np.radians(TASK.max_pitch_deg))
    assert depths[-2] - depths[-1] == pytest.approx(fall)


def test_a_state_gives_its_rotation_and_comes_back_from_it():
    states = np.array([[0, 0, 0, 0.7, 0.3], [1, 2, 3, -2.9, -0.5]])
    expected = Rotation.from_euler("ZY", states[:, 3:]).as_matrix()
    assert rotations(states) == pytest.approx(expected)
    for state, rotation in zip(states, expected, strict=True):
        assert state_of(state[:3], rotation) == pytest.approx(state)


def test_the_fence_turns_back_like_a_wall():
    states = np.array([[4.3, 1.0, -3, 0.2, 0.1], [0.0, -4.5, -3, -2.0, 0.0], [1.0, 1.0, -3, 1.0, 0.0]])
    inside, turned = folded(states, 4.0)
    assert turned.tolist() == [True, True, False]
    assert inside[:, 0] == pytest.approx([3.7, 0.0, 1.0])
    assert inside[:, 1] == pytest.approx([1.0, -3.5, 1.0])
    before = np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])])
    after = np.stack([np.cos(inside[:, 3]), np.sin(inside[:, 3])])
    assert after == pytest.approx(before * [[-1, 1, 1], [1, -1, 1]])


def test_the_nearest_class_to_a_turn():
    yaw, pitch = turns(TASK)
    assert [nearest_class(np.radians(d), yaw) for d in (90, 14, 0, -16)] == [0, 2, 3, 5]
    assert nearest_class(np.radians(-9), pitch) == 2
