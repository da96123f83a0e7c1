"""An imaging sonar's fans on a chart: a known motion is found again, and what does not belong there is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.sequence.types import SonarCalibration
from oysterbench_baselines.common.aiding.sonar.chart import Chart
from oysterbench_baselines.common.aiding.sonar.fan import Grid, View, first_echo, sample, texture
from oysterbench_baselines.common.aiding.sonar.registration import Guess, Match, register, search
from oysterbench_baselines.common.aiding.sonar.settings import SonarSettings

OF = SonarSettings()
CALIBRATION = SonarCalibration(
    beams=256,
    bins=400,
    azimuths_rad=np.radians(130.0) * (0.5 - (np.arange(256) + 0.5) / 256),
    ranges_m=np.linspace(0.11, 8.09, 400),
    vfov_rad=float(np.radians(20.0)),
    frequency_hz=750e3,
    amplitude_step=1e-4,
    T_base_sensor=np.eye(4),
)
GRID = Grid.of(CALIBRATION)
HEIGHT = 0.9
VIEW = View(HEIGHT, Rotation.from_euler("yx", [25.0, 1.0], degrees=True).as_matrix())


def oysters(seed: int, count: int = 500) -> tuple[Array, Array]:
    """Places (N, 2) m of strong scatterers on a bottom, and their amplitudes (N,)."""
    rng = stream(seed, b"", "oysters")
    return rng.uniform([-3, -6], [9, 6], size=(count, 2)), rng.uniform(20, 80, size=count)


def fan(seed: int, reef: tuple[Array, Array], place: Array, view: View = VIEW) -> NDArray[np.uint16]:
    """What a sonar at place (3,) hears of a reef: each oyster a spot of two bins and a degree, and speckle all over.

    It is made point by point from ranges and azimuths, not by what is tested here.
    """
    points, amplitudes = reef
    c, s = np.cos(place[2]), np.sin(place[2])
    level = (points - place[:2]) @ np.array([[c, -s], [s, c]])
    seen = np.column_stack([level, np.full(len(level), -view.height)]) @ view.level
    ranges, azimuths = np.linalg.norm(seen, axis=1), np.arctan2(seen[:, 1], seen[:, 0])
    power = np.full((GRID.bins, GRID.beams), 4.0**2)
    near = np.flatnonzero((ranges < CALIBRATION.ranges_m[-1]) & (np.abs(azimuths) < 1.2))
    for r, a, amplitude in zip(ranges[near], azimuths[near], amplitudes[near], strict=True):
        row, column = (r - GRID.first_range) / GRID.range_step, (a - GRID.first_azimuth) / GRID.azimuth_step
        at = slice(max(int(row) - 5, 0), int(row) + 7), slice(max(int(column) - 5, 0), int(column) + 7)
        rows = np.exp(-(((CALIBRATION.ranges_m[at[0]] - r) / 0.025) ** 2))
        columns = np.exp(-(((CALIBRATION.azimuths_rad[at[1]] - a) / np.radians(0.6)) ** 2))
        power[at] += amplitude**2 * np.outer(rows, columns)
    speckle = stream(seed, b"", "speckle").exponential(size=power.shape)
    return np.round(np.sqrt(power * speckle)).astype(np.uint16)


def picture(seed: int, reef: tuple[Array, Array], place: Array, view: View = VIEW) -> NDArray[np.float32]:
    return texture(fan(seed, reef, place, view), GRID, OF.fan)


def charted(reef: tuple[Array, Array], pings: int = 4) -> Chart:
    """A chart of fans 7 cm apart, the last one at the origin."""
    chart = Chart(OF.chart)
    for k in range(pings):
        place = np.array([-0.07 * (pings - 1 - k), 0.0, 0.0])
        chart.add(picture(10 + k, reef, place), place, VIEW, GRID, OF.fan)
    return chart


def place_of(chart: Chart, seen: NDArray[np.float32], guess: Guess, view: View = VIEW) -> Match | None:
    return register(chart, seen, view, guess, GRID, OF.fan, OF.registration)


@pytest.mark.parametrize("heading_sigma", [0.02, 1e-3])
def test_a_fan_is_found_where_it_was_heard(heading_sigma):
    reef, truth = oysters(1), np.array([0.08, -0.03, 0.01])
    guess = Guess(truth + np.array([0.02, -0.015, 0.2 * heading_sigma]), 0.02, heading_sigma)
    match = place_of(charted(reef), picture(1, reef, truth), guess)
    assert match is not None
    error = match.place - truth
    assert np.abs(error[:2]).max() < 0.006  # m
    assert abs(error[2]) < 0.003  # rad
    assert error @ np.linalg.solve(match.covariance, error) < 12  # of chi-square with 3 degrees: 0.7 %
    assert np.sqrt(np.diag(match.covariance)[:2]).max() < 0.01


def test_a_fan_is_found_from_far_off():
    """As at a start in motion, and after pings that were lost: half a metre from where it was thought."""
    reef, truth = oysters(2), np.array([0.35, 0.2, 0.0])
    match = place_of(charted(reef), picture(2, reef, truth), Guess(np.array([-0.1, 0.0, 0.0]), 0.3, 1e-3))
    assert match is not None
    assert np.abs(match.place - truth)[:2].max() < 0.008


def test_attitude_and_height_are_made_up_for():
    """Another pitch, roll and height than the chart's fans had show the same bottom."""
    reef, truth = oysters(3), np.array([0.1, 0.05, -0.2])
    view = View(1.05, Rotation.from_euler("yx", [31.0, -4.0], degrees=True).as_matrix())
    match = place_of(charted(reef), picture(3, reef, truth, view), Guess(truth, 0.02, 1e-3), view)
    assert match is not None
    assert np.abs(match.place - truth)[:2].max() < 0.008
    level = place_of(charted(reef), picture(3, reef, truth, view), Guess(truth, 0.02, 1e-3), VIEW)
    assert level is None or np.abs(level.place - truth)[:2].max() > 0.02


