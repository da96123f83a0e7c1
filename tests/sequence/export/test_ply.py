"""Clouds of points as PLY."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import hand_made_dive as dive


def vertices(path):
    trimesh = pytest.importorskip("trimesh")
    return trimesh.load(path, process=False)


def test_ply_of_the_level_bottom_is_level(folders):
    cloud = vertices(folders["ply"] / "cam_left.ply")
    near = np.linalg.norm(cloud.vertices[:, :2], axis=1) < 3
    assert near.sum() > 1000
    assert np.abs(cloud.vertices[near, 2] - dive.BOTTOM_Z).max() < 0.003, "depth is rounded to a millimetre"
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    assert set(np.unique(raw["instance"])) == {0, 7, 40_000}
    bright = cloud.colors[:, 0] > 120
    assert np.array_equal(bright, raw["class"] == 2), "oysters are the bright ones"


def test_ply_keeps_one_point_to_a_voxel(folders):
    cloud = vertices(folders["ply"] / "cam_left.ply")
    cells = np.floor(cloud.vertices.astype(np.float64) / 0.01)
    assert len(np.unique(cells, axis=0)) > 0.99 * len(cells)  # float32 moves a few over the edge of their voxel


def test_ply_of_a_sonar_is_its_returns_in_map(sequence, folders):
    raw = vertices(folders["ply"] / "fls.ply").metadata["_ply_raw"]["vertex"]["data"]
    made = dive.measurements()
    clouds = [cloud for cloud in made.clouds if cloud.stamp_ns <= sequence.truth().stamps_ns[-1]]
    mount = np.array(dive.calibration()["sonars"]["fls"]["T_base_sensor"])
    poses = [sequence.truth().at(np.array([cloud.stamp_ns])).matrices[0] @ mount for cloud in clouds]
    expected = np.concatenate([c.points @ T[:3, :3].T + T[:3, 3] for c, T in zip(clouds, poses, strict=True)])
    np.testing.assert_allclose(np.column_stack([raw[axis] for axis in "xyz"]), expected, atol=1e-5)
    assert np.array_equal(raw["instance"], np.concatenate([cloud.instances for cloud in clouds]))
