"""A fan of an imaging sonar as an image of a level bottom.

A beam tells azimuth and range, not elevation: given the sonar's height over a level bottom and its attitude, a point of
the bottom has one place in the fan (Hurtos et al. 2015, J. Field Robotics 32(1), sec. 3, on why that suffices where
relief is small against the range).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import SonarCalibration
from oysterbench_baselines.common.aiding.sonar.settings import FanSettings

WIDTH = 256
"""Number of columns into which points are folded: OpenCV takes no image of more than 32767."""


@dataclass(frozen=True)
class Grid:
    """Ranges (m) and azimuths (rad, left positive) of a fan's rows and columns, which are evenly spaced."""

    first_range: float
    range_step: float
    bins: int
    first_azimuth: float
    azimuth_step: float
    beams: int

    @staticmethod
    def of(calibration: SonarCalibration) -> Grid:
        """Build from a calibration. Raises ValueError where ranges or azimuths are not evenly spaced."""
        ranges, azimuths = np.asarray(calibration.ranges_m), np.asarray(calibration.azimuths_rad)
        for name, values in (("ranges", ranges), ("azimuths", azimuths)):
            steps = np.diff(values)
            if len(steps) < 2 or np.abs(steps - steps.mean()).max() > 0.01 * abs(steps.mean()):
                raise ValueError(f"sonar: expected at least three even {name}, got steps {np.unique(steps)[:4]}")
        range_step, azimuth_step = (float((v[-1] - v[0]) / (len(v) - 1)) for v in (ranges, azimuths))
        return Grid(float(ranges[0]), range_step, len(ranges), float(azimuths[0]), azimuth_step, len(azimuths))


@dataclass(frozen=True)
class View:
    """Height and attitude of a sonar over a bottom: height (m) over its plane; level (3, 3): rotation from the sonar's
    axes to level ones of the same heading."""

    height: float
    level: Array


def texture(pixels: NDArray[np.uint16], grid: Grid, settings: FanSettings) -> NDArray[np.float32]:
    """Echoes (bins, beams) in dB over their surroundings; weaker ones are 0, as shadows depend on the sonar's place.

    Raises ValueError where the image is not of the grid's shape.
    """
    if pixels.shape != (grid.bins, grid.beams):
        raise ValueError(f"sonar: expected an image of {grid.bins} bins x {grid.beams} beams, got {pixels.shape}")
    power = cv2.GaussianBlur(pixels.astype(np.float32) ** 2, (0, 0), settings.smooth_px)
    level = 10 * np.log10(power + 10 ** (settings.floor_db / 10))
    rows = _odd(settings.veil_m / grid.range_step)
    columns = _odd(np.radians(settings.veil_deg) / abs(grid.azimuth_step))
    return np.asarray(np.maximum(level - cv2.blur(level, (columns, rows)), 0.0), dtype=np.float32)


def _odd(size: float) -> int:
    return 2 * int(size / 2) + 1


def sample(
    picture: NDArray[np.float32], points: Array, place: Array, view: View, grid: Grid, settings: FanSettings
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Sample a fan's image (bins, beams) at points (N, 2) m of a level bottom: values (N,), and which it shows (N,).

    place (3,): x, y (m) and heading (rad) of the sonar in the points' frame.
    """
    cosine, sine = np.cos(place[2]), np.sin(place[2])
    x, y = points[:, 0] - place[0], points[:, 1] - place[1]
    ahead, left, turn = cosine * x + sine * y, cosine * y - sine * x, view.level
    ground = ahead * ahead + left * left
    ranges = np.sqrt(ground + view.height**2)
    front, side, up = (turn[0, k] * ahead + turn[1, k] * left - turn[2, k] * view.height for k in range(3))
    row = (ranges - grid.first_range) / grid.range_step
    column = (np.arctan2(side, front) - grid.first_azimuth) / grid.azimuth_step
    lowest, highest = np.sin(np.radians([-settings.lowest_deg, settings.highest_deg]))
    seen = (up > lowest * ranges) & (up < highest * ranges) & (ground < settings.reach_m**2)
    seen &= (row > 2) & (row < grid.bins - 3) & (column > 1) & (column < grid.beams - 2)
    return _interpolate(picture, row, column), seen


def _interpolate(picture: NDArray[np.float32], row: Array, column: Array) -> NDArray[np.float32]:
    """Values (N,), interpolated linearly between pixels."""
    missing = -len(row) % WIDTH
    at = [np.pad(values.astype(np.float32), (0, missing)).reshape(-1, WIDTH) for values in (column, row)]
    return np.asarray(cv2.remap(picture, at[0], at[1], cv2.INTER_LINEAR).ravel()[: len(row)])


def first_echo(pixels: NDArray[np.uint16], grid: Grid, near_share: float) -> float:
    """Range (m) at which the bottom's echo starts in the middle third of a fan, where its power reaches a share of the
    highest; NaN where there is no echo."""
    third = grid.beams // 3
    profile = np.median(pixels[:, third : grid.beams - third].astype(float), axis=1) ** 2
    profile = np.convolve(profile, np.full(9, 1 / 9), mode="same")
    strong = np.flatnonzero(profile >= near_share * profile.max())
    if profile.max() <= 0:
        return float("nan")
    return grid.first_range + grid.range_step * float(strong[0])
