"""The page of a sequence: whole by itself, bounded in size, and each panel shows what its sensor says."""

from __future__ import annotations

import base64
import json
import re

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.ros import EPOCH_NS
from oysterbench.report.viewer.page import BYTES, STEPS, moments, pictures, view_page
from oysterbench.report.viewer.strips import path_plot
from oysterbench.sensors.panels import BACKGROUND, WIDTH, Fan, Panel
from oysterbench.sequence.export import export_sequence
from tests.helpers import hand_made_dive as dive


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="module")
def page(sequence):
    return view_page(sequence)


@pytest.fixture(scope="module")
def data(page):
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])


def decode(text: str) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert pixels is not None
    return pixels


def test_the_page_needs_nothing_else(page):
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+|\"frames\": \[.*?\]", "", page).replace(
        "http://www.w3.org", ""
    )
    assert page.startswith("<!doctype html>")
    assert page.rstrip().endswith("</html>")


def test_every_sensor_has_its_place(page):
    for name in ("cam_left", "cam_right", "fls", "msis"):
        assert re.search(rf'<img class="panel" alt="{name}', page), name
    for title in (
        "angular rate, deg/s",
        "specific force, m/s²",
        "DVL velocity, m/s",
        "DVL altitude, m",
        "pressure, kPa",
        "magnetic field, µT",
        "alt range, m",
    ):
        assert f'aria-label="{title}"' in page
    assert "path and oysters from above" in page


def test_each_moment_has_a_picture_of_each_panel(data):
    n = len(data["seconds"])
    assert 2 <= n <= STEPS
    assert data["seconds"] == sorted(data["seconds"])
    assert len(data["path"]) == n
    assert [len(panel["frames"]) for panel in data["panels"]] == [n] * 4


def test_a_cameras_panel_shows_the_frame_of_its_moment(data):
    for step in (0, 40, len(data["seconds"]) - 1):
        second = data["seconds"][step]
        shown = decode(data["panels"][0]["frames"][step]).astype(int)
        expected = [dive.colour(min(np.floor(second * 10 + k) / 10, 1.9), "cam_left").astype(int) for k in (0, 1)]
        assert min(np.abs(shown - frame).mean() for frame in expected) < 6
    first, last = (decode(data["panels"][0]["frames"][k]).astype(int) for k in (0, -1))
    assert np.abs(first - last).mean() > 3


def test_a_fan_is_drawn_left_beams_left_and_far_bins_up():
    azimuths, ranges = np.linspace(0.9, -0.9, 64), np.linspace(0.5, 10, 200)
    amplitudes = np.full((200, 64), 10, dtype=np.uint16)
    amplitudes[150:170, 8:12] = 60_000  # far, on the left
    fan = Fan.of(azimuths, ranges)
    picture = fan.draw(amplitudes, 60_000.0).astype(int).sum(axis=-1)
    bright = np.argwhere(picture[:, : WIDTH // 2 - 5] > 0.9 * picture.max())  # beside the labels of the rings
    y, x = bright.mean(axis=0)
    azimuth, distance = azimuths[8:12].mean(), ranges[150:170].mean()
    assert x == pytest.approx(fan.centre[0] - distance * np.sin(azimuth) / fan.metres_per_px, abs=3)
    assert y == pytest.approx(fan.centre[1] - distance * np.cos(azimuth) / fan.metres_per_px, abs=3)
    assert x < WIDTH / 2
    assert picture[0, 0] == picture[-1, -1] == 3 * BACKGROUND


def test_a_full_circle_has_room_behind():
    fan = Fan.of(np.linspace(-np.pi, np.pi, 361), np.linspace(0.1, 5.0, 50))
    assert fan.height == pytest.approx(WIDTH, abs=2)
    assert (fan.rows >= 0).mean() == pytest.approx(np.pi / 4, abs=0.03)


def test_the_path_follows_the_truth(sequence):
    times = EPOCH_NS + np.array([0, 500_000_000, 1_500_000_000])
    plot = path_plot(sequence, times)
    poses = np.array(plot.poses)
    moved = np.diff(poses[:, :2], axis=0)
    true = np.array([dive.pose(t)[:2, 3] for t in (0, 0.5, 1.5)])
    scale = np.linalg.norm(moved[0]) / np.linalg.norm(true[1] - true[0])
    np.testing.assert_allclose(moved, np.diff(true, axis=0) * scale * [1, -1], atol=0.3)
    np.testing.assert_allclose(poses[:, 2], -np.degrees(dive.RATE * np.array([0, 0.5, 1.5])), atol=0.2)


def test_the_page_is_bounded_however_many_sensors_there_are(sequence):
    one = pictures(sequence)[0]
    many = [Panel("x", one.width, one.height, one.frames, 50_000) for _ in range(20)]
    times = moments(0, 10**12, many)
    assert 2 <= len(times) < STEPS
    assert len(times) * 20 * 50_000 * 4 / 3 <= BYTES
    assert len(moments(0, 10**12, [])) == STEPS
    for panel in pictures(sequence):
        start = EPOCH_NS
        sizes = [len(data) for data in panel.frames(np.array([start, start + 10**9]))]
        assert max(sizes) < 2.0 * panel.bytes_each, f"{panel.title}: noise is the worst that there is"


def test_a_folder_of_another_layout_can_be_looked_through(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "euroc", tmp_path / "euroc")
    page = view_page(oysterbench.open(folder))
    assert 'alt="cam1"' in page
    assert "path from above" in page
    assert "angular rate, deg/s" in page
    blind, _ = export_sequence(sequence, "euroc", tmp_path / "blind", truth=False)
    assert "from above" not in view_page(oysterbench.open(blind))
