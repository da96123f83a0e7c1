"""The camera against analytic depth, trimesh's ray caster and its own repetition."""

from __future__ import annotations

import dataclasses
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe, WaterRecipe, load_split
from oysterbench.render.camera import CameraRenderer, warm_up
from oysterbench.scene.rig import camera_matrix
from oysterbench.scene.world import World, build_world
from tests.helpers.paths import ROOT

RECIPE = load_split("slam-mini").sequence[0]
CAMERA = CameraRecipe(name="test", width=160, height=120, hfov_deg=69.0, rate_hz=10.0)
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # optical axes in x forward, z up


def reef(**changes):
    defaults = {"size_m": 4.0, "depth_m": 3.0, "relief_rms_m": 0.08, "oysters": 60, "stones": 6}
    return dataclasses.replace(RECIPE, reef=dataclasses.replace(RECIPE.reef, **{**defaults, **changes}))


def pose(x: float, y: float, z: float, yaw_deg: float, pitch_deg: float) -> np.ndarray:
    body = Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    return transform(body @ OPTICAL, [x, y, z])


def noise(name: str = "a") -> np.random.Generator:
    return Streams(3).generator("noise", name)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(reef(), Streams(4))


@pytest.fixture(scope="module")
def renderer(world: World) -> CameraRenderer:
    warm_up()
    return CameraRenderer(world, CAMERA, reef())


def directions(T_map_cam: np.ndarray) -> np.ndarray:
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(float)
    return pixels @ np.linalg.inv(camera_matrix(CAMERA)).T @ T_map_cam[:3, :3].T


def test_camera_matrix_has_square_pixels_and_the_recipes_field_of_view() -> None:
    matrix = camera_matrix(CAMERA)
    assert matrix[0, 0] == matrix[1, 1]
    assert 2 * np.rad2deg(np.arctan(CAMERA.width / 2 / matrix[0, 0])) == pytest.approx(69.0)
    assert (matrix[0, 2], matrix[1, 2]) == (79.5, 59.5)


@pytest.mark.parametrize(
    ("yaw", "pitch"),
    [(0, 90), (137, 60), *(pytest.param(*view, marks=pytest.mark.slow) for view in ((0, 30), (90, 45), (180, 75)))],
)
def test_depth_over_a_plane_is_analytic(yaw: float, pitch: float) -> None:
    flat = reef(relief_rms_m=0.0, oysters=0, stones=0)
    T_map_cam = pose(0.3, -0.2, -2.0, yaw, pitch)
    frame = CameraRenderer(build_world(flat, Streams(4)), CAMERA, flat).render(T_map_cam, noise())
    down = directions(T_map_cam)[..., 2]
    expected = np.where(down < 0, -1.0 / np.where(down < 0, down, -1.0), np.inf)
    near = expected * np.linalg.norm(directions(T_map_cam), axis=-1) < CAMERA.max_range_m * 0.999
    assert frame.depth[near] == pytest.approx(expected[near], rel=2e-4)
    assert np.all(frame.classes[near] == 1)
    beyond = expected * np.linalg.norm(directions(T_map_cam), axis=-1) > CAMERA.max_range_m * 1.001
    assert np.all(frame.depth[beyond] == 0)
    assert np.all(frame.classes[beyond] == 0)


