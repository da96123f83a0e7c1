"""Worlds: repeatable, counted once, and with nothing that floats."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.scene import library
from oysterbench.scene.oyster import STATES
from oysterbench.scene.world import World, build_world

RECIPE = load_split("slam-mini").sequence[0]


def recipe(**changes):
    reef = dataclasses.replace(RECIPE.reef, size_m=5.0, relief_rms_m=0.1, oysters=150, stones=12)
    return dataclasses.replace(RECIPE, reef=dataclasses.replace(reef, **changes))


SMALL = recipe()
FULL = recipe(
    oysters=None, density_per_m2=16.0, rocks=3, hash_per_m2=10.0, plant_cover=0.1, sponges_per_m2=2.0, bottom="mud"
)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(SMALL, Streams(9))


@pytest.fixture(scope="module")
def full() -> World:
    return build_world(FULL, Streams(9))


GROWN = recipe(infill_mm=10.0, algae_per_m2=4.0, litter_per_m2=2.0, shell_spread=0.8, plant_cover=0.05)


@pytest.mark.parametrize("of", [SMALL, FULL, GROWN])
def test_same_recipe_and_streams_give_the_same_arrays(of) -> None:
    one = build_world(of, Streams(9))
    library.build_shells.cache_clear()
    library.build_props.cache_clear()
    again = build_world(of, Streams(9))
    assert one.meshes[0] is not again.meshes[0]
    for field in dataclasses.fields(one.instances):
        assert np.array_equal(getattr(one.instances, field.name), getattr(again.instances, field.name)), field.name
    assert np.array_equal(one.terrain.heights, again.terrain.heights)
    assert np.array_equal(one.envelope, again.envelope)
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(one.meshes, again.meshes, strict=True))
    assert one.appearance == again.appearance
    assert one.oyster_table().equals(again.oyster_table())


def test_another_seed_gives_another_world(world: World) -> None:
    assert not np.array_equal(build_world(SMALL, Streams(10)).instances.positions, world.instances.positions)


def test_the_seed_of_the_appearance_says_nothing_of_what_a_salt_draws(world: World) -> None:
    seen = build_world(SMALL, Streams(9, b"salt")).appearance
    assert seen.generator("snow").random() != Streams(seen.seed).generator("snow").random()
    assert world.appearance == Streams(world.appearance.seed)  # the bytes of public splits come from the seed alone


def test_clutter_moves_no_oyster(world: World) -> None:
    more = build_world(recipe(hash_per_m2=10.0, plant_cover=0.1, rocks=2), Streams(9))
    assert np.array_equal(more.oysters.positions, world.oysters.positions)


def test_ids_count_oysters_from_one_then_stones(world: World) -> None:
    assert world.instances.ids.tolist() == list(range(1, 163))
    assert world.oysters.ids.tolist() == list(range(1, 151))
    assert world.stones.ids.tolist() == list(range(151, 163))


def test_everything_touches_the_ground_or_what_it_grows_on(full: World) -> None:
    """What rests on the bottom is sunk a little; what grows on another is set into its host by millimetres."""
    table = full.instances
    trees = {}
    for i in range(len(table)):
        host = int(table.hosts[i])
        if host == 0:
            vertices = table.vertices(full.meshes, i)
            over = vertices[:, 2] - full.ground_height(vertices[:, 0], vertices[:, 1])
            assert -over.min() == pytest.approx(float(table.sunk[i]), abs=2e-3)
            assert over.max() > 0
            assert -over.min() < 0.75 * (over.max() - over.min())  # enough shows
            continue
        assert host != table.ids[i]
        if host not in trees:
            vertices = table.vertices(full.meshes, host - 1)
            trees[host] = cKDTree(vertices)
        own = table.vertices(full.meshes, i)
        assert np.min(trees[host].query(own)[0]) < 0.008


def test_no_two_oysters_share_a_place(world: World) -> None:
    """Shells may be cemented together, but hardly any is swallowed by another."""
    oysters = world.oysters
    centres = np.einsum("nij,nj->ni", oysters.rotations.astype(float), oysters.scales * [0.5, 0.0, -0.05])
    centres = centres + oysters.positions
    pairs = cKDTree(centres).query_pairs(0.06, output_type="ndarray")
    gap = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    assert np.mean(gap < 0.1 * oysters.scales[pairs].max(axis=(1, 2))) < 0.02


def test_clumps_hold_three_to_fifteen(world: World) -> None:
    table = world.oyster_table()
    founders = np.flatnonzero((table.host == 0) & table.state.isin(["live", "box"]))
    sizes = np.diff(np.append(founders, np.sum(table.state.isin(["live", "box"]))))
    assert sizes.min() >= 3
    assert sizes.max() <= 16


@pytest.mark.parametrize(("size_mm", "least_deg"), [(40.0, 45.0), (90.0, 28.0)])
def test_small_shells_stand_up_in_their_clumps_and_large_ones_lean(size_mm: float, least_deg: float) -> None:
    oysters = build_world(recipe(oyster_size_mm=size_mm, oysters=400), Streams(9)).oysters
    rise = np.degrees(np.arcsin(oysters.rotations[oysters.hosts > 0, 2, 0]))
    assert least_deg < np.median(rise) < 65


def test_states_follow_the_recipes_shares() -> None:
    table = build_world(recipe(oysters=1000, size_m=10.0, box_share=0.2, valve_share=0.3), Streams(9)).oyster_table()
    share = table.state.value_counts(normalize=True)
    assert set(share.index) == set(STATES)
    assert share["box"] == pytest.approx(0.2, abs=0.05)
    assert share["left valve"] + share["right valve"] == pytest.approx(0.3, abs=0.05)
    valves = table[table.state.str.endswith("valve")]
    up = Rotation.from_quat(valves[["qx", "qy", "qz", "qw"]].to_numpy()).apply([0.0, 0.0, 1.0])[:, 2]
    assert 0.35 < np.mean(up > 0) < 0.65  # either side up


def test_density_is_honoured() -> None:
    for density in (5.0, 60.0):
        world = build_world(recipe(oysters=None, density_per_m2=density), Streams(9))
        assert len(world.oysters) / 25.0 == pytest.approx(density, rel=0.05)


def test_shell_heights_follow_the_recipe_and_stay_in_the_measured_range() -> None:
    heights = build_world(recipe(oysters=2000, size_m=12.0), Streams(9)).oyster_table().height_m
    assert heights.median() == pytest.approx(RECIPE.reef.oyster_size_mm * 1e-3, rel=0.05)
    assert heights.min() > 0.024
    assert heights.max() < 0.175
    assert heights.quantile(0.95) / heights.quantile(0.05) > 2


def test_table_agrees_with_the_meshes(world: World) -> None:
    table = world.oyster_table()
    row = table.index[(table.state == "left valve")][0]
    vertices = world.instances.vertices(world.meshes, row)
    shape = world.instances.shapes[row]
    solid = trimesh.Trimesh(vertices, world.meshes[shape].faces, process=False)
    assert solid.volume == pytest.approx(table.volume_m3[row], rel=1e-3)
    pose = Rotation.from_quat(table.loc[row, ["qx", "qy", "qz", "qw"]].to_numpy(dtype=float))
    own = pose.inv().apply(vertices - table.loc[row, ["x", "y", "z"]].to_numpy(dtype=float))
    assert np.ptp(own, axis=0) == pytest.approx(table.loc[row, ["height_m", "length_m", "width_m"]].tolist(), abs=1e-5)


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


def test_plants_are_no_obstacle_but_shade(full: World) -> None:
    plants = full.of_class("plant")
    assert len(plants) > 50
    assert np.all(full.envelope >= full.solid)
    assert np.mean(full.envelope > full.solid) > 0.01


def test_plants_root_beside_what_is_hard(full: World) -> None:
    hard = full.instances.take(np.isin(full.instances.classes, [2, 3]))
    around = [full.boxes[k][: len(hard), :2] for k in (0, 1)]
    roots = full.of_class("plant").positions[:, :2]
    within = np.all((roots[:, None] > around[0]) & (roots[:, None] < around[1]), axis=2).any(axis=1)
    assert within.mean() < 0.02  # boxes are wider than what they hold


def test_boxes_hold_their_shapes(full: World) -> None:
    lowers, uppers = full.boxes
    for i in range(0, len(full.instances), 11):
        vertices = full.instances.vertices(full.meshes, i)
        assert np.all(vertices >= lowers[i])
        assert np.all(vertices <= uppers[i])


def test_bare_reef_has_no_instances() -> None:
    assert len(build_world(recipe(oysters=0, stones=0), Streams(9)).instances) == 0


def test_too_many_instances_are_refused() -> None:
    with pytest.raises(RecipeError, match="65535"):
        build_world(recipe(oysters=63_000, stones=5_000), Streams(9))
