"""The page of a sequence: whole by itself, bounded in size, and each panel shows what its sensor says."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.cli.main import main
from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import EPOCH_NS
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.evaluate.slam import SlamSettings
from oysterbench.recipe import CLASSES
from oysterbench.recipe.rig import LAYERS
from oysterbench.report.viewer.estimates import estimated_paths
from oysterbench.report.viewer.faults import SHORTEST, fault_plot
from oysterbench.report.viewer.page import BYTES, STEPS, moments, pictures, span_of, view_page
from oysterbench.report.viewer.path import path_plot
from oysterbench.sensors.camera_panels import LAYER_PICTURES, layer_picture
from oysterbench.sensors.panels import BACKGROUND, WIDTH, Fan, Panel, latest
from oysterbench.sequence.export import export_sequence
from tests.helpers import hand_made_dive as dive
from tests.helpers.browser import CHROMIUM, browsing


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="module")
def page(sequence):
    return view_page(sequence)


@pytest.fixture(scope="module")
def data(page):
    return data_of(page)


def data_of(page: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        re.findall(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[0]
    )
    return found


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
    assert [len(panel["frames"]) for panel in data["panels"]] == [n] * 8  # two cameras, four layers, two sonars


@pytest.mark.parametrize("seconds", [1e300, 1e10, 1.99])
def test_a_part_may_be_said_to_last_longer_than_the_sequence(sequence, seconds):
    assert span_of(sequence, 0.0, seconds) == span_of(sequence, 0.0, None)


@pytest.mark.parametrize(("begin_s", "seconds"), [(0.0, 1e-12), (0.0, 0.0), (1e300, None), (-1e300, None), (1.99, 1.0)])
def test_a_part_without_a_nanosecond_of_the_sequence_is_refused(sequence, begin_s, seconds):
    got = f"{'all' if seconds is None else f'{seconds:g} s'} from {begin_s:g} s on"
    with pytest.raises(SequenceError, match=re.escape(f"lasts 2.0 s: expected a part of it, got {got}")):
        span_of(sequence, begin_s, seconds)


def test_a_cameras_panel_shows_the_frame_of_its_moment(data):
    assert data["seconds"] == pytest.approx(np.arange(20) / 10), "each frame once, as they are few enough"
    for step in (0, 7, 19):
        shown = decode(data["panels"][0]["frames"][step]).astype(int)
        near = [np.abs(shown - dive.colour(k / 10, "cam_left").astype(int)).mean() for k in range(20)]
        assert int(np.argmin(near)) == step
    first, last = (decode(data["panels"][0]["frames"][k]).astype(int) for k in (0, -1))
    assert np.abs(first - last).mean() > 3


def test_a_part_begins_where_it_is_asked_to(sequence):
    part = data_of(view_page(sequence, 0.5, 1.0))
    whole = data_of(view_page(sequence))
    assert part["begin"] == 0.5
    assert part["seconds"] == pytest.approx(np.arange(len(part["seconds"])) / 10)
    assert part["panels"][0]["frames"] == whole["panels"][0]["frames"][5:][: len(part["seconds"])]
    assert 10 <= len(part["seconds"]) <= 11
    with pytest.raises(SequenceError, match=r"lasts 2\.0 s: expected a part of it, got all from 30 s on"):
        view_page(sequence, 30.0)


def test_a_long_sequence_is_shown_by_moments_and_a_short_part_by_frames():
    assert len(moments(0, 600 * 10**9, [], 10.0)) == STEPS
    np.testing.assert_array_equal(np.diff(moments(0, 10 * 10**9, [], 10.0)), 10**8)
    assert moments(0, 2**63 - 1, [])[-1] == 2**63 - 1


def test_a_frame_that_jitter_makes_early_is_shown_once():
    stamps = [0, 95_000_000, 205_000_000, 298_000_000]

    def read(name, start_ns, end_ns):
        return (k for k, stamp in enumerate(stamps) if start_ns <= stamp < end_ns)

    assert list(latest(read, "cam", np.arange(4) * 100_000_000)) == [0, 1, 2, 3]


def test_each_picture_says_of_which_stamp_it_is(data, sequence):
    cam, depth = data["panels"][0]["stamps"], data["panels"][1]["stamps"]
    taken = [image.stamp_ns for image in sequence.images("cam_left")]
    assert [int(data["origin"]) + since for since in cam] == taken
    layers = {image.stamp_ns - int(data["origin"]) for image in sequence.layer("cam_left", "depth")}
    assert set(depth) == layers
    assert all(shown <= picture for shown, picture in zip(depth, cam, strict=True))


def test_the_state_is_told_in_motion_under_the_surface_and_by_the_compass(data):
    for second, (speed, depth, heading) in zip(data["seconds"], data["state"], strict=True):
        assert speed == pytest.approx(dive.SPEED, abs=0.02)
        assert depth == pytest.approx(-dive.FLIGHT_Z, abs=0.01)
        assert heading == pytest.approx(90 - np.degrees(dive.RATE * second), abs=0.6)


def test_north_is_shown_only_where_the_layout_says_where_it_is(sequence, page, tmp_path):
    assert 'class="north"' in page
    assert "east to the right" in page
    folder, _ = export_sequence(sequence, "euroc", tmp_path / "euroc")
    other = view_page(oysterbench.open(folder))
    assert 'class="north"' not in other
    assert "east to the right" not in other
    assert [state[1:] for state in data_of(other)["state"]] == [[None, None]] * 20


def test_estimates_are_drawn_beside_the_truth_to_which_they_were_brought(sequence, tmp_path):
    truth = sequence.truth()
    turned = Rotation.from_euler("z", 40, degrees=True)
    quaternions = (turned * Rotation.from_quat(truth.quaternions)).as_quat()
    off = Trajectory(truth.stamps_ns, turned.apply(truth.positions) + np.array([5.0, 1.0, 0.3]), quaternions)
    write_tum(tmp_path / "mine.tum", off)
    (estimate,) = estimated_paths(sequence, [tmp_path / "mine.tum"], SlamSettings())
    assert estimate.rmse_m < 1e-6
    np.testing.assert_allclose(estimate.poses.positions, truth.positions, atol=1e-6)
    np.testing.assert_allclose(estimate.poses.matrices, truth.matrices, atol=1e-6)
    page = view_page(sequence, estimates=[estimate])
    (drawn,) = re.findall(r'<path class="estimate e0" d="([^"]+)"', page)
    (true,) = re.findall(r'<path class="c1" d="([^"]+)"/>\n<path class="estimate', page)
    assert drawn == true
    assert "mine, ATE" in page
    assert "estimate" not in re.sub(r"<style>.*?</style>", "", view_page(sequence), flags=re.S)


def test_what_was_decided_in_reading_an_estimate_is_told(sequence, dive_file, tmp_path):
    truth, mine = sequence.truth(), tmp_path / "mine.tum"
    poses = np.hstack([truth.positions, truth.quaternions]).tolist()
    rows = [" ".join(map(str, [stamp, *pose])) for stamp, pose in zip(truth.stamps_ns, poses, strict=True)]
    mine.write_text("\n".join(rows))
    words = ["view", str(dive_file), "--seconds", "0.2", "--estimate", str(mine), "--out", str(tmp_path / "page.html")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.stderr
    assert "mine.tum: the timestamps can only be nanoseconds and are read as such" in done.stderr


def test_two_files_of_one_name_are_told_apart(sequence, tmp_path):
    paths = [tmp_path / folder / "truth.tum" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        write_tum(path, sequence.truth())
    assert [one.name for one in estimated_paths(sequence, paths, SlamSettings())] == ["truth-2", "truth-3"]


def test_an_estimate_needs_a_truth(sequence, tmp_path):
    write_tum(tmp_path / "mine.tum", sequence.truth())
    blind, _ = export_sequence(sequence, "euroc", tmp_path / "blind", truth=False)
    with pytest.raises(SequenceError, match=r"--estimate is shown beside the truth: .* has no ground truth"):
        estimated_paths(oysterbench.open(blind), [tmp_path / "mine.tum"], SlamSettings())


def test_progress_is_told_to_the_last_picture(sequence):
    told = []
    view_page(sequence, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (160, 160)
    assert [done for done, _ in told] == list(range(1, 161))


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_layer_is_chosen_by_a_click_and_the_film_keeps_its_speed(page, tmp_path):
    (tmp_path / "page.html").write_text(page)
    with browsing() as browser:
        browser.look(390)
        browser.go(f"file://{tmp_path}/page.html")
        hidden = "getComputedStyle(document.querySelector('.over')).display"
        assert browser.value(hidden) == "none"
        browser.value("document.querySelector('[data-layer=\"2\"]').click()")
        assert browser.value(hidden) == "block"
        assert browser.value("document.querySelector('.over').src.endsWith(data.panels[2].frames[0])")
        assert not browser.value("document.querySelector('.classes').hidden")
        browser.value("show(7)")
        shown = browser.value("document.querySelector('.stamp').textContent")
        assert int(shown) == EPOCH_NS + data_of(page)["panels"][2]["stamps"][7]
        assert browser.value("document.documentElement.scrollWidth") <= 390
        assert browser.messages == []


def test_layers_of_truth_can_be_laid_over_their_camera(page):
    figures = re.split(r'(?=<figure class="sensor")', page)[1:]
    titles = [re.findall(r'<img class="panel" alt="([^"]+)"', figure)[0].partition(",")[0] for figure in figures]
    assert titles == ["cam_left", "cam_right", "fls", "msis"]
    layers = [re.findall(r'data-layer="(\d*)"[^>]*>(\w+)</button>', figure) for figure in figures]
    assert layers[0] == [("", "image"), ("1", "depth"), ("2", "class"), ("3", "instance"), ("4", "visibility")]
    assert layers[1:] == [[], [], []]
    assert [('class="classes"' in figure) for figure in figures] == [True, False, False, False]


def test_a_layer_picture_tells_values_apart():
    classes = np.array([list(CLASSES)], dtype=np.uint8)
    assert len(np.unique(layer_picture("class", classes)[0], axis=0)) == len(CLASSES)
    instances = layer_picture("instance", np.array([[0, 7, 8, 65535]], dtype=np.uint16))[0]
    assert len(np.unique(instances, axis=0)) == 4
    assert (instances[0] == BACKGROUND).all()
    depth = layer_picture("depth", np.array([[0.0, 0.5, 5.0]], dtype=np.float32))[0].astype(int).sum(axis=-1)
    assert depth[1] > depth[2] > depth[0] - 60
    still, moves = layer_picture("dynamic", np.array([[0, 1]], dtype=np.uint8))[0]
    assert (still == still[0]).all()
    assert moves[0] > moves[2]
    shares = layer_picture("transmittance", np.array([[0.1, 0.9, np.nan]], dtype=np.float32))[0].astype(int)
    assert shares[1].sum() > shares[0].sum()
    assert (shares[2] == BACKGROUND).all()
    for layer in ("direct", "normals"):
        assert layer_picture(layer, np.zeros((2, 3, 3), dtype=np.float32)).shape == (2, 3, 3)
    assert set(LAYER_PICTURES) == set(LAYERS)


def test_flow_is_red_to_the_right_green_downwards_and_brighter_the_faster():
    flow = np.zeros((1, 100, 2), dtype=np.float32)
    flow[0, 0], flow[0, 1], flow[0, 2], flow[0, 3] = (8, 0), (0, 8), (2, 0), np.nan
    right, down, slow, unknown = layer_picture("flow", flow)[0, :4].astype(int)
    assert right.argmax() == 0
    assert down.argmax() == 1
    assert right.max() > slow.max() > 60
    assert (unknown == BACKGROUND).all()


@dataclass
class Disturbed:
    """A sequence with what the hand-made dive has not: things that move, faults, and exposures."""

    inner: Any

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def moving(self):
        return pd.DataFrame({"id": [9, 11], "class": ["fish", "crab"]})

    def moving_poses(self):
        rows = [(EPOCH_NS + t * 10**9, k, (0.1 + 0.3 * t) if k == 9 else 0.3, 0.2) for t in (0, 2) for k in (9, 11)]
        return pd.DataFrame(rows, columns=["stamp_ns", "id", "x", "y"])

    def faults(self):
        rows = [(0, 0, "dvl", "outlier_m_s", -0.4), (1.0, 1.5, "dvl", "outlier_m_s", 0.2), (0.5, 9, "imu", "b_k", 3)]
        columns = ["start_ns", "end_ns", "sensor", "fault", "value"]
        return pd.DataFrame(
            [(EPOCH_NS + int(a * 1e9), EPOCH_NS + int(b * 1e9), *of) for a, b, *of in rows], columns=columns
        )

    def taken(self):
        stamps = EPOCH_NS + np.arange(20) * 10**8
        return pd.DataFrame({"camera": "cam_left", "stamp_ns": stamps, "exposure_ms": np.linspace(5, 20, 20)})


def test_what_moves_is_on_the_map_where_it_is_at_each_moment(sequence):
    times = EPOCH_NS + np.array([0, 1, 2]) * 10**9
    plot = path_plot(Disturbed(sequence), times)
    assert list(plot.moving) == ["fish", "crab"]
    x = [float(re.match(r"M(\S+) ", dots)[1]) for dots in plot.moving["fish"]]
    per_m = plot.bar_px / plot.bar_m
    assert np.diff(x) == pytest.approx([0.3 * per_m] * 2, abs=1.5)
    assert len(set(plot.moving["crab"])) == 1
    assert path_plot(sequence, times).moving == {}


def test_faults_have_a_lane_each_over_the_time_that_they_struck(sequence):
    plot = fault_plot(Disturbed(sequence), EPOCH_NS, EPOCH_NS + 2 * 10**9)
    assert [lane.text for lane in plot.lanes] == ["dvl outlier_m_s, 2 times, up to 0.4", "imu b_k, once, up to 3"]
    across = plot.right - plot.left
    bars = [(float(a), float(b)) for a, b in re.findall(r"M(\S+) \S+?h([\d.]+)v", plot.lanes[0].bars)]
    assert bars == [(plot.left, SHORTEST), pytest.approx((plot.left + across / 2, across / 4), abs=0.1)]
    ((begin, length),) = re.findall(r"M(\S+) \S+?h([\d.]+)v", plot.lanes[1].bars)
    assert float(begin) + float(length) == pytest.approx(plot.right, abs=0.1)
    assert fault_plot(Disturbed(sequence), EPOCH_NS + 10**10, EPOCH_NS + 2 * 10**10) is None
    assert fault_plot(sequence, EPOCH_NS, EPOCH_NS + 10**9) is None


def test_the_page_says_what_moves_strikes_and_adapts(sequence):
    page = view_page(Disturbed(sequence))
    assert "1 fish, 1 crab" in page
    assert 'class="moving fish"' in page
    assert "dvl outlier_m_s, 2 times" in page
    assert 'aria-label="cam_left exposure, ms"' in page
    assert len(data_of(page)["moving"]) == 2


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
        sizes = [len(frame.data) for frame in panel.frames(np.array([start, start + 10**9]))]
        assert max(sizes) < 2.0 * panel.bytes_each, f"{panel.title}: noise is the worst that there is"


def test_a_folder_of_another_layout_can_be_looked_through(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "euroc", tmp_path / "euroc")
    page = view_page(oysterbench.open(folder))
    assert 'alt="cam1"' in page
    assert "path from above" in page
    assert "angular rate, deg/s" in page
    blind, _ = export_sequence(sequence, "euroc", tmp_path / "blind", truth=False)
    assert "from above" not in view_page(oysterbench.open(blind))
