"""The shutter: rows exposed one after another, and what moves while they are, against poses rendered one by one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.geometry import transform
from oysterbench.recipe import LampRecipe
from oysterbench.render.passage import STILL, Passage, passage, row_times
from oysterbench.render.snow import Snow
from tests.helpers.reefs import CAMERA, FLAT, noise, pose, renderer_of, rig_with, small_reef

ROLLING = dataclasses.replace(CAMERA, readout_ms=30.0)
PLACE = pose(0.0, 0.0, -2.2, 20, 60)
DOWN = pose(0.0, 0.0, -2.0, 90, 90)  # a metre over a level bottom; columns run along x of `map`
FOCAL = CAMERA.width / 2 / np.tan(np.radians(CAMERA.hfov_deg / 2))


def gliding(T_map_cam, velocity):
    """Poses of a camera that glides at (3,) m/s in `map`, at times after its picture."""
    velocity = np.asarray(velocity)
    return lambda times: [transform(T_map_cam[:3, :3], T_map_cam[:3, 3] + velocity * t) for t in times]


def exposed(renderer, T_map_cam, moved):
    """What arrives at the sensor (H, W, 3)."""
    renderer._prepare(T_map_cam, 0.0, None)
    return renderer._expose(T_map_cam, 0.0, moved).numpy().copy()


def psnr(picture, reference):
    """Of pictures whose full scale is the reference's brightest, dB."""
    return -10 * np.log10(np.mean((picture - reference) ** 2) / reference.max() ** 2)


@pytest.fixture(scope="module")
def renderer():
    return renderer_of(small_reef(), ROLLING)


@pytest.fixture(scope="module")
def level():
    return renderer_of(small_reef({**FLAT, "bottom": "gravel"}), ROLLING)


def test_each_row_is_seen_from_its_own_pose(renderer):
    moved = passage(ROLLING, 0.0, gliding(PLACE, [3.0, 0.0, 0.0]))
    frame = renderer.render(PLACE, noise(), passage=moved)
    for row in (0, 17, 60, 119):
        alone = renderer.render(moved.rows[row + 1], noise())
        assert np.array_equal(frame.depth[row], alone.depth[row])
        assert np.array_equal(frame.instances[row], alone.instances[row])
    assert not np.array_equal(frame.depth[0], renderer.render(PLACE, noise()).depth[0])


def test_rows_are_timed_around_the_middle_of_the_picture():
    times = row_times(ROLLING)
    assert len(times) == CAMERA.height + 2
    assert times[1] == -times[-2]
    assert np.diff(times) == pytest.approx(0.030 / CAMERA.height)


def test_a_rolling_shutter_slants_what_passes_by_speed_times_readout(level):
    """Over a level bottom at z, row r is moved by f v t_r / z: a slope that is known."""
    speed = 2.0
    still = level.layers(DOWN, ["radiance"])["radiance"][..., 1]
    moved = passage(ROLLING, 0.0, gliding(DOWN, DOWN[:3, 0] * speed))
    slanted = level.layers(DOWN, ["radiance"], passage=moved)["radiance"][..., 1]
    columns, inside = np.arange(CAMERA.width), slice(8, -8)
    shifts = np.arange(-4, 4, 0.02)
    found = []
    for row in range(CAMERA.height):
        misses = [np.sum((np.interp(columns + s, columns, still[row]) - slanted[row])[inside] ** 2) for s in shifts]
        found.append(shifts[np.argmin(misses)])
    slope = np.polyfit(np.arange(CAMERA.height), found, 1)[0]
    assert slope == pytest.approx(FOCAL * speed * 0.030 / CAMERA.height / 1.0, rel=0.03)


@pytest.mark.parametrize("height", [0.5, 1.0])
def test_blur_is_as_long_as_exposure_times_speed_times_focal_length_over_depth(level, height):
    T_map_cam = pose(0.0, 0.0, -3.0 + height, 90, 90)
    moved = passage(CAMERA, 0.020, gliding(T_map_cam, T_map_cam[:3, 0] * 1.5))
    exposed(level, T_map_cam, moved)
    way = level._shutter.ways.numpy()[60, 80]
    assert way == pytest.approx([-FOCAL * 1.5 * 0.020 / height, 0.0], abs=0.01)