def first_hit(origin: np.ndarray, ray: np.ndarray, corners: np.ndarray) -> tuple[float, int]:
    """Nearest t > 0 along a ray and its triangle of corners (F, 3, 3), by Moller & Trumbore (1997)."""
    a, edge_1, edge_2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(ray, edge_2)
    determinant = np.einsum("fi,fi->f", edge_1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("fi,fi->f", origin - a, p) / determinant
        q = np.cross(origin - a, edge_1)
        v = q @ ray / determinant
        t = np.einsum("fi,fi->f", edge_2, q) / determinant
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    return float(t.min()), int(t.argmin())


@pytest.mark.parametrize(
    "place",
    [
        (0.0, 0.0, -2.2, 20, 40),
        pytest.param((-1.5, 1.0, -2.4, -30, 35), marks=pytest.mark.slow),
        pytest.param((-3.0, 0.2, -2.2, 0, 30), marks=pytest.mark.slow),
    ],
)
def test_truth_agrees_with_brute_force_over_all_triangles(
    world: World, renderer: CameraRenderer, place: tuple[float, ...]
) -> None:
    T_map_cam = pose(*place)
    frame = renderer.render(T_map_cam, noise())
    ground = world.terrain.mesh()
    near = np.all(np.hypot(*(ground.vertices[:, :2] - place[:2]).T)[ground.faces] < 3.5, axis=1)
    triangles = [ground.vertices[ground.faces[near]]]
    owners = [np.zeros(near.sum(), dtype=int)]
    for i in range(len(world.instances)):
        faces = world.meshes[world.instances.shapes[i]].faces
        triangles.append(world.instances.vertices(world.meshes, i)[faces])
        owners.append(np.full(len(faces), i + 1))
    corners, owner = np.concatenate(triangles), np.concatenate(owners)
    generator = np.random.default_rng(1)
    seen = np.argwhere(frame.instances > 0)  # half of the rays go where shells are
    pixels = np.concatenate(
        [generator.integers([40, 0], [CAMERA.height, CAMERA.width], (25, 2)), seen[:: len(seen) // 25]]
    )
    classes = np.concatenate([[1], world.instances.classes])
    eye, rays = T_map_cam[:3, 3], directions(T_map_cam)
    middles = corners.mean(axis=1) - eye
    radii = np.linalg.norm(corners - eye - middles[:, None], axis=2).max(axis=1)
    wrong, met = 0, 0
    for row, column in pixels:
        ray = rays[row, column]
        off = np.linalg.norm(middles - np.outer(middles @ ray, ray / (ray @ ray)), axis=1)
        there = np.flatnonzero(off <= radii + 1e-6)  # the others are off its line
        if not len(there):
            continue
        depth, found = first_hit(eye, ray, corners[there])
        face = there[found]
        if depth < 3.0:
            met += 1
            same = frame.instances[row, column] == owner[face] and frame.classes[row, column] == classes[owner[face]]
            wrong += not (same and abs(frame.depth[row, column] - depth) < 5e-4)
    assert met > 25
    assert wrong <= 1  # a ray along an outline may fall on either side of it


def test_same_pose_and_stream_give_the_same_bytes(world: World, renderer: CameraRenderer) -> None:
    T_map_cam = pose(0.0, 0.0, -2.2, 20, 40)
    first = renderer.render(T_map_cam, noise())
    renderer.render(pose(1.0, 0.0, -2.2, 90, 40), noise("b"))
    second = CameraRenderer(world, CAMERA, reef()).render(T_map_cam, noise())
    for field in dataclasses.fields(first):
        assert np.array_equal(getattr(first, field.name), getattr(second, field.name)), field.name


def test_frame_has_the_promised_types(renderer: CameraRenderer) -> None:
    frame = renderer.render(pose(0.0, 0.0, -2.2, 20, 40), noise())
    assert (frame.colour.shape, frame.colour.dtype) == ((120, 160, 3), np.uint8)
    assert (frame.depth.shape, frame.depth.dtype) == ((120, 160), np.float32)
    assert (frame.classes.shape, frame.classes.dtype) == ((120, 160), np.uint8)
    assert (frame.instances.shape, frame.instances.dtype) == ((120, 160), np.uint16)


def test_instances_and_classes_tell_the_same_story(world: World, renderer: CameraRenderer) -> None:
    frame = renderer.render(pose(-1.5, 0.0, -2.2, 0, 40), noise())
    assert np.array_equal(frame.instances > 0, frame.classes >= 2)
    assert set(np.unique(frame.classes)) >= {1, 2}
    assert np.array_equal(frame.classes == 0, frame.depth == 0)


def test_noise_touches_colour_only(renderer: CameraRenderer) -> None:
    T_map_cam = pose(0.0, 0.0, -2.2, 20, 40)
    one, other = renderer.render(T_map_cam, noise("a")), renderer.render(T_map_cam, noise("b"))
    assert np.array_equal(one.depth, other.depth)
    difference = one.colour.astype(int) - other.colour
    assert 0.3 < difference.std() < 6.0
    assert abs(difference.mean()) < 0.1


def test_shadow_of_a_shell_is_darker_than_the_ground_beside_it() -> None:
    recipe = reef(relief_rms_m=0.0, oysters=300, stones=0)
    light = dataclasses.replace(recipe.light, sun_elevation_deg=20.0)
    recipe = dataclasses.replace(recipe, light=light, water=WaterRecipe(jerlov="I"))
    world = build_world(recipe, Streams(4))
    T_map_cam = pose(0.0, 0.0, -1.2, 0, 90)
    lit = CameraRenderer(world, CAMERA, recipe).render(T_map_cam, noise())
    bare = dataclasses.replace(world, instances=world.instances.take(np.zeros(0, dtype=int)))
    empty = CameraRenderer(bare, CAMERA, recipe).render(T_map_cam, noise())
    ground = lit.instances == 0
    ratio = lit.colour[ground].astype(float).mean(axis=1) / empty.colour[ground].astype(float).mean(axis=1)
    assert np.percentile(ratio, 1) < 0.75
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)


def test_skipping_shadow_rays_changes_no_byte(world: World) -> None:
    T_map_cam = pose(0.0, 0.0, -2.0, 20, 60)
    some = CameraRenderer(world, CAMERA, reef())
    every = CameraRenderer(world, CAMERA, reef())
    assert 0.05 < some._looks.reach.numpy().mean() < 0.95
    every._looks.reach.fill_(1)
    assert np.array_equal(some.render(T_map_cam, noise()).colour, every.render(T_map_cam, noise()).colour)


GROWN = {"drape": 0.5, "turf": 0.6, "fouling": 0.9, "grit": 0.5, "burrows": 0.4, "infill_mm": 12.0, "shell_spread": 0.8}
GROWN |= {"algae_per_m2": 5.0, "litter_per_m2": 2.0}
PROCESSING = dataclasses.replace(CAMERA, softness_px=1.2, denoising=12.0, sharpening=0.8, contrast=1.2, saturation=1.3)
PRINT_DIGEST = """
import hashlib, sys
sys.path.insert(0, {folder!r})
import warp as wp
from oysterbench.render import develop, kernels
from tests.render.test_camera import CAMERA, GROWN, PROCESSING, CameraRenderer, Streams, build_world, noise, pose, reef
for module in ("kernels", "develop", "blur"):
    wp.get_module("oysterbench.render." + module).options["cpu_compiler_flags"] = {flags!r}
recipe, camera = (reef(**GROWN), PROCESSING) if {grown} else (reef(), CAMERA)
frame = CameraRenderer(build_world(recipe, Streams(4)), camera, recipe).render(pose(0.0, 0.0, -2.2, 20, 40), noise())
print(hashlib.sha256(frame.colour.tobytes() + frame.depth.tobytes() + frame.instances.tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the targets are those of x86-64")
@pytest.mark.parametrize("grown", [False, True])
def test_bytes_do_not_depend_on_the_processors_instructions(grown: bool, tmp_path: Path) -> None:
    def digest(flags: str) -> str:
        script = PRINT_DIGEST.format(folder=str(ROOT), flags=flags, grown=grown)
        environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
        run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
        assert run.returncode == 0, run.stderr
        return run.stdout.split()[-1]

    assert digest("-target-cpu x86-64") == digest("-target-cpu x86-64-v2") == digest("-march=native")


def test_far_ground_takes_the_colour_of_the_water() -> None:
    flat = reef(relief_rms_m=0.0, oysters=0, stones=0)
    frame = CameraRenderer(build_world(flat, Streams(4)), CAMERA, flat).render(pose(0, 0, -2.0, 0, 20), noise())
    contrast = frame.colour.astype(float).mean(axis=2).std(axis=1)
    far = np.argmax(frame.depth.min(axis=1) > 0)
    assert contrast[far : far + 5].mean() < 0.5 * contrast[-20:].mean()