def test_fans_of_another_place_are_refused():
    chart = charted(oysters(4))
    for seed in range(5, 9):
        assert place_of(chart, picture(seed, oysters(seed), np.zeros(3)), Guess(np.zeros(3), 0.3, 1e-3)) is None
        assert place_of(chart, picture(seed, oysters(seed), np.zeros(3)), Guess(np.zeros(3), 0.01, 1e-3)) is None


def test_a_bottom_that_repeats_itself_is_doubtful_unless_the_place_is_nearly_known():
    """A pattern of 0.5 m: within a metre several places look alike."""
    step = np.arange(-3, 9, 0.5)
    x, y = np.meshgrid(step, np.arange(-6, 6, 0.5))
    reef = np.column_stack([x.ravel(), y.ravel()]), np.full(x.size, 50.0)
    chart, truth = charted(reef), np.array([0.05, 0.0, 0.0])
    seen = picture(1, reef, truth)
    assert search(chart, seen, VIEW, truth, 0.9, GRID, OF.fan, OF.registration) is None
    assert place_of(chart, seen, Guess(truth, 0.3, 1e-3)) is None
    match = place_of(chart, seen, Guess(truth + np.array([0.02, 0.0, 0.0]), 0.02, 1e-3))
    assert match is not None
    assert np.abs(match.place - truth)[:2].max() < 0.006


def test_a_match_far_from_the_guess_is_refused():
    reef, truth = oysters(5), np.array([0.3, 0.0, 0.0])
    assert place_of(charted(reef), picture(1, reef, truth), Guess(np.zeros(3), 0.04, 1e-3)) is None


@pytest.mark.parametrize("level", [0, 300])
def test_a_fan_without_texture_is_refused(level):
    """Nothing heard, and the same everywhere."""
    silent = texture(np.full((GRID.bins, GRID.beams), level, np.uint16), GRID, OF.fan)
    assert np.isfinite(silent).all()
    assert place_of(charted(oysters(6)), silent, Guess(np.zeros(3), 0.3, 1e-3)) is None
    assert place_of(charted(oysters(6)), silent, Guess(np.zeros(3), 0.01, 1e-3)) is None
    assert place_of(Chart(OF.chart), silent, Guess(np.zeros(3), 0.01, 1e-3)) is None


def test_a_picture_of_another_shape_is_an_error():
    with pytest.raises(ValueError, match="expected an image of 400 bins x 256 beams, got"):
        texture(np.zeros((256, 400), np.uint16), GRID, OF.fan)


def test_beams_that_are_not_even_are_an_error():
    crooked = np.sort(CALIBRATION.azimuths_rad**3)
    with pytest.raises(ValueError, match="even azimuths"):
        Grid.of(dataclasses.replace(CALIBRATION, azimuths_rad=crooked))


def test_a_spot_of_a_fan_lies_where_it_is_on_the_ground():
    spot = np.array([[2.4, 0.7]])
    seen = picture(1, (spot, np.array([400.0])), np.array([0.2, -0.1, 0.15]))
    points = np.stack(np.meshgrid(np.arange(2, 3, 0.01), np.arange(0, 1.4, 0.01), indexing="ij"), -1).reshape(-1, 2)
    shown, known = sample(seen, points, np.array([0.2, -0.1, 0.15]), VIEW, GRID, OF.fan)
    assert known.all()
    bright = np.maximum(shown - 20.0, 0)
    np.testing.assert_allclose(bright @ points / bright.sum(), spot[0], atol=0.01)


def test_the_chart_keeps_what_it_shows_as_it_moves():
    reef = oysters(7)
    chart = charted(reef, pings=1)
    at = np.array([[2.5, 0.0], [3.0, 0.5], [3.0, -0.5]])

    def shown() -> Array:
        near = np.abs(chart.points(np.arange(chart.values.size))[:, None] - at).max(axis=2).argmin(axis=0)
        return chart.values.ravel()[near]

    before = shown()
    chart.add(np.zeros((GRID.bins, GRID.beams), np.float32), np.array([3.5, 0.0, 0.0]), VIEW, GRID, OF.fan)
    np.testing.assert_array_equal(shown(), before)  # that fan does not see them: they lie behind it
    assert before.any()


def test_the_bottom_begins_where_the_fan_says():
    rows = np.zeros((GRID.bins, GRID.beams), np.uint16)
    rows[80:200] = 100
    assert first_echo(rows, GRID, 0.5) == pytest.approx(0.1 + 0.02 * 80.5, abs=0.1)
    assert np.isnan(first_echo(np.zeros_like(rows), GRID, 0.5))
