"""The vehicle's body: made of closed solids, of the maker's size, and light enough to be cast rays at."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import RigRecipe, load_split, parse_split
from oysterbench.recipe.rig import read_rig
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.solids import bent_tube, dome, plate, ring, rounded_box, tube
from oysterbench.scene.vehicle import AHEAD_M, build_vehicle, check_cameras
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.paths import DATASETS
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

RIG = dataclasses.replace(load_split("slam-mini").rig, vehicle="bluerov2")
RIG_FILES = sorted((DATASETS / "rigs").glob("*.toml"))
RED = (1.0, 0.0, 0.0)
SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
HOSE = np.column_stack([np.linspace(0, 1, 9), np.zeros(9), np.linspace(0, 1, 9)])
SOLIDS = {
    "tube": (tube((0, 0, 0), (1, 0, 0), 0.1, RED), np.pi * 0.01),
    "ring": (ring((0, 0, 0), (0, 0, 1), 0.2, 0.1, 0.5, RED), np.pi * 0.03 * 0.5),
    "dome": (dome((0, 0, 0), 1.0, RED), 2 * np.pi / 3),
    "ball": (dome((0, 0, 0), 1.0, RED, whole=True), 4 * np.pi / 3),
    "box": (rounded_box((1, 2, 3), (1.0, 0.5, 0.2), 0.01, RED), 0.1),
    "plate": (plate(SQUARE, 0.5, 0.1, RED), 0.4),
    "hose": (bent_tube(HOSE, 0.01, RED), np.pi * 1e-4 * np.sqrt(2)),
}


def welded(mesh: Mesh) -> trimesh.Trimesh:
    """The mesh with the corners merged that it has several times to keep its edges hard."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    solid.merge_vertices(merge_norm=True, merge_tex=True)
    solid.update_faces(solid.nondegenerate_faces())
    return solid


@pytest.mark.parametrize("kind", SOLIDS)
def test_solid_is_closed_outward_and_of_its_volume(kind: str) -> None:
    mesh, volume = SOLIDS[kind]
    solid = welded(mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert 0.85 * volume < solid.volume < 1.01 * volume  # chords lie inside arcs


def test_body_has_the_makers_size_and_few_triangles() -> None:
    body = build_vehicle(RIG)
    assert body is not None
    assert 5_000 < len(body.faces) < 30_000
    yellow = body.marks[:, 2] < 0.1 * body.marks[:, 0]  # the tether, which is no part of the drawing
    assert np.ptp(body.vertices[~yellow], axis=0) == pytest.approx([0.457, 0.338, 0.254], abs=0.04)
    assert yellow.any()
    assert np.all((body.marks >= 0) & (body.marks <= 0.8))


def test_no_body_where_the_rig_has_none() -> None:
    assert build_vehicle(dataclasses.replace(RIG, vehicle="none")) is None


def test_lamps_stand_where_the_rig_puts_their_light() -> None:
    """Each light of the rig with four views is just ahead of a bright window, so that the body does not shade it."""
    body = build_vehicle(RIG)
    assert body is not None
    windows = body.vertices[body.marks.min(axis=1) > 0.6]
    for y in (-0.12, 0.12):
        gap = np.array([0.24, y, -0.105]) - windows
        assert np.linalg.norm(gap, axis=1).min() < 0.03
        assert gap[:, 0].min() > 0


def test_a_point_is_enclosed_where_trimesh_finds_it_in_a_solid() -> None:
    body = build_vehicle(RIG, with_tether=False)
    assert body is not None
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    points = np.random.default_rng(1).uniform(low - 0.02, high + 0.02, (200, 3))
    solids = welded(body).split(only_watertight=False)
    inside = np.any([solid.contains(points) for solid in solids], axis=0)
    assert 20 < inside.sum() < 100
    assert [body.encloses(point) for point in points] == inside.tolist()


def camera_at(position_m: tuple[float, float, float], vehicle: str = "bluerov2") -> RigRecipe:
    return dataclasses.replace(
        RIG, vehicle=vehicle, camera=(dataclasses.replace(RIG.camera[0], position_m=position_m),)
    )


@pytest.mark.parametrize("position_m", [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0)])
def test_a_camera_inside_the_body_is_refused(position_m: tuple[float, float, float]) -> None:
    wanted = r"^a: camera cam_front: key 'camera\.position_m': expected a place outside .* 'bluerov2', such as \["
    with pytest.raises(RecipeError, match=wanted):
        check_cameras(camera_at(position_m), "a")
    check_cameras(camera_at(position_m, vehicle="none"), "a")
    check_cameras(camera_at(AHEAD_M), "a")


def test_a_dive_with_a_camera_inside_the_body_is_refused() -> None:
    rig = TINY_RIG.replace("[imu]", 'vehicle = "bluerov2"\n[imu]').replace("[0.18, 0.0, 0.0]", "[0.0, 0.0, 0.0]")
    split = parse_split(TINY_SPLIT, "tiny.toml", rig_source=rig)
    with pytest.raises(RecipeError, match=r"split tiny: sequence tiny-01: camera cam_front: .* got \[0\.0, "):
        build_sequence(split, "tiny-01", b"")


@pytest.mark.parametrize("path", RIG_FILES, ids=lambda path: path.stem)
def test_cameras_of_our_rigs_are_outside_the_body(path: Path) -> None:
    check_cameras(read_rig(tomllib.loads(path.read_text(encoding="utf-8")), path.stem), path.stem)
