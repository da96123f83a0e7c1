"""Single rays against trimesh's ray caster, an implementation that shares nothing with ours."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from oysterbench.render.rays import RayCaster
from tests.helpers.reefs import small_reef, world_of

FAR = 30.0


@pytest.fixture(scope="module")
def world():
    return world_of(small_reef())


@pytest.fixture(scope="module")
def caster(world):
    return RayCaster(world)


def some_rays(world, count):
    """Rays from above the reef to points on it, half of them things."""
    generator = np.random.default_rng(8)
    origins = generator.uniform([-1.5, -1.5, -2.6], [1.5, 1.5, -1.0], (count, 3))
    targets = generator.uniform([-1.8, -1.8, -3.1], [1.8, 1.8, -2.9], (count, 3))
    things = generator.integers(0, len(world.instances), count // 2)
    targets[: count // 2] = world.instances.positions[things]
    directions = targets - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.slow
def test_ranges_normals_and_instances_agree_with_trimesh(world, caster):
    origins, directions = some_rays(world, 60)
    echoes = caster.cast(origins, directions, FAR)
    ground = world.terrain.mesh()
    inside = np.all(np.abs(ground.vertices[:, :2]) < 2.5, axis=1)[ground.faces].all(axis=1)
    vertices, faces, owner = [ground.vertices], [ground.faces[inside]], [np.zeros(inside.sum(), dtype=int)]
    offset = len(ground.vertices)
    for row, shape in enumerate(world.instances.shapes):
        vertices.append(world.instances.vertices(world.meshes, row))
        faces.append(world.meshes[shape].faces + offset)
        owner.append(np.full(len(faces[-1]), world.instances.ids[row]))
        offset += len(vertices[-1])
    solid = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    owner = np.concatenate(owner)
    found = trimesh.ray.ray_triangle.RayMeshIntersector(solid).intersects_location(
        origins, directions, multiple_hits=False
    )
    points, which, triangles = found
    ranges = np.linalg.norm(points - origins[which], axis=1)
    same = (echoes.instances[which] == owner[triangles]) & (np.abs(echoes.ranges[which] - ranges) < 5e-4)
    assert len(which) > 50
    assert np.unique(owner[triangles]).size > 15
    assert same.mean() > 0.95  # a ray along an outline may fall on either side of it
    classes = np.concatenate([[1], world.instances.classes])
    assert np.array_equal(echoes.classes[which], classes[echoes.instances[which]])
    lengths = np.linalg.norm(echoes.normals[which], axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)
    flat = same & (owner[triangles] == 0)
    leaning = np.einsum("ni,ni->n", echoes.normals[which], solid.face_normals[triangles])
    assert leaning[flat].min() > 0.9


def test_a_ray_that_meets_nothing_within_reach_says_so(caster):
    origins, down, up = np.array([0.0, 0.0, -1.0]), np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
    far = caster.cast(origins, down, FAR)
    assert 1.5 < far.ranges[0] < 2.3
    for echoes in (caster.cast(origins, up, FAR), caster.cast(origins, down, float(far.ranges[0]) - 0.01)):
        assert np.isinf(echoes.ranges[0])
        assert np.all(echoes.normals == 0)
        assert echoes.classes[0] == 0
        assert echoes.instances[0] == 0


def test_rays_reach_past_the_square_of_the_relief(caster):
    out = np.array([[np.cos(a), np.sin(a), -0.1] for a in np.linspace(0, 6, 9)])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    echoes = caster.cast(np.array([0.0, 0.0, -1.5]), out, FAR)
    assert np.all((echoes.ranges > 8) & (echoes.ranges < 25))
    assert np.all(echoes.classes == 1)


def test_the_last_bits_of_a_direction_do_not_show(world, caster):
    origins, directions = some_rays(world, 500)
    one = caster.cast(origins, directions, FAR)
    other = caster.cast(origins * (1 + 2e-16), directions * (1 - 1e-16), FAR)
    assert one.ranges.dtype == np.float32
    assert np.array_equal(one.ranges, other.ranges)
    assert np.array_equal(one.normals, other.normals)
