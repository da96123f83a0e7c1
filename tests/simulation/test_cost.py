"""What rendering takes is estimated before it starts, and measured over all interruptions."""

from __future__ import annotations

import dataclasses

import pytest

from oysterbench.recipe import load_split
from oysterbench.simulation import cost
from oysterbench.simulation.generate import generate_split


def test_twice_the_pictures_take_twice_the_time():
    split = load_split("slam-val")
    once = split.sequence[0]
    twice = dataclasses.replace(once, duration_s=2 * once.duration_s)
    building = cost.BUILDING_S * once.reef.oyster_count
    whole = cost.estimated(split, once) - building
    assert cost.estimated(split, twice) - building == pytest.approx(2 * whole)


def test_one_camera_of_two_takes_half_the_time_and_room():
    split = load_split("slam-val")
    one = split.sequence[0]
    building = cost.BUILDING_S * one.reef.oyster_count
    sonar = cost.estimated(split, one, topics=["/sonar_front/*"]) - building
    whole = cost.estimated(split, one) - building - sonar
    left = ("/cam_left/*", "/imu")
    assert cost.estimated(split, one, topics=left) - building == pytest.approx(whole / 2)
    assert cost.space(split, [one], left) == pytest.approx(cost.space(split, [one]) / 2, rel=1e-6)
    assert cost.estimated(split, one, topics=["/imu"]) == building


def test_a_dense_reef_takes_longer_than_a_bare_one():
    split = load_split("slam-val")
    bare, dense = split.find_sequence("val-05"), split.find_sequence("val-06")
    assert cost.estimated(split, dense) > 1.3 * cost.estimated(split, bare)


def test_what_a_sequence_took_is_kept_beside_it(tiny_split, tmp_path):
    generate_split(tiny_split, tmp_path)
    assert cost.measured(tmp_path)["tiny-01"] > 0


def test_a_line_that_a_kill_cut_off_costs_no_other(tmp_path):
    cost.add(tmp_path, 1.5)
    cost.add(tmp_path, 2.0)
    with open(tmp_path / "cost.log", "a") as file:
        file.write("0.7")
    cost.keep(tmp_path, "one", tmp_path)
    assert cost.measured(tmp_path) == {"one": 3.5}


@pytest.mark.parametrize("content", [None, "[1, 2]", "{", '{"one": null}'])
def test_a_file_of_costs_that_is_absent_or_damaged_tells_nothing(tmp_path, content):
    if content is not None:
        (tmp_path / cost.COSTS).write_text(content)
    assert cost.measured(tmp_path) == {}


def test_the_labels_of_an_expert_cost_more_than_the_images_of_a_steering_split():
    split = load_split("steer-mini")
    one = split.sequence[0]
    views = dataclasses.replace(split, track="slam", steering=None)
    assert cost.estimated(split, one) - cost.estimated(views, one) == pytest.approx(20 * cost.EXPERT_S)
    assert 9.0 < sum(cost.estimated(split, each) for each in split.sequence) < 20.0, "rendered, it took 11 to 20 s"
