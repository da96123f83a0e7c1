"""Worlds: repeatable, with everything resting on the relief and counted once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from oysterbench.errors import RecipeError
from oysterbench.recipe import load_split
from oysterbench.scene.props import build_stone
from oysterbench.scene.world import World, build_world
from oysterbench.streams import Streams

RECIPE = load_split("slam-mini").sequence[0]
SMALL = dataclasses.replace(
    RECIPE, reef=dataclasses.replace(RECIPE.reef, size_m=5.0, oysters=150, stones=12, relief_rms_m=0.1)
)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SMALL, Streams(9))


def test_same_recipe_and_streams_give_the_same_arrays(world: World) -> None:
    again = build_world(SMALL, Streams(9))
    for field in dataclasses.fields(world.instances):
        assert np.array_equal(getattr(world.instances, field.name), getattr(again.instances, field.name)), field.name
    assert np.array_equal(world.terrain.heights, again.terrain.heights)
    assert np.array_equal(world.envelope, again.envelope)
    assert world.texture_seed == again.texture_seed


def test_another_seed_gives_another_world(world: World) -> None:
    assert not np.array_equal(build_world(SMALL, Streams(10)).instances.positions, world.instances.positions)


def test_ids_count_oysters_from_one_then_stones(world: World) -> None:
    assert world.instances.ids.tolist() == list(range(1, 163))
    assert world.oysters.ids.tolist() == list(range(1, 151))
    assert world.stones.ids.tolist() == list(range(151, 163))


def test_everything_touches_the_ground_and_nothing_is_buried(world: World) -> None:
    for i in range(len(world.instances)):
        vertices = world.instances.vertices(world.meshes, i)
        over = vertices[:, 2] - world.ground_height(vertices[:, 0], vertices[:, 1])
        assert -over.min() == pytest.approx(float(world.instances.sunk[i]), abs=1e-3)
        assert over.min() < 0 < over.max()
        assert -over.min() < 0.6 * (over.max() - over.min())


def test_shell_heights_follow_the_recipe(world: World) -> None:
    assert np.median(world.oysters.scales[:, 0]) == pytest.approx(RECIPE.reef.oyster_size_mm * 1e-3, rel=0.1)


def test_oysters_are_clumped(world: World) -> None:
    places = world.oysters.positions[:, :2].astype(float)
    distances = np.linalg.norm(places[:, None] - places, axis=-1)
    np.fill_diagonal(distances, np.inf)
    scattered = 0.5 / np.sqrt(150 / 25.0)  # mean distance to the nearest neighbour of a Poisson process
    assert distances.min(axis=1).mean() < 0.6 * scattered


def test_obstacle_height_bounds_seabed_and_shells(world: World) -> None:
    for i in range(0, len(world.instances), 7):
        vertices = world.instances.vertices(world.meshes, i)
        assert np.all(world.obstacle_height(vertices[:, 0], vertices[:, 1]) >= vertices[:, 2] - 1e-6)
    x, y = np.random.default_rng(0).uniform(-30, 30, (2, 500))
    assert np.all(world.obstacle_height(x, y) >= world.ground_height(x, y))
    assert np.shape(world.obstacle_height(0.0, 0.0)) == ()


def test_boxes_hold_their_shapes(world: World) -> None:
    lowers, uppers = world.boxes()
    vertices = world.instances.vertices(world.meshes, 20)
    assert np.all(vertices >= lowers[20])
    assert np.all(vertices <= uppers[20])


def test_stones_are_watertight() -> None:
    stone = build_stone(Streams(1).generator("stone"))
    mesh = trimesh.Trimesh(stone.vertices, stone.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0.5


def test_bare_reef_has_no_instances() -> None:
    bare = dataclasses.replace(SMALL, reef=dataclasses.replace(SMALL.reef, oysters=0, stones=0))
    assert len(build_world(bare, Streams(9)).instances) == 0


def test_too_many_instances_are_refused() -> None:
    crowded = dataclasses.replace(SMALL, reef=dataclasses.replace(SMALL.reef, oysters=63_000, stones=5_000))
    with pytest.raises(RecipeError, match="65535"):
        build_world(crowded, Streams(9))
