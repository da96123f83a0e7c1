"""The north arrow of a map: where the magnetometer shows it, and none where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.measurements import MagneticMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench.mapping.north import magnetic_north
from oysterbench.mapping.views import PoseInterpolator
from oysterbench.report.density_figure import figure, notes
from oysterbench.sensors.magnetometer import MagnetometerCalibration
from tests.helpers.flat_reef import LANE, FlatReef, scattered
from tests.mapping.test_density_map import map_of

FIELD = np.array([0.0, 20e-6, -45e-6])  # T, east, north, up
IRON = np.array([30e-6, -10e-6, 5e-6])
SOFT = np.diag([1.2, 0.9, 1.0])


class Compassed(FlatReef):
    """With a magnetometer among iron, at headings (T,) rad, whose path was begun `wrong_rad` off."""

    def __init__(self, headings: np.ndarray, wrong_rad: float = 0.0, iron: np.ndarray = IRON, known: bool = True):
        places = np.column_stack([np.arange(len(headings)) * 0.1, np.zeros(len(headings))])
        super().__init__(places, scattered(-0.2, 0.4))
        self.headings, self.wrong_rad, self.iron = headings, wrong_rad, iron
        calibration = MagnetometerCalibration(np.eye(4))
        self.magnetometer_calibration = replace(calibration, hard_iron_t=iron, soft_iron=SOFT) if known else calibration

    def truth(self) -> Trajectory:
        turned = Rotation.from_euler("z", (self.headings + self.wrong_rad)[:, None]).as_quat()
        return replace(super().truth(), quaternions=turned)

    def magnetometer(self, start_ns=None, end_ns=None):
        generator = np.random.default_rng(1)
        for stamp, field in zip(
            self.stamps, Rotation.from_euler("z", -self.headings[:, None]).apply(FIELD), strict=True
        ):
            noise = 0.5e-6 * generator.standard_normal(3)
            yield MagneticMeasurement(int(stamp), SOFT @ field + self.iron + noise, 0.25e-12)


TURNING, STRAIGHT = np.linspace(0, 2 * np.pi, 40), np.full(40, 0.7)


def north_of(reef: FlatReef) -> float | None:
    return magnetic_north(reef, PoseInterpolator(reef.truth(), 0.3))


@pytest.mark.parametrize("wrong", [0.0, 0.4, 3.24, -1.9])
@pytest.mark.parametrize("headings", [TURNING, STRAIGHT])
def test_north_is_found_however_the_path_began(headings, wrong):
    found = north_of(Compassed(headings, wrong))
    # The path's world is turned by `wrong`, against the clock, from the world of the field.
    assert np.angle(np.exp(1j * (found + wrong))) == pytest.approx(0.0, abs=0.02)


def test_where_readings_do_not_agree_there_is_no_north():
    assert north_of(Compassed(TURNING, known=False)) is None
    wandering = Compassed(STRAIGHT)
    wandering.headings = np.linspace(0, 3, 40)
    readings, wandering.headings = list(wandering.magnetometer()), STRAIGHT
    wandering.magnetometer = lambda: iter(readings)
    assert north_of(wandering) is None
    assert north_of(FlatReef(LANE, scattered(-0.2, 0.4))) is None


def test_iron_that_nobody_knows_is_only_seen_by_who_turns():
    no_iron = np.zeros(3)
    assert north_of(Compassed(TURNING, iron=no_iron, known=False)) == pytest.approx(0.0, abs=0.1)
    assert north_of(Compassed(STRAIGHT, iron=no_iron, known=False)) is None


def test_the_arrow_is_drawn_where_north_is_known_and_only_there():
    without = map_of(FlatReef(LANE[:3], scattered(-0.6, 1.8)))
    assert not arrows(figure(without))
    (arrow,) = arrows(figure(replace(without, magnetic_north_rad=2.0)))
    to, at = np.array(arrow.xy), np.array(arrow.xyann)
    assert np.arctan2(*(to - at)) == pytest.approx(2.0)


def test_where_no_magnetometer_shows_north_the_page_says_what_up_is():
    without = map_of(FlatReef(LANE[:3], scattered(-0.6, 1.8)))
    assert any("north where the path is the ground truth" in note for note in notes(without))
    assert "N is magnetic north; up is +y of the path." in notes(replace(without, magnetic_north_rad=2.0))


def test_a_magnetometer_that_shows_no_north_along_this_path_is_not_called_absent():
    found = map_of(FlatReef(LANE[:3], scattered(-0.6, 1.8)))
    assert "No magnetometer shows where north is." in notes(found)[-1]
    disagreeing = map_of(Compassed(TURNING, known=False))
    assert disagreeing.magnetic_north_rad is None
    assert "The magnetometer does not show where north is" in notes(disagreeing)[-1]


def arrows(drawn):
    return [text for axes in drawn.axes for text in axes.texts if text.get_text() == "N"]
