"""What lens, port and sensor do to a picture: defocus, spots on the port, hot pixels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp

from oysterbench.core.streams import Streams
from oysterbench.render.casting import Hit
from oysterbench.render.defocus import Defocus
from oysterbench.render.passage import STILL
from oysterbench.render.port import disc_overlap, spot_maps
from oysterbench.render.sensor import Exposure, dark_signal
from tests.helpers.reefs import CAMERA, FLAT, noise, pose, renderer_of, small_reef

DOWN = pose(0.0, 0.0, -2.0, 0, 90)
SHAPE = (61, 81)


def blurred_point(depth_m: float, aperture_m: float, focus_m: float = 1.0, focal_px: float = 466.0):
    """The picture (H, W) of a point of light of energy 1, a depth away like all around it."""
    hits = wp.zeros(SHAPE, dtype=Hit, device="cpu")
    hits.numpy()["t"][...] = depth_m
    point = np.zeros((*SHAPE, 3), dtype=np.float32)
    point[30, 40] = 1.0
    out = wp.zeros(SHAPE, dtype=wp.vec3, device="cpu")
    Defocus(SHAPE, focal_px, aperture_m, focus_m, "cpu").spread(wp.array(point, dtype=wp.vec3, device="cpu"), hits, out)
    return out.numpy()[..., 0]


@pytest.mark.parametrize(("depth_m", "aperture_m"), [(0.5, 0.010), (2.0, 0.020), (0.4, 0.008)])
def test_a_point_out_of_focus_is_a_disc_of_the_thin_lens_size(depth_m, aperture_m):
    disc = blurred_point(depth_m, aperture_m)
    expected = 466.0 * aperture_m * abs(1 / depth_m - 1.0)  # diameter, px
    assert disc.sum() == pytest.approx(1.0, rel=0.02)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    second_moment = (disc * ((x - 40) ** 2 + (y - 30) ** 2)).sum() / disc.sum()
    assert 2 * np.sqrt(2 * second_moment) == pytest.approx(expected, rel=0.1)  # of a disc: radius^2 / 2


def test_what_is_in_focus_stays_sharp():
    point = blurred_point(1.0, 0.008)
    assert point[30, 40] == 1.0
    assert np.count_nonzero(point) == 1


def test_defocus_keeps_the_truth_and_the_mean():
    recipe = small_reef({"bottom": "gravel"})
    sharp, soft = (renderer_of(recipe, dataclasses.replace(CAMERA, aperture_mm=a, focus_m=0.3)) for a in (0.0, 6.0))
    for renderer in (sharp, soft):
        renderer._prepare(DOWN, 0.0, None)
    one, two = (renderer._expose(DOWN, 0.0, STILL).numpy() for renderer in (sharp, soft))
    assert two.mean() == pytest.approx(one.mean(), rel=0.01)
    assert np.abs(np.diff(two[..., 1], axis=1)).mean() < 0.8 * np.abs(np.diff(one[..., 1], axis=1)).mean()
    assert np.array_equal(sharp.render(DOWN, noise()).depth, soft.render(DOWN, noise()).depth)


@pytest.mark.parametrize(("radius", "opening"), [(3.0, 10.0), (10.0, 3.0), (5.0, 5.0)])
def test_the_overlap_of_discs_sums_to_the_area_of_the_spot(radius, opening):
    y, x = np.mgrid[-30:31, -30:31]
    share = disc_overlap(np.hypot(x, y), radius, opening)
    assert share.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    assert share.max() == pytest.approx(min(radius / opening, 1.0) ** 2, rel=0.01)
    assert share[30, 30 + int(radius + opening) + 1] == 0.0


def test_spots_stay_where_they_are_and_darken_what_is_behind_them():
    clean = renderer_of(small_reef(FLAT))
    dirty = renderer_of(small_reef(FLAT), dataclasses.replace(CAMERA, port_spots=8, port_spot_mm=2.0))
    shares = []
    for T_map_cam in (DOWN, pose(0.3, 0.2, -2.0, 40, 90)):
        pictures = []
        for renderer in (clean, dirty):
            renderer._prepare(T_map_cam, 0.0, None)
            pictures.append(renderer._expose(T_map_cam, 0.0, STILL).numpy()[..., 1].copy())
        shares.append(pictures[1] / pictures[0])
    camera = dirty.camera
    hidden, sent, _ = spot_maps(camera, Streams(0).generator("port_spots"))
    assert 0.02 < hidden.mean() < 0.6
    assert np.all(sent <= hidden[..., None] * 0.8 + 1e-4)
    assert shares[0].min() < 0.8
    assert np.corrcoef(shares[0].ravel(), shares[1].ravel())[0, 1] > 0.9


def test_hot_pixels_are_as_many_as_asked_at_fixed_places_and_grow_with_time_and_gain():
    camera = dataclasses.replace(CAMERA, hot_pixels=2000.0)
    signal = dark_signal(camera, Streams(1))
    assert np.array_equal(signal, dark_signal(camera, Streams(1)))
    brightest = np.sort(signal[1:-1, 1:-1].max(axis=2).ravel())[::-1]
    assert brightest[: round(0.001 * brightest.size)].min() > 0.5
    renderer = renderer_of(small_reef(FLAT), camera)
    black = [0.0, 0.0, 0.0]
    short, long = (renderer.render(DOWN, noise(), exposure=Exposure(t, 1.0, black)).colour for t in (0.005, 0.040))
    # Read noise alone reaches some tens of codes near black.
    hot = long.max(axis=2) > 100
    assert 0.0005 < hot.mean() < 0.01
    assert np.all(renderer._dark.numpy().max(axis=2)[hot] > 0)
    assert (short.max(axis=2) > 100).sum() < hot.sum()
    other = renderer.render(pose(0.3, 0.0, -2.0, 0, 90), noise("b"), exposure=Exposure(0.040, 1.0, black)).colour
    assert np.mean(hot == (other.max(axis=2) > 100)) > 0.998