@pytest.mark.parametrize("velocity", [(0.4, 0.0, 0.0), (0.0, 1.5, 0.0), (1.0, 0.6, -0.5)])
def test_a_blurred_picture_is_close_to_the_mean_of_many(renderer, velocity):
    moves = gliding(PLACE, velocity)
    sharp = renderer.layers(PLACE, ["radiance"])["radiance"]
    blurred = exposed(renderer, PLACE, passage(CAMERA, 0.030, moves))
    poses = moves((np.arange(32) + 0.5) / 32 * 0.030 - 0.015)
    mean = np.mean([renderer.layers(p, ["radiance"])["radiance"] for p in poses], axis=0)
    assert psnr(blurred, mean) > 38.0
    assert psnr(blurred, mean) > psnr(sharp, mean) + 3.0


def test_truth_is_that_of_the_middle_of_the_exposure(renderer):
    moved = passage(CAMERA, 0.030, gliding(PLACE, [1.0, 0.0, 0.0]))
    frame, still = renderer.render(PLACE, noise(), passage=moved), renderer.render(PLACE, noise())
    for layer in ("depth", "classes", "instances"):
        assert np.array_equal(getattr(frame, layer), getattr(still, layer))
    assert not np.array_equal(frame.colour, still.colour)


def test_the_vehicles_own_body_is_not_blurred():
    camera = dataclasses.replace(CAMERA, pitch_deg=90.0, position_m=(0.0, 0.0, 0.6))
    renderer = renderer_of(small_reef(), camera, rig=rig_with(vehicle="bluerov2"))
    T_map_cam = pose(0.0, 0.0, -1.6, 0, 90)
    moved = passage(camera, 0.020, gliding(T_map_cam, [1.0, 0.0, 0.0]))
    frame = renderer.render(T_map_cam, noise(), passage=moved)
    ways = np.linalg.norm(renderer._shutter.ways.numpy(), axis=-1)
    assert (frame.classes == 6).mean() > 0.05
    assert np.all(ways[frame.classes == 6] == 0)
    assert ways[frame.classes == 1].min() > 1.0


def test_flakes_leave_streaks_of_the_same_light():
    lit = rig_with(LampRecipe(intensity_cd=2000.0, position_m=(0.1, 0.2, 0.0)))
    renderer = renderer_of(small_reef(FLAT, water={"snow_per_m3": 3000.0}), rig=lit)
    still = renderer.layers(PLACE, ["snow"])["snow"].copy()
    moved = passage(CAMERA, 0.030, gliding(PLACE, [0.0, 0.5, 0.0]))
    exposed(renderer, PLACE, moved)
    streaks = renderer._snow.light.numpy()[..., 0].astype(float)
    renderer.layers(PLACE, ["snow"])
    discs = renderer._snow.light.numpy()[..., 0].astype(float)
    assert streaks.sum() == pytest.approx(discs.sum(), rel=0.05)
    assert np.count_nonzero(streaks) > 1.5 * np.count_nonzero(discs)
    assert still.max() > 0.01


def test_rolled_flakes_lie_where_their_rows_see_them():
    snow: Snow = renderer_of(small_reef(FLAT, water={"snow_per_m3": 1000.0}))._snow
    moves = gliding(PLACE, [1.0, 0.0, 0.0])
    rows = passage(ROLLING, 0.0, moves).rows
    place = np.array([[0.1, 0.15, 0.8]])
    pixel = FOCAL * place[0, :2] / place[0, 2] + [79.5, 59.5]
    row = pixel[1]
    for _ in range(20):  # the row whose own pose sees the flake in it
        (then,) = moves([(row - 59.5) * 0.030 / CAMERA.height])
        seen = np.linalg.inv(then) @ PLACE @ np.append(place[0], 1.0)
        column, row = FOCAL * seen[:2] / seen[2] + [79.5, 59.5]
    assert pixel + snow._rolled(rows, PLACE, place, pixel[None, 1])[0] == pytest.approx([column, row], abs=0.05)


def test_an_instant_of_all_rows_is_the_default():
    assert passage(CAMERA, 0.0, gliding(PLACE, [1.0, 0.0, 0.0])) == STILL == Passage()
