"""Panels of a gallery: what cameras, sonars and sensors of a few numbers show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.recipe import vary_split, with_rig
from oysterbench.sensors import clock
from oysterbench.sensors.panels import BACKGROUND, curves, padded
from oysterbench.simulation.gallery import shrink
from oysterbench.simulation.panel import camera_picture, sensor_picture
from oysterbench.simulation.simulated_sequence import build_sequence


def varied(split, **changes):
    return vary_split(split, {key.replace("__", "."): value for key, value in changes.items()}, "test")


@pytest.fixture(scope="module")
def surveyed(tiny_split):
    """A tiny reef under a rig with every kind of sensor."""
    carried = with_rig(tiny_split, "survey-stereo-port", "test")
    return dataclasses.replace(carried, rig=shrink(carried.rig, 64))


def test_four_frames_are_in_rows_and_each_is_the_one_of_its_time(tiny_split):
    name = tiny_split.rig.camera[0].name
    each = 1 / tiny_split.rig.camera[0].rate_hz
    four = camera_picture(tiny_split, name, 0.0, every_s=each).astype(int)
    height, width = four.shape[0] // 2, four.shape[1] // 2
    places = [(0, 0), (0, width), (height, 0), (height, width)]
    for k, (top, left) in enumerate(places):
        alone = camera_picture(tiny_split, name, k * each).astype(int)
        small = alone.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        assert np.abs(four[top : top + height, left : left + width] - small).mean() < 1.0


def test_a_lost_frame_is_dark(tiny_split):
    lossy = varied(tiny_split, camera__dropout=0.4)
    camera = lossy.rig.camera[0]
    simulated = build_sequence(lossy, lossy.sequence[0].name, b"")
    n = int(lossy.sequence[0].duration_s * camera.rate_hz)
    kept = clock.kept(n, camera, simulated.streams.at("camera", camera.name))
    assert 0 < kept.sum() < n
    for index in (int(np.argmin(kept)), int(np.argmax(kept))):
        assert camera_picture(lossy, camera.name, index / camera.rate_hz).any() == kept[index]


@pytest.mark.slow
def test_a_video_link_is_in_the_picture(tiny_split):
    name = tiny_split.rig.camera[0].name
    plain = camera_picture(tiny_split, name, 0.5).astype(int)
    coded = camera_picture(varied(tiny_split, camera__video_mbit_s=0.01), name, 0.5).astype(int)
    assert np.abs(np.diff(coded, axis=1)).mean() < 0.9 * np.abs(np.diff(plain, axis=1)).mean()


def test_a_layer_is_drawn_in_its_colours(tiny_split):
    name = tiny_split.rig.camera[0].name
    picture = camera_picture(tiny_split, name, 0.0, layer="dynamic")
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) == 1, "nothing moves"


def test_a_sonar_shows_its_fan_at_the_time(surveyed):
    pictures = [sensor_picture(surveyed, surveyed, "sonar_front", at_s) for at_s in (0.0, 0.0, 0.75)]
    assert pictures[0].shape == (300, 400, 3)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any()
    loud = varied(surveyed, rig={"sonar": {"volume_db": -40.0}})
    assert sensor_picture(loud, surveyed, "sonar_front", 0.0).mean() > pictures[0].mean() + 5


def test_curves_show_what_a_fault_does_beside_what_would_be(surveyed):
    calm = sensor_picture(surveyed, surveyed, "imu", 0.0, "specific force").astype(int)
    shaken = varied(surveyed, rig={"imu": {"accel_turn_on": 2.0}})
    moved = sensor_picture(shaken, surveyed, "imu", 0.0, "specific force").astype(int)
    assert (moved != calm).any(axis=-1).mean() > 0.01
    assert not np.array_equal(sensor_picture(surveyed, surveyed, "imu", 0.0, "angular rate"), calm)


def test_curves_break_where_nothing_is_known_and_mark_spans():
    seconds = np.linspace(0.0, 10.0, 101)
    values = np.where((seconds > 4) & (seconds < 6), np.nan, np.sin(seconds))[:, None]
    picture = curves("x", seconds, values, seconds, values, [(4.0, 6.0)]).astype(int)
    coloured = np.ptp(picture, axis=-1) > 60
    middle = slice(int(44 + 0.45 * 346), int(44 + 0.55 * 346))
    curve, foot = coloured[34:268], coloured[270:280]
    assert curve.any()
    assert not curve[:, middle].any()
    assert foot[:, middle].any()
    assert not foot[:, :150].any()


@pytest.mark.parametrize("shape", [(100, 400), (300, 100), (300, 400)])
def test_a_picture_is_padded_to_an_aspect_and_stays_whole(shape):
    picture = np.full((*shape, 3), 200, dtype=np.uint8)
    found = padded(picture, 4 / 3)
    assert found.shape[1] / found.shape[0] == pytest.approx(4 / 3, abs=0.02)
    assert (found == 200).all(axis=-1).sum() == shape[0] * shape[1]
    assert set(np.unique(found)) <= {BACKGROUND, 200}
