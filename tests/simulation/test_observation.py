"""What counts as seen: near enough, large enough, live, inside the fence, and once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench.core.geometry import transform
from oysterbench.simulation.steering.observation import COVER_CELL_M, Observation
from oysterbench.simulation.steering.vehicle import rotations
from tests.helpers.flat_site import BOTTOM, flat_site


@pytest.fixture
def site():
    return flat_site([[1.0, 0.0], [1.5, 0.5]])


@pytest.fixture
def picture(site):
    """Depth (H, W) of 1.2 m everywhere, and no instance anywhere."""
    shape = (site.camera.height, site.camera.width)
    return np.full(shape, 1.2, np.float32), np.zeros(shape, np.uint16)


def pose(site):
    state = np.array([[0.0, 0.0, BOTTOM + 1.0, 0.0, 0.0]])
    return transform(rotations(state)[0], state[0, :3]) @ site.mount


def test_an_oyster_counts_once(site, picture):
    depth, instances = picture
    instances[100:110, 150:160] = 2
    observation = Observation(site)
    assert [observation.observe(pose(site), depth, instances) for _ in range(2)] == [1, 0]
    assert observation.found.tolist() == [False, True]


def test_too_few_pixels_do_not_count(site, picture):
    depth, instances = picture
    instances[100, 150 : 150 + site.task.view_px - 1] = 1
    observation = Observation(site)
    assert observation.observe(pose(site), depth, instances) == 0
    instances[101, 150] = 1
    assert observation.observe(pose(site), depth, instances) == 1


def test_what_is_too_far_does_not_count_by_its_range_and_not_by_its_depth(site, picture):
    depth, instances = picture
    depth[:] = 1.9  # in the corner that is 2.5 m along the ray, in the middle 1.9 m
    instances[:10, :10] = 1
    instances[115:125, 155:165] = 2
    observation = Observation(site)
    observation.observe(pose(site), depth, instances)
    assert observation.found.tolist() == [False, True]


def test_what_is_no_live_oyster_of_the_area_does_not_count(site, picture):
    depth, instances = picture
    instances[50:80, 50:80] = 3  # the vehicle's number, one more than the last
    assert Observation(site).observe(pose(site), depth, instances) == 0


def test_the_covered_share_is_that_of_the_bottom_in_sight(site):
    small = replace(site, half_m=4.0)
    observation = Observation(small)
    T = pose(small)
    rays = observation._rays @ T[:3, :3].T
    with np.errstate(divide="ignore"):
        along = np.where(rays[..., 2] < -1e-6, (BOTTOM - T[2, 3]) / rays[..., 2], 0.0)
    depth = along.astype(np.float32)
    observation.observe(T, depth, np.zeros(depth.shape, np.uint16))
    # By a fine grid of the plane: which points project into the picture and are near enough.
    lines = np.arange(-4, 4, 0.02) + 0.01
    points = np.stack([*np.meshgrid(lines, lines), np.full((400, 400), BOTTOM)], axis=-1) - T[:3, 3]
    local = points @ T[:3, :3]
    inside = (local[..., 2] > 0) & (np.linalg.norm(points, axis=-1) <= small.range_m)
    for axis, slope in enumerate(small.slopes):
        inside &= np.abs(local[..., axis]) <= slope * local[..., 2]
    share = inside.mean()
    edge = np.sqrt(share) * 8 * 4 * COVER_CELL_M / 64  # cells that the outline cuts count as a whole
    assert share < observation.covered < share + edge
    before = observation.covered
    observation.observe(T, depth, np.zeros(depth.shape, np.uint16))
    assert observation.covered == before
