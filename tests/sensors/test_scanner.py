"""The scanning sonar: its head, and what each of its pings hears."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.ros import echo_image
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.sensors import acoustics
from oysterbench.sensors.scanner import KIND, ScannerRecipe, ScanningSonar, head_angle
from tests.helpers.acoustic_scenes import at, ball, caster_over, wall

SITE = SiteRecipe()
STREAMS = Streams(6)


def scanner(**changes) -> ScannerRecipe:
    return ScannerRecipe(**{"name": "scan", "rate_hz": 10.0, "bins": 600, **changes})


def test_the_head_turns_all_the_way_round_and_starts_again():
    angles = np.array([head_angle(scanner(), k) for k in range(800)])
    assert angles[0] == 0
    assert np.all((angles > -np.pi) & (angles <= np.pi))
    np.testing.assert_allclose(np.diff(np.unwrap(angles)), np.radians(0.9))
    np.testing.assert_allclose(angles[400:], angles[:400])


def test_a_sector_is_swept_to_and_fro():
    angles = np.degrees([head_angle(scanner(sector_deg=90.0, step_deg=10.0), k) for k in range(37)])
    assert angles.min() == pytest.approx(-45.0)
    assert angles.max() == pytest.approx(45.0)
    np.testing.assert_allclose(np.abs(np.diff(angles)), 10.0)
    np.testing.assert_allclose(angles[18:36], angles[:18])


def test_a_turn_sees_the_walls_where_they_are():
    """A wall ahead at 4 m, seen at 4 m / cos(angle) by a vehicle that heads 30 degrees off it."""
    heard = ScanningSonar(caster_over(19.0, wall(4.0)), scanner(vfov_deg=6.0, step_deg=5.0), SITE)
    half_bin = (heard.ranges[1] - heard.ranges[0]) / 2
    for index in (0, 60, 66, 68):  # 0, -60, -30 and -20 degrees
        angle = head_angle(heard.recipe, index) + np.radians(30.0)
        power, _ = heard.listen(at(0, 0, -9.0, yaw_deg=30.0), head_angle(heard.recipe, index), STREAMS)
        middle = np.sum(power * heard.ranges) / power.sum()
        spread = 4.0 * np.tan(abs(angle)) / np.cos(angle) * np.radians(2.0)
        assert middle == pytest.approx(4.0 / np.cos(angle), abs=half_bin + 0.1 * spread)
    behind, _ = heard.listen(at(0, 0, -9.0), np.pi, STREAMS)
    assert behind.max() == 0


def test_a_wall_that_fills_the_beam_has_the_power_of_the_law():
    heard = ScanningSonar(caster_over(19.0, wall(3.0)), scanner(vfov_deg=6.0), SITE)
    power, loss = heard.listen(at(0, 0, -9.0), 0.0, STREAMS)
    mu = acoustics.backscatter("sand")[3]
    assert power.sum() == pytest.approx(mu * 3.0**-2 * 10 ** (-0.2 * loss * 3.0), rel=0.02)


def test_the_vehicles_motion_between_pings_is_in_the_picture():
    heard = ScanningSonar(caster_over(19.0, wall(6.0)), scanner(vfov_deg=6.0, sector_deg=2.0), SITE)
    found = []
    for index in range(5):
        ping = heard.ping(at(0.5 * index, 0, -9.0), STREAMS, index, stamp_ns=index + 1)
        assert ping.stamp_ns == index + 1
        found.append(heard.ranges[np.argmax(ping.amplitudes)])
    np.testing.assert_allclose(found, 6.0 - 0.5 * np.arange(5), atol=0.05)


def test_a_narrow_beam_hears_a_ball_only_where_it_points():
    heard = ScanningSonar(caster_over(19.0, ball(4.0, 0, -9.0, 0.1)), scanner(vfov_deg=10.0), SITE)
    ahead, aside, away = (heard.listen(at(0, 0, -9.0), np.radians(a), STREAMS)[0].sum() for a in (0.0, 1.0, 6.0))
    assert aside / ahead == pytest.approx(0.5, abs=0.15)
    assert away == 0


def test_a_ping_is_the_same_each_time_and_another_is_not():
    heard = ScanningSonar(caster_over(3.0), scanner(), SITE)
    first, again, other = (heard.ping(at(0, 0, -1.0), STREAMS, k).amplitudes for k in (3, 3, 4))
    assert first.shape == (600,)
    assert first.dtype == np.uint16
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_ping_of_other_ranges_than_the_calibration_has_is_refused():
    calibration = KIND.read_calibration(KIND.calibrate(scanner(), SITE))
    with pytest.raises(ValueError, match="scan: expected 600 x 1 amplitudes, as its calibration says, got 601 x 1"):
        KIND.decode("scan", calibration, echo_image(1, "scan_link", np.zeros((1, 601), dtype=np.uint16)), b"")
