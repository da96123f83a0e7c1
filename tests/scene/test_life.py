"""What moves by itself: where it is over time, who it is, and how plants sway, each against its recipe."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from oysterbench.core.streams import Streams
from oysterbench.recipe import LIFE_CLASSES, LifeRecipe
from oysterbench.scene.instances import CLASS_NUMBERS
from oysterbench.scene.life import build_life
from oysterbench.scene.life.fish import FORMS, PHASES, build_fish
from oysterbench.scene.life.school import School
from oysterbench.scene.life.sway import REACH, life_waves
from oysterbench.scene.life.tether import STERN
from oysterbench.scene.waves import dispersion
from tests.helpers.living import ALL, living_reef, living_world
from tests.helpers.reefs import world_of

RECIPE = living_reef()
TIMES = np.arange(0.0, 20.0, 0.1)


@pytest.fixture(scope="module")
def life():
    return living_world(RECIPE)[2]


def test_who_is_there_is_what_the_recipe_says(life):
    table = life.table()
    assert table["class"].value_counts().to_dict() == {"fish": 15, "debris": 6, "crab": 3, "tether": 1}
    world = living_world(RECIPE)[0]
    assert table["id"].tolist() == list(range(len(world.instances) + 2, len(world.instances) + 2 + 25))
    lengths = table.loc[table["group"] == 1, "size_m"]
    assert len(lengths) == ALL.school_size
    assert lengths.median() == pytest.approx(ALL.school_fish_cm * 1e-2, rel=0.1)


def test_identities_are_the_same_at_any_time_and_built_again(life):
    first, later = life.at(0.0), life.at(13.7)
    for same in ("ids", "classes", "colours"):
        assert np.array_equal(getattr(first, same), getattr(later, same))
    assert np.array_equal(first.scales[first.classes != CLASS_NUMBERS["tether"]], later.scales[first.classes != 11])
    world, path, _ = living_world(RECIPE)
    again = build_life(RECIPE, world, path, Streams(4))
    again.at(3.0)  # what was asked before changes nothing
    for name in ("positions", "rotations", "shapes", "scales"):
        assert np.array_equal(getattr(again.at(13.7), name), getattr(later, name))


def test_a_fish_more_changes_no_other_thing(life):
    world, path, _ = living_world(RECIPE)
    more = build_life(dataclasses.replace(RECIPE, life=dataclasses.replace(ALL, crabs=4)), world, path, Streams(4))
    fish = life.at(5.0).classes == CLASS_NUMBERS["fish"]
    others = more.at(5.0).classes == CLASS_NUMBERS["fish"]
    assert np.array_equal(life.at(5.0).positions[fish], more.at(5.0).positions[others])


def test_everything_keeps_to_the_water_and_off_the_bottom(life):
    world = living_world(RECIPE)[0]
    for time in TIMES[::20]:
        now = life.at(time)
        swimming = np.isin(now.classes, [CLASS_NUMBERS["fish"], CLASS_NUMBERS["debris"]])
        x, y, z = now.positions[swimming].T
        assert z.max() < -0.1
        assert np.all(z > world.obstacle_height(x, y) - 0.01)
        crabs = now.positions[now.classes == CLASS_NUMBERS["crab"]]
        under = world.obstacle_height(*crabs[:, :2].T)
        assert np.all(crabs[:, 2] < under + 0.02)
        assert np.all(crabs[:, 2] > world.ground_height(*crabs[:, :2].T) - 0.02)


def test_fish_swim_forwards_at_the_speed_of_the_recipe(life):
    school = next(group for group in life.groups if isinstance(group, School))
    points = school.positions(TIMES)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=2) / 0.1
    assert np.median(speed) == pytest.approx(ALL.school_speed_m_s, rel=0.35)
    assert np.percentile(speed, 99) < 1.0
    state = school.at(4.0)
    ahead = school.positions(np.array([3.95, 4.05]))
    way = ahead[1] - ahead[0]
    assert np.all(np.einsum("ni,ni->n", state.rotations[:, :, 0], way) > 0.85 * np.linalg.norm(way, axis=1))


@pytest.mark.slow
def test_each_school_and_fish_is_met_by_the_vehicle(life):
    path = living_world(RECIPE)[1]
    for group in life.groups:
        if group.class_name == "tether":
            continue
        near = [np.linalg.norm(group.at(t).positions - path.at(np.array([t])).position, axis=1).min() for t in TIMES]
        assert min(near) < 2.6, group.kind


def test_fish_give_way_to_the_vehicle(life):
    path = living_world(RECIPE)[1]
    for time in TIMES[::5]:
        now = life.at(time)
        fish = now.positions[now.classes == CLASS_NUMBERS["fish"]]
        assert np.linalg.norm(fish - path.at(np.array([time])).position, axis=1).min() > 0.3


def test_the_tether_hangs_from_the_stern_to_the_surface(life):
    path = living_world(RECIPE)[1]
    now = life.at(12.0)
    pieces = now.take(now.classes == CLASS_NUMBERS["tether"])
    assert len(np.unique(pieces.ids)) == 1
    motion = path.at(np.array([12.0]))
    stern = motion.position[0] + motion.rotation[0] @ STERN
    assert np.linalg.norm(pieces.positions[0] - stern) < 2e-3
    ends = pieces.positions + pieces.rotations[:, :, 0] * pieces.scales[:, :1]
    assert np.allclose(ends[:-1], pieces.positions[1:], atol=1e-4), "the pieces hang together"
    assert ends[-1, 2] == pytest.approx(0.0, abs=0.25), "but for the waves"


def test_swaying_tips_follow_the_water_in_amplitude_period_and_phase(life):
    world = living_world(RECIPE)[0]
    sway, waves = life.sway, life_waves(RECIPE, Streams(4))
    times = np.arange(0.0, 300.0, 0.1)
    plant = int(np.argmax(sway.heights))
    place = world.instances.positions[sway.rows[plant]].astype(float)
    place[2] = -waves.depth_m
    moved = waves.displacement(np.tile(place, (len(times), 1)), times)[:, :2]
    ours = np.array([sway.water(t)[plant] for t in times])
    assert np.abs(ours - moved).max() < 3e-3, "waves shorter than the bottom feels are left out"
    # Significant displacement of the surge is twice its standard deviation, by definition of wave_height_m.
    assert 2 * np.sqrt((moved**2).sum(axis=1).mean()) == pytest.approx(ALL.surge_m, rel=0.25)
    spectrum = np.abs(np.fft.rfft(moved[:, 0])) ** 2
    peak = 1 / np.fft.rfftfreq(len(times), 0.1)[np.argmax(spectrum)]
    assert 0.7 * ALL.surge_period_s < peak < 1.8 * ALL.surge_period_s
    tips = np.array([sway.tips(t)[plant] for t in times])
    assert np.abs(tips).max() <= REACH * sway.heights[plant]
    small = np.linalg.norm(moved, axis=1) < 0.2 * sway.heights[plant]
    assert tips[small] == pytest.approx(ours[small], abs=0.01)


def test_plants_sway_in_phase_over_metres(life):
    world = living_world(RECIPE)[0]
    sway = life.sway
    places = world.instances.positions[sway.rows, :2]
    length = 2 * np.pi / dispersion(np.array([2 * np.pi / ALL.surge_period_s]), 3.0)[0]
    near = np.linalg.norm(places - places[0], axis=1) < length / 10
    water = np.array([sway.water(t) for t in np.arange(0, 60, 0.5)])[:, :, 0]
    correlation = np.corrcoef(water[:, near].T)[0]
    assert near.sum() > 5
    assert correlation.min() > 0.8


def test_nothing_moves_without_life():
    still = living_reef(LifeRecipe())
    world, _, life = living_world(still)
    assert life is None
    assert np.array_equal(world.instances.positions, world_of(RECIPE).instances.positions), "life draws from no other"


@pytest.mark.parametrize("species", FORMS)
def test_fish_are_closed_and_beat_their_tails(species):
    shapes = [build_fish(species, 2 * np.pi * k / PHASES) for k in range(PHASES)]
    for mesh in shapes:
        assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
        assert np.array_equal(mesh.faces, shapes[0].faces)
    tail = shapes[0].vertices[:, 0] < -0.49
    swing = np.ptp([mesh.vertices[tail, 1].mean() for mesh in shapes])
    assert 0.08 < swing < 0.25, "twice a tenth of the length (Videler & Hess 1984)"


def test_the_classes_of_life_come_after_those_that_were():
    assert LIFE_CLASSES == {8: "fish", 9: "crab", 10: "debris", 11: "tether"}
