"""What moves in the picture: its shape, who it is, where it goes, and that nothing else changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.recipe import CLASSES, LifeRecipe
from oysterbench.render.camera import CameraRenderer
from oysterbench.render.lens import project
from oysterbench.render.passage import STILL, Moment, passage
from oysterbench.render.rays import RayCaster
from oysterbench.scene.rig import camera_pose
from tests.helpers.living import ALL, living_reef, living_world
from tests.helpers.reefs import CAMERA, SPLIT, noise, world_of

NUMBER = {name: number for number, name in CLASSES.items()}
RECIPE = living_reef()
TIME, LATER = 6.0, 6.1


def bodies(*times_s):
    motion = living_world(RECIPE)[1].at(np.array(times_s))
    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = motion.rotation, motion.position
    return poses


@pytest.fixture(scope="module")
def renderer():
    world, _, life = living_world(RECIPE)
    return CameraRenderer(world, CAMERA, RECIPE, rig=SPLIT.rig, life=life)


MOUNT = camera_pose(dataclasses.replace(CAMERA, position_m=(0.2, 0.0, 0.0), pitch_deg=25.0))


def layers_at(renderer, time_s, names, later_s=LATER, **keys):
    now, then = bodies(time_s, later_s)
    following = Moment(later_s, then @ MOUNT, then)
    return renderer.layers(now @ MOUNT, names, time_s, now, following=following, **keys)


def looking_at(target, distance):
    """T_map_cam of a camera that looks at a place (3,) in `map` from the south, a little from above."""
    offset = distance * np.array([0.0, -0.9, 0.45])
    z = -offset / np.linalg.norm(offset)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = target + offset
    return T


def seen_points(T, depth):
    """Points (N, 3) in `map` that pixels show, and the pixels (N, 2): column, row."""
    rows, columns = np.nonzero(depth > 0)
    focal = CAMERA.width / 2 / np.tan(np.radians(CAMERA.hfov_deg / 2))
    z = depth[rows, columns].astype(float)
    local = np.column_stack([(columns - (CAMERA.width - 1) / 2) / focal, (rows - (CAMERA.height - 1) / 2) / focal, z])
    local[:, :2] *= z[:, None]
    return local @ T[:3, :3].T + T[:3, 3], np.column_stack([columns, rows])


@pytest.mark.parametrize("kind", ["fish", "crab", "debris", "tether"])
def test_each_thing_is_seen_where_its_truth_is(renderer, kind):
    life = living_world(RECIPE)[2]
    now = life.at(TIME)
    row = int(np.flatnonzero(now.classes == NUMBER[kind])[0])
    T = looking_at(now.positions[row].astype(float) + np.array([0.0, 0.0, 0.01]), 0.35)
    layers = renderer.layers(T, ["classes", "instances", "dynamic", "depth"], TIME, bodies(TIME)[0])
    seen = layers["instances"] == now.ids[row]
    assert seen.sum() > 15
    assert np.all(layers["classes"][seen] == NUMBER[kind])
    assert np.all(layers["dynamic"][seen] == 1)
    later = renderer.layers(T, ["instances"], TIME + 8.0, bodies(TIME)[0])
    assert (later["instances"] == now.ids[row]).sum() != seen.sum(), "it has moved"


def test_the_picture_of_a_moment_does_not_depend_on_those_before(renderer):
    body = bodies(TIME)[0]
    first = renderer.render(body @ MOUNT, noise(), TIME, body)
    renderer.render(body @ MOUNT, noise(), 11.3, body)
    again = renderer.render(body @ MOUNT, noise(), TIME, body)
    for layer in ("colour", "depth", "classes", "instances"):
        assert np.array_equal(getattr(first, layer), getattr(again, layer))


@pytest.mark.slow
def test_no_life_leaves_the_picture_as_it_was():
    still = living_reef(LifeRecipe())
    body = bodies(TIME)[0]
    plain = CameraRenderer(world_of(still), CAMERA, still, rig=SPLIT.rig).render(body @ MOUNT, noise(), TIME, body)
    world, _, life = living_world(still)
    ours = CameraRenderer(world, CAMERA, still, rig=SPLIT.rig, life=life).render(body @ MOUNT, noise(), TIME, body)
    assert np.array_equal(plain.colour, ours.colour)


def test_dynamic_is_what_moves_by_itself(renderer):
    layers = layers_at(renderer, TIME, ["classes", "dynamic"])
    moving = [NUMBER[name] for name in ("fish", "crab", "debris", "tether", "plant", "vehicle")]
    assert np.array_equal(layers["dynamic"] == 1, np.isin(layers["classes"], moving))


def test_flow_of_still_surfaces_is_that_of_their_projected_points(renderer):
    layers = layers_at(renderer, TIME, ["flow", "depth", "dynamic"])
    now, then = (pose @ MOUNT for pose in bodies(TIME, LATER))
    still = (layers["depth"] > 0) & (layers["dynamic"] == 0)
    points, pixels = seen_points(now, np.where(still, layers["depth"], 0.0))
    expected = project((points - then[:3, 3]) @ then[:3, :3], CAMERA) - pixels
    assert still.mean() > 0.5
    assert layers["flow"][pixels[:, 1], pixels[:, 0]] == pytest.approx(expected, abs=0.01)
    assert np.all(np.isnan(layers["flow"][layers["depth"] == 0]))


def test_flow_of_swaying_plants_is_that_of_their_lean(renderer):
    world, _, life = living_world(RECIPE)
    sway = life.sway
    plant = int(np.argmax(sway.heights))
    row = sway.rows[plant]
    root = world.instances.positions[row].astype(float)
    T, body = looking_at(root + np.array([0.0, 0.0, 0.1]), 0.4), bodies(TIME)[0]
    layers = renderer.layers(T, ["flow", "instances", "depth"], TIME, body, following=Moment(LATER, T, body))
    own = np.where(layers["instances"] == world.instances.ids[row], layers["depth"], 0.0)
    points, pixels = seen_points(T, own)
    now, then = (sway.lean(t)[plant].astype(float) for t in (TIME, LATER))
    height = (points[:, 2] - root[2]) / now[2]
    moved = points + height[:, None] * (then - now)
    expected = project((moved - T[:3, 3]) @ T[:3, :3], CAMERA) - pixels
    flow = layers["flow"][pixels[:, 1], pixels[:, 0]]
    assert np.abs(expected).max() > 0.5
    assert flow == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("kind", ["debris", "tether"])
def test_flow_of_stiff_things_is_that_of_their_pose(renderer, kind):
    life = living_world(RECIPE)[2]
    now, then = life.at(TIME), life.at(LATER)
    row = int(np.flatnonzero(now.classes == NUMBER[kind])[20 if kind == "tether" else 0])
    T, body = looking_at(now.positions[row].astype(float), 0.35), bodies(TIME)[0]
    layers = renderer.layers(T, ["flow", "instances", "depth"], TIME, body, following=Moment(LATER, T, body))
    points, pixels = seen_points(T, np.where(layers["instances"] == now.ids[row], layers["depth"], 0.0))
    local = (points - now.positions[row]) @ now.rotations[row] / now.scales[row]
    if kind == "tether":  # of all pieces' pixels, those of this one
        own = (local[:, 0] > 0) & (local[:, 0] < 1) & (np.abs(local[:, 1:]).max(axis=1) < 1.01)
        local, pixels = local[own], pixels[own]
    moved = (local * then.scales[row]) @ then.rotations[row].T.astype(float) + then.positions[row]
    expected = project((moved - T[:3, 3]) @ T[:3, :3], CAMERA) - pixels
    assert len(pixels) >= 4
    assert layers["flow"][pixels[:, 1], pixels[:, 0]] == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("kind", ["fish", "crab"])
def test_flow_of_what_bends_lands_on_it_at_the_next_moment(renderer, kind):
    life = living_world(RECIPE)[2]
    now = life.at(TIME)
    row = int(np.flatnonzero(now.classes == NUMBER[kind])[0])
    T, body = looking_at(now.positions[row].astype(float), 0.3), bodies(TIME)[0]
    layers = renderer.layers(T, ["flow", "instances"], TIME, body, following=Moment(LATER, T, body))
    mine = layers["instances"] == now.ids[row]
    then = renderer.layers(T, ["instances"], LATER, body)["instances"] == now.ids[row]
    rows, columns = np.nonzero(mine)
    landed = np.rint(np.column_stack([rows, columns]) + layers["flow"][mine][:, ::-1]).astype(int)
    inside = np.all((landed >= 0) & (landed < then.shape), axis=1)
    assert then[tuple(landed[inside].T)].mean() > 0.85


def test_flow_follows_a_rolling_shutter(renderer):
    camera = dataclasses.replace(CAMERA, readout_ms=30.0)
    world, _, life = living_world(RECIPE)
    rolling = CameraRenderer(world, camera, RECIPE, rig=SPLIT.rig, life=life)

    def passing(time_s):
        return passage(camera, 0.0, lambda after: [pose @ MOUNT for pose in bodies(*(time_s + after))])

    now, then = bodies(TIME, LATER)
    following = Moment(LATER, then @ MOUNT, then, passing(LATER))
    layers = rolling.layers(now @ MOUNT, ["flow", "dynamic", "depth"], TIME, now, passing(TIME), following)
    row, column = np.argwhere((layers["depth"] > 0) & (layers["dynamic"] == 0))[-800]
    T = passing(TIME).rows[row + 1]
    focal = CAMERA.width / 2 / np.tan(np.radians(CAMERA.hfov_deg / 2))
    z = float(layers["depth"][row, column])
    p = np.array([(column - 79.5) / focal * z, (row - 59.5) / focal * z, z]) @ T[:3, :3].T + T[:3, 3]
    poses = passing(LATER).rows
    misses = []
    for k, pose in enumerate(poses):
        u, v = project(((p - pose[:3, 3]) @ pose[:3, :3])[None], camera)[0]
        misses.append((abs(v - (k - 1)), u - column, v - row))
    assert layers["flow"][row, column] == pytest.approx(min(misses)[1:], abs=0.1)


def test_what_moves_is_blurred_along_its_way():
    """A fish that swims across for 0.1 s, against the mean of pictures of instants; a still camera."""
    world, _, life = living_world(RECIPE)
    renderer = CameraRenderer(world, CAMERA, RECIPE, rig=SPLIT.rig, life=life)
    now = life.at(TIME)
    row = int(np.flatnonzero(now.classes == NUMBER["fish"])[0])
    T, body = looking_at(now.positions[row].astype(float), 0.3), bodies(TIME)[0]
    open_s = 0.1
    moved = passage(CAMERA, open_s, lambda times: [T for _ in times])

    def picture(time_s, meanwhile=STILL):
        return renderer.render(T, noise(), time_s, body, meanwhile).colour.astype(float)

    blurred, sharp = picture(TIME, moved), picture(TIME)
    mean = np.mean([picture(TIME + open_s * ((k + 0.5) / 16 - 0.5)) for k in range(16)], axis=0)
    changed = np.abs(mean - sharp).max(axis=2) > 6
    assert changed.sum() > 60
    assert np.abs(blurred - mean)[changed].mean() < 0.75 * np.abs(sharp - mean)[changed].mean()


def test_plants_move_with_the_surge_in_the_picture(renderer):
    world, _, life = living_world(RECIPE)
    tallest = int(np.argmax(life.sway.heights))
    spot = world.instances.positions[life.sway.rows[tallest]].astype(float)
    times = np.arange(0, 20, 0.25)
    x = np.array([life.sway.tips(t)[tallest, 0] for t in times])
    left, right = times[np.argmin(x)], times[np.argmax(x)]
    T = looking_at(spot + np.array([0.0, 0.0, 0.08]), 0.6)
    number = world.instances.ids[life.sway.rows[tallest]]
    columns = []
    for time in (left, right):
        seen = renderer.layers(T, ["instances"], time, bodies(0.0)[0])["instances"] == number
        rows, found = np.nonzero(seen)
        columns.append(found[rows < np.percentile(rows, 25)].mean())
    focal = CAMERA.width / 2 / np.tan(np.radians(CAMERA.hfov_deg / 2))
    assert columns[1] - columns[0] > 0.4 * (x.max() - x.min()) * focal / 0.6


def test_sonars_hear_fish_where_they_are():
    world, _, life = living_world(RECIPE)
    caster = RayCaster(world, life=life)
    now = life.at(TIME)
    fish = now.take(now.classes == NUMBER["fish"])
    target = fish.positions[0].astype(float)
    start = target + np.array([0.0, 0.0, 0.4])
    down = np.array([[0.0, 0.0, -1.0]])
    assert caster.cast(start, down, 5.0).classes[0] != NUMBER["fish"], "nothing roams but at a time"
    with caster.at(TIME):
        echoes = caster.cast(start, down, 5.0)
    assert echoes.classes[0] == NUMBER["fish"]
    assert echoes.instances[0] == fish.ids[0]
    assert echoes.ranges[0] == pytest.approx(0.4, abs=0.03)
    assert caster.cast(start, down, 5.0).classes[0] != NUMBER["fish"]


def test_fish_throw_shadows():
    life = dataclasses.replace(ALL, tether=False, sway=0.0, surge_m=0.0, crabs=0, debris=0)
    recipe = living_reef(life, relief_rms_m=0.0, oysters=0, stones=0, plant_cover=0.0)
    sharp = dataclasses.replace(recipe.light, sky_fraction=0.0, sun_elevation_deg=89.0)
    recipe = dataclasses.replace(
        recipe, light=sharp, water=dataclasses.replace(recipe.water, jerlov="I"), duration_s=20.0
    )
    world, _, alive = living_world(recipe)
    camera = dataclasses.replace(CAMERA, hfov_deg=50.0)
    renderer = CameraRenderer(world, camera, recipe, life=alive)
    bare = CameraRenderer(world, camera, dataclasses.replace(recipe, life=LifeRecipe()))
    fish = alive.at(TIME)
    place = fish.positions[0].astype(float)
    T = looking_at(np.array([place[0], place[1], -3.0]), 1.2)
    body = np.eye(4)
    body[:3, 3] = [0.0, 0.0, -1.0]
    with_fish = renderer.layers(T, ["clean", "classes"], TIME, body)
    without = bare.layers(T, ["clean"], TIME, body)
    bottom = with_fish["classes"] == NUMBER["bottom"]
    ratio = with_fish["clean"][..., 1][bottom] / without["clean"][..., 1][bottom]
    assert ratio.min() < 0.6
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
