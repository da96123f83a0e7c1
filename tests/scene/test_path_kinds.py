"""Kinds of path: each is what it is called, within the vehicle's limits, and exact for an inertial unit."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import GRAVITY
from oysterbench.core.streams import Streams
from oysterbench.recipe import PathRecipe, SiteRecipe, load_split
from oysterbench.recipe.path import PATH_KINDS
from oysterbench.scene.path import build_path
from oysterbench.scene.path.routes import dense_spots
from oysterbench.sensors.camera import render_frame
from oysterbench.sensors.imu import ideal_imu
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.tiny import TINY_SPLIT, make_split

BASE = load_split("slam-mini").sequence[0]
SPEED, TURN_RATE = 0.4, np.radians(30.0)
KEYS = {
    "loop": {"radius_m": 2.5},
    "lawnmower": {"length_m": 6.0, "width_m": 4.2, "spacing_m": 1.4, "heading_deg": 25.0},
    "transect": {"length_m": 5.0, "heading_deg": 60.0, "repeat": True},
    "orbit": {"radius_m": 2.0, "centre_m": (0.5, -0.5), "look": "inward"},
    "inspection": {"spots_m": ((2.0, 1.0), (-3.0, 0.5))},
    "waypoints": {"waypoints": ((-3.0, -3.0), (3.0, -2.0, 1.5), (2.5, 2.0, 1.2, 120.0), (-2.0, 3.0, 0.9, -170.0))},
    "free": {"extent_m": 9.0},
}
UP = np.array([0.0, 0.0, 1.0])
CALM = {"sway_m": 0.0, "tilt_deg": 0.0}
ROUGH = SiteRecipe(wave_height_m=0.3, wave_period_s=4.0, current_m_s=0.15, current_to_deg=70.0)


def flat(x, y):
    return np.full(np.shape(x), -4.0)


def sequence(kind, duration_s=60.0, site=None, **keys):
    plan = PathRecipe(kind=kind, speed_m_s=SPEED, altitude_m=1.0, **{**KEYS[kind], **keys})
    return dataclasses.replace(BASE, duration_s=duration_s, path=plan, site=site or SiteRecipe())


def make(kind, duration_s=60.0, site=None, ground=flat, obstacles=None, **keys):
    return build_path(sequence(kind, duration_s, site, **keys), ground, obstacles or ground, Streams(7))


def sampled(path, step=0.02):
    times = np.arange(0.0, path.duration_s, step)
    return times, path.position(times), path.attitude(times)


def test_every_kind_is_tried_here():
    assert set(KEYS) == set(PATH_KINDS)


@pytest.mark.parametrize("kind", KEYS)
def test_what_an_ideal_inertial_unit_feels_integrates_back_to_the_path(kind):
    path = make(kind, site=ROUGH, lean=1.0, excitation=1.0)
    lever = np.array([0.2, -0.1, 0.05])
    mount = np.eye(4)
    mount[:3, 3] = lever
    dt = 1 / 800
    times = np.arange(0.0, 60.0, dt)
    motion = path.at(times)
    gyro, accel = ideal_imu(motion, mount)
    turns = Rotation.from_rotvec(0.5 * (gyro[1:] + gyro[:-1]) * dt).as_matrix()
    rotation = np.empty((len(times), 3, 3))
    rotation[0] = motion.rotation[0]
    for k, turn in enumerate(turns):
        rotation[k + 1] = rotation[k] @ turn
    force = np.einsum("nij,nj->ni", rotation, accel) - GRAVITY * UP
    start = motion.velocity[0] + motion.rotation[0] @ np.cross(motion.rate[0], lever)
    velocity = start + np.vstack([np.zeros(3), np.cumsum(0.5 * (force[1:] + force[:-1]) * dt, axis=0)])
    unit = motion.position[0] + motion.rotation[0] @ lever
    unit = unit + np.vstack([np.zeros(3), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt, axis=0)])
    assert np.linalg.norm(unit - rotation @ lever - motion.position, axis=1).max() < 0.01


@pytest.mark.parametrize("kind", KEYS)
def test_derivatives_are_those_of_position_and_attitude(kind):
    path = make(kind, site=ROUGH, lean=1.0, excitation=1.0)
    times, step = np.linspace(0.1, 59.9, 397), 1e-5
    before, here, after = path.at(times - step), path.at(times), path.at(times + step)
    assert np.allclose((after.position - before.position) / (2 * step), here.velocity, atol=1e-8)
    assert np.allclose((after.velocity - before.velocity) / (2 * step), here.acceleration, atol=1e-7)
    turn = np.einsum("nji,njk->nik", before.rotation, after.rotation)
    assert np.allclose(Rotation.from_matrix(turn).as_rotvec() / (2 * step), here.rate, atol=1e-8)
    assert np.allclose((after.rate - before.rate) / (2 * step), here.rate_dot, atol=1e-7)


@pytest.mark.parametrize("kind", KEYS)
def test_it_starts_at_rest_and_is_never_faster_than_its_speed(kind):
    path = make(kind, **CALM)
    motion = path.at(np.arange(0.0, 60.0, 0.01))
    speed = np.linalg.norm(motion.velocity, axis=1)
    assert speed[0] < 1e-4
    assert SPEED * 0.97 < speed.max() < SPEED * 1.001
    assert np.linalg.norm(motion.acceleration, axis=1).max() < 1.0
    if kind != "loop":  # a closed curve at constant speed
        assert np.linalg.norm(motion.rate, axis=1).max() < TURN_RATE * 1.001


@pytest.fixture(scope="module")
def simulated():
    return build_sequence(make_split(TINY_SPLIT.replace("size_m = 5.0", "size_m = 11.0")), "tiny-01", b"")


@pytest.mark.parametrize(
    "kind", [kind if kind in ("loop", "inspection") else pytest.param(kind, marks=pytest.mark.slow) for kind in KEYS]
)
def test_a_frame_of_every_kind_in_a_recipe_can_be_rendered(kind, simulated):
    head = TINY_SPLIT[: TINY_SPLIT.index("[sequence.path]")].replace("size_m = 5.0", "size_m = 11.0")
    (recipe,) = make_split(head + as_toml({"kind": kind, "speed_m_s": 0.4, "altitude_m": 1.2, **KEYS[kind]})).sequence
    path = build_path(recipe, simulated.world.ground_height, simulated.world.obstacle_height, simulated.streams)
    (camera,) = simulated.rig.camera
    frame = render_frame(dataclasses.replace(simulated, path=path), camera, 24)
    assert frame.colour.shape == (48, 64, 3)
    assert frame.colour.std() > 1.0
    assert (frame.classes == 1).mean() > 0.3  # looking at the bottom


def as_toml(keys):
    """The table [sequence.path]; JSON writes numbers, texts, truths and lists as TOML does."""
    return "\n".join(["[sequence.path]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items()), ""])


def test_lanes_are_parallel_and_lie_at_the_spacing_asked_for():
    path = make("lawnmower", 120.0, **CALM)
    _, position, attitude = sampled(path)
    lane = np.radians(25.0)
    along = position[:, 0] * np.cos(lane) + position[:, 1] * np.sin(lane)
    across = -position[:, 0] * np.sin(lane) + position[:, 1] * np.cos(lane)
    inner = np.abs(along) < 2.0
    assert np.abs(np.sin(attitude[inner, 0] - lane)).max() < 1e-4
    assert np.unique(np.round(across[inner], 3)) == pytest.approx([-2.1, -0.7, 0.7, 2.1], abs=2e-3)
    assert np.abs(along).max() < 3.0 + 0.7 + 1e-6


def test_cross_lanes_meet_every_lane_again():
    path = make("lawnmower", 240.0, cross=True, **CALM)
    _, position, attitude = sampled(path)
    lane = np.radians(25.0)
    along = position[:, 0] * np.cos(lane) + position[:, 1] * np.sin(lane)
    across = -position[:, 0] * np.sin(lane) + position[:, 1] * np.cos(lane)
    crossing = (np.abs(np.cos(attitude[:, 0] - lane)) < 1e-4) & (np.abs(across) < 1.0) & (np.abs(along) < 3.0)
    assert np.unique(np.round(along[crossing], 2)) == pytest.approx([-2.8, -1.4, 0.0, 1.4, 2.8], abs=0.011)


def test_a_transect_is_straight_and_comes_back_when_asked_to():
    _, position, _ = sampled(make("transect", **CALM))
    across = -position[:, 0] * np.sin(np.radians(60.0)) + position[:, 1] * np.cos(np.radians(60.0))
    along = position[:, 0] * np.cos(np.radians(60.0)) + position[:, 1] * np.sin(np.radians(60.0))
    assert np.abs(across).max() < 1e-6
    assert along[0] == pytest.approx(-2.5, abs=1e-6)
    assert along.max() == pytest.approx(2.5, abs=1e-3)
    assert along[np.argmax(along) :].min() < -2.0
    _, once, attitude = sampled(make("transect", repeat=False, **CALM))
    assert np.ptp(once[1000:], axis=0).max() < 1e-6
    assert np.degrees(np.ptp(attitude[:, 0])) < 1e-6


@pytest.mark.parametrize(("look_at", "facing"), [("inward", 180.0), ("along", 90.0)])
def test_an_orbit_keeps_its_radius_and_its_look(look_at, facing):
    _, position, attitude = sampled(make("orbit", look=look_at, **CALM))
    from_centre = position[:, :2] - [0.5, -0.5]
    radius = np.hypot(*from_centre.T)
    assert radius == pytest.approx(2.0, abs=1e-2)
    assert radius[150:] == pytest.approx(2.0, abs=2e-3)
    off = np.degrees(attitude[:, 0] - np.arctan2(from_centre[:, 1], from_centre[:, 0]))
    assert np.abs((off + 180.0) % 360.0 - 180.0) == pytest.approx(facing, abs=0.5)


def test_a_tight_orbit_keeps_its_radius_too():
    _, position, _ = sampled(make("orbit", radius_m=0.3, turn_rate_deg_s=90.0, **CALM))
    assert np.hypot(*(position[:, :2] - [0.5, -0.5]).T)[100:] == pytest.approx(0.3, abs=3e-3)


def test_an_orbit_of_rings_makes_a_lap_on_each():
    _, position, _ = sampled(make("orbit", 240.0, rings=3, spacing_m=0.7, **CALM))
    radius = np.hypot(*(position[:, :2] - [0.5, -0.5]).T)
    for ring in (2.0, 2.7, 3.4):
        assert (np.abs(radius - ring) < 5e-3).sum() * 0.02 > 0.9 * 2 * np.pi * ring / SPEED


def test_waypoints_are_passed_at_their_altitude_and_yaw():
    _, position, attitude = sampled(make("waypoints", 90.0, **CALM))
    for place in KEYS["waypoints"]["waypoints"]:
        wanted = np.array([*place[:2], (place[2] if len(place) > 2 else 1.0) - 4.0])
        away = np.linalg.norm(position - wanted, axis=1)
        assert away.min() < 0.1 * SPEED
        if len(place) > 3:
            near = away < 0.1 * SPEED
            assert np.abs(np.sin(0.5 * (attitude[near, 0] - np.radians(place[3])))).min() < 0.02


@pytest.mark.parametrize(("rate_deg_s", "tolerance_s"), [(30.0, 0.03), (180.0, 0.15)])
def test_sharp_and_shallow_turns_at_waypoints_stay_within_the_tolerance(rate_deg_s, tolerance_s):
    for turn in np.radians([5.0, 20.0, 45.0, 60.0, 90.0, 135.0, 170.0]):
        places = ((-3.0, 0.0), (0.0, 0.0), (3.0 * np.cos(turn), 3.0 * np.sin(turn)))
        _, position, _ = sampled(make("waypoints", 40.0, waypoints=places, turn_rate_deg_s=rate_deg_s, **CALM))
        assert np.hypot(*position[:, :2].T).min() < tolerance_s * SPEED


def test_an_inspection_hovers_close_to_each_spot_and_looks_at_it_from_all_sides():
    times, position, attitude = sampled(make("inspection", 120.0, sides=3, hover_s=4.0, **CALM))
    assert times[-1] > 119
    for spot in KEYS["inspection"]["spots_m"]:
        to_spot = np.array(spot) - position[:, :2]
        away = np.hypot(*to_spot.T)
        speed = np.linalg.norm(np.gradient(position, 0.02, axis=0), axis=1)
        still = (away < 1.0) & (speed < 0.02) & (position[:, 2] < -3.2)
        assert still.sum() * 0.02 > 3 * 2.5
        assert away[still] == pytest.approx(0.8, abs=0.03)
        assert position[still, 2] == pytest.approx(-3.3, abs=0.03)
        bearing = np.arctan2(to_spot[still, 1], to_spot[still, 0])
        assert np.abs(np.sin(0.5 * (attitude[still, 0] - bearing))).max() < 0.03
        assert len(np.unique(np.round(np.degrees(bearing) % 360.0 / 30.0) % 12)) >= 3


@pytest.mark.parametrize("kind", KEYS)
@pytest.mark.parametrize(
    "rest", [{"rest_s": 5.0}, {"rest_s": 60.0, "hand_flown": 1.0}, {"rest_s": 4.5, "ramp_s": 30.0}]
)
def test_a_dive_may_be_all_rest(kind, rest):
    _, position, attitude = sampled(make(kind, 5.0, **rest))
    start = make(kind, 60.0, **CALM).position(0.0)
    assert np.linalg.norm(position - start, axis=1).max() < 1e-3
    assert np.ptp(attitude, axis=0).max() < 1e-3


def test_spots_are_drawn_from_where_most_stands_and_apart_from_each_other():
    lines = np.linspace(-5.0, 5.0, 101)
    x, y = np.meshgrid(lines, lines)
    relief = np.exp(-((x - 2) ** 2 + (y + 1) ** 2)) + np.exp(-((x + 3) ** 2 + (y - 3) ** 2))
    spots = np.array(dense_spots(relief, lines, 5, 1.0, Streams(3).generator("spots")))
    level = np.quantile(relief, 0.9)
    assert np.all(np.exp(-((spots - [2, -1]) ** 2).sum(1)) + np.exp(-((spots - [-3, 3]) ** 2).sum(1)) >= level - 1e-3)
    gaps = np.linalg.norm(spots[:, None] - spots[None], axis=2)[np.triu_indices(5, 1)]
    assert gaps.min() >= 1.0 - 1e-9
    crowded = dense_spots(relief, lines, 60, 2.0, Streams(3).generator("spots"))
    assert len(set(crowded)) == 60


def test_a_free_path_stays_in_its_square_and_comes_back_to_where_it_was():
    def returns(revisit):
        _, position, _ = sampled(make("free", 300.0, revisit=revisit, **CALM), 0.25)
        assert np.abs(position[:, :2]).max() < 4.5
        assert np.linalg.norm(np.diff(position[40:], axis=0), axis=1).min() > 0.2 * SPEED * 0.25  # to its very end
        gap = np.linalg.norm(position[:, None, :2] - position[None, :, :2], axis=2)
        index = np.arange(len(position))
        gap[np.abs(index[:, None] - index[None]) < 80] = np.inf  # of 20 s
        return np.mean(gap.min(axis=1) < 0.2)

    assert returns(0.9) > 0.4
    assert returns(0.9) > returns(0.0)


def test_a_place_off_the_reef_is_refused():
    def far(x, y):
        return np.full(np.shape(x), -4.0)

    recipe = sequence("orbit", radius_m=5.9, centre_m=(0.5, 0.0))
    with pytest.raises(RecipeError, match=r"the path leaves the reef at x = .*reef\.size_m / 2"):
        build_path(recipe, far, far, Streams(7))


def pillar(x, y):
    """A rock, 0.5 m wide and 1.2 m high, in the middle of a flat bottom."""
    return np.where(np.hypot(x, y) < 0.25, -2.8, -4.0)


def test_a_path_into_a_rock_is_refused_even_where_it_only_passes_beside_it():
    keys = {"heading_deg": 0.0, "length_m": 6.0, "repeat": False, **CALM}
    for beside, free in ((0.0, False), (0.5, False), (0.6, True)):
        recipe = sequence("transect", centre_m=(0.0, beside), clearance_m=0.3, **keys)
        if free:
            build_path(recipe, flat, pillar, Streams(7))
            continue
        with pytest.raises(RecipeError, match=r"path\.altitude_m.*above the reef.*path\.lift = true"):
            build_path(recipe, flat, pillar, Streams(7))


@pytest.mark.parametrize("sway_m", [0.0, 0.06])
def test_a_path_that_may_rise_clears_the_rock_and_keeps_its_altitude_elsewhere(sway_m):
    keys = {"heading_deg": 0.0, "length_m": 8.0, "repeat": False, "tilt_deg": 0.0, "sway_m": sway_m}
    path = make("transect", obstacles=pillar, lift=True, **keys)
    position = path.position(np.arange(0.0, 60.0, 0.001))
    beside = np.maximum(np.hypot(position[:, 0], position[:, 1]) - 0.25, 0.0)
    over = np.maximum(position[:, 2] + 2.8, 0.0)
    assert np.hypot(beside, over).min() > 0.29  # the surroundings are sampled: see RING_M and DIRECTIONS
    far = np.abs(position[:, 0]) > 3.0
    assert position[far, 2] == pytest.approx(-3.0, abs=1e-3 + sway_m)
    motion = path.at(np.arange(0.0, 60.0, 0.01))
    assert np.abs(motion.velocity[:, 2]).max() < 0.6
    assert np.abs(motion.acceleration[:, 2]).max() < 1.5
