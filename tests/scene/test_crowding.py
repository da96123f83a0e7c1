"""Shells of different clumps hardly stand in one another, and the measure of it is right where it is known."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe, load_split
from oysterbench.scene.collisions import Crowd
from oysterbench.scene.world import World, build_world
from tests.helpers.crowding import clump_roots, measure_crowding

RECIPE = load_split("slam-mini").sequence[0]
REEF = ReefRecipe(size_m=4.0, depth_m=3.0, relief_rms_m=0.02, density_per_m2=20.0, bottom="sand")


def world(**changes: Any) -> World:
    return build_world(dataclasses.replace(RECIPE, reef=dataclasses.replace(REEF, **changes)), Streams(3))


def test_roots_are_the_oysters_that_lie_on_the_bottom() -> None:
    assert clump_roots(np.array([0, 1, 2, 0, 4, 3])).tolist() == [0, 0, 0, 3, 3, 0]


def test_an_oyster_laid_on_its_own_place_again_is_wholly_inside() -> None:
    one = world(oysters=3, density_per_m2=None)
    instances = one.instances.take(np.array([0, 0, 0]))
    apart = instances.positions + np.array([[0, 0, 0], [0, 0, 0], [3, 0, 0]], np.float32)
    moved = dataclasses.replace(instances, positions=apart, ids=np.arange(1, 4).astype(np.uint16))
    crowding = measure_crowding(dataclasses.replace(one, instances=moved))
    assert crowding.strange.tolist() == pytest.approx([1.0, 1.0, 0.0])
    assert crowding.deep_share == pytest.approx(2 / 3)
    assert crowding.kin.max() == 0.0


def test_a_crowd_is_felt_where_it_stands_and_nowhere_else() -> None:
    scales, turned = np.full((1, 3), 0.1), np.eye(3)[None]
    crowd = Crowd(np.zeros((1, 3)), turned, scales)
    places = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.05]])
    overlap = crowd.overlap(places, np.repeat(turned, 4, axis=0), np.repeat(scales, 4, axis=0))
    assert overlap[0] > overlap[1] > 0
    assert overlap[2:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("size_mm", "density_per_m2", "most"),
    [
        (85, 50, 0.004),
        pytest.param(85, 200, 0.025, marks=pytest.mark.slow),
        pytest.param(40, 600, 0.013, marks=pytest.mark.slow),
        pytest.param(85, 600, 0.38, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_few_oysters_stand_deep_in_those_of_other_clumps(size_mm: int, density_per_m2: int, most: float) -> None:
    crowding = measure_crowding(world(oyster_size_mm=float(size_mm), density_per_m2=float(density_per_m2)))
    print(f"{size_mm} mm, {density_per_m2}/m2: deep {crowding.deep_share:.4f}, in kin {crowding.kin.mean():.3f}")
    assert crowding.deep_share <= most
