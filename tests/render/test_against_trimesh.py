"""Depth, class and instance images against trimesh's ray caster, an implementation that shares nothing with ours."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe, load_split
from oysterbench.render.camera import CameraRenderer
from oysterbench.scene.rig import R_FORWARD_OPTICAL, camera_matrix
from oysterbench.scene.world import build_world

CAMERA = CameraRecipe(name="test", width=160, height=120, hfov_deg=69.0, rate_hz=10.0)
RAYS = 200
REACH_M = 1.2  # from the point below the camera: within it every triangle is in the mesh that trimesh is given


@pytest.fixture(scope="module")
def reef():
    recipe = load_split("slam-mini").sequence[0]
    small = dataclasses.replace(
        recipe.reef, size_m=4.0, depth_m=3.0, relief_rms_m=0.06, oysters=100, stones=12, clump_size=8.0
    )
    return dataclasses.replace(recipe, reef=small)


@pytest.fixture(scope="module")
def world(reef):
    return build_world(reef, Streams(11))


def triangles_around(world, x, y):
    """The reef's triangles around a place as one trimesh, and the instance that each belongs to (0 for the bottom)."""
    ground = world.terrain.mesh()
    near = np.all(np.abs(ground.vertices[:, :2] - [x, y])[ground.faces] < REACH_M + 0.1, axis=(1, 2))
    vertices, faces, owner = [ground.vertices], [ground.faces[near]], [np.zeros(near.sum(), dtype=int)]
    offset = len(ground.vertices)
    for row, position in enumerate(world.instances.positions):
        if np.linalg.norm(position[:2] - [x, y]) < REACH_M + 0.4:
            mesh = world.meshes[world.instances.shapes[row]]
            vertices.append(world.instances.vertices(world.meshes, row))
            faces.append(mesh.faces + offset)
            owner.append(np.full(len(mesh.faces), world.instances.ids[row]))
            offset += len(mesh.vertices)
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False), np.concatenate(owner)


@pytest.mark.parametrize(
    ("oyster", "yaw", "pitch"),
    [(5, 15, 60), *(pytest.param(*where, marks=pytest.mark.slow) for where in ((40, 220, 70), (80, 100, 90)))],
)
@pytest.mark.slow
def test_random_pixels_agree_with_trimesh(reef, world, oyster, yaw, pitch):
    x, y, z = world.instances.positions[oyster]
    turn = Rotation.from_euler("ZY", [yaw, pitch], degrees=True).as_matrix() @ R_FORWARD_OPTICAL
    T_map_cam = transform(turn, np.array([x, y, z]) - 0.7 * turn[:, 2])
    frame = CameraRenderer(world, CAMERA, reef).render(T_map_cam, Streams(1).generator("noise"))

    generator = np.random.default_rng(5)
    anywhere = generator.integers(0, [CAMERA.height, CAMERA.width], (RAYS // 2, 2))
    things = generator.permutation(np.argwhere(frame.instances > 0))[: RAYS // 2]  # half where something lies
    pixels = np.concatenate([anywhere, things])
    rays = np.column_stack([pixels[:, 1], pixels[:, 0], np.ones(len(pixels))]) @ np.linalg.inv(camera_matrix(CAMERA)).T
    around, owner = triangles_around(world, x, y)
    intersector = trimesh.ray.ray_triangle.RayMeshIntersector(around)
    origins = np.repeat(T_map_cam[None, :3, 3], len(rays), axis=0)
    points, which, triangles = intersector.intersects_location(origins, rays @ turn.T, multiple_hits=False)
    depth = (points - T_map_cam[:3, 3]) @ turn[:, 2]
    inside = np.linalg.norm(points[:, :2] - [x, y], axis=1) < REACH_M
    row, column = pixels[which[inside]].T

    expected = owner[triangles[inside]]
    classes = np.concatenate([[1], world.instances.classes])
    same = (
        (frame.instances[row, column] == expected)
        & (frame.classes[row, column] == classes[expected])
        & (np.abs(frame.depth[row, column] - depth[inside]) < 5e-4)
    )
    assert len(same) > RAYS / 4
    assert np.unique(expected).size > 4
    assert same.mean() > 0.99  # a ray along an outline may fall on either side of it
