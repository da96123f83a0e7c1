"""Registration of a fan with the chart: horizontal pose of the sonar with a covariance, or that it cannot be told.

Hurtos et al. (2015, J. Field Robotics 32(1)) register fans of forward-looking sonars as whole images of the ground, by
correlation for all shifts at once in the Fourier domain. So does the first step here, where the displacement is not
known well. The correlation is normalised and leaves out what either image does not show (Padfield 2012, IEEE Trans.
Image Processing 21(5)): their phase correlation finds the fan's own outline in both, which stands still. The rotation
is known from the gyroscopes. The second step finds shift and rotation to a fraction of a cell: Gauss-Newton on
the cells, up to a gain (Evangelidis & Psarakis 2008, IEEE TPAMI 30(10)), in its inverse form (Baker & Matthews 2004,
IJCV 56(3)), whose gradients are those of the chart.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.sonar.chart import Chart
from oysterbench_baselines.common.aiding.sonar.fan import Grid, View, sample
from oysterbench_baselines.common.aiding.sonar.settings import FanSettings, RegistrationSettings

COARSE = 2  # cells of the chart, along each side, to one of the search
WORST_CONDITION = 1e10  # of the information: m and rad are of similar size here
LEAST_GAIN = 0.02  # of a fan's image over the chart's: less is none


@dataclass(frozen=True)
class Guess:
    """Predicted place (3,), x, y (m) and heading (rad) in the chart's frame, and 1 sigmas of position (m) and heading.

    The heading is held by its sigma, as known from the gyroscopes; the position is only where the search starts.
    """

    place: Array
    position_sigma: float
    heading_sigma: float


@dataclass(frozen=True)
class Match:
    """Where a fan lies on the chart: place (3,) and covariance (3, 3), m and rad; alike: correlation with the chart."""

    place: Array
    covariance: Array
    alike: float


def register(
    chart: Chart,
    picture: NDArray[np.float32],
    view: View,
    guess: Guess,
    grid: Grid,
    fan: FanSettings,
    settings: RegistrationSettings,
) -> Match | None:
    """Locate the sonar that shows `picture` (bins, beams) on the chart; None where they do not fit, or fit twice."""
    place, off = guess.place, 3 * guess.position_sigma
    radius = min(off, settings.most_search_m)
    if off > settings.basin_m:
        found = search(chart, picture, view, place, radius, grid, fan, settings)
        if found is None:
            return None
        place = found
    match = refine(chart, picture, view, place, grid, fan, settings, guess.heading_sigma)
    if match is None or match.alike < settings.least_alike:
        return None
    miss = match.place - guess.place
    too_far = np.hypot(miss[0], miss[1]) > radius + settings.basin_m
    return None if too_far or abs(miss[2]) > 3 * guess.heading_sigma + settings.yaw_slack else match


def search(
    chart: Chart,
    picture: NDArray[np.float32],
    view: View,
    place: Array,
    radius: float,
    grid: Grid,
    fan: FanSettings,
    settings: RegistrationSettings,
) -> Array | None:
    """Find the place within `radius` (m) of a given one, at its heading, with the highest correlation; None where it is
    low, or nearly as high somewhere else."""
    shape, size = chart.values.shape, chart.settings.cells // COARSE
    shown, seen = sample(picture, chart.points(np.arange(chart.values.size)), place, view, grid, fan)
    there, mask_there = _coarse(shown.reshape(shape), seen.reshape(shape), size)
    known, mask_known = _coarse(chart.values, chart.fans > 0, size)

    def correlate(a: Array, b: Array) -> Array:
        """Sum of a(c) b(c + shift), for all shifts."""
        return np.asarray(np.fft.irfft2(np.conj(np.fft.rfft2(a)) * np.fft.rfft2(b), s=a.shape))

    power = correlate(there**2, mask_known) * correlate(mask_there, known**2)
    count = correlate(mask_there, mask_known)
    step = COARSE * chart.settings.cell_m
    shifts = np.fft.fftfreq(size, 1 / size) * step
    x, y = np.meshgrid(shifts, shifts, indexing="ij")
    near = (np.hypot(x, y) <= radius) & (count * COARSE**2 >= settings.least_cells) & (power > 1e-9)
    if not near.any():
        return None
    alike = np.where(near, correlate(there, known) / np.sqrt(np.where(near, power, 1.0)), -1.0)
    best = np.unravel_index(np.argmax(alike), alike.shape)
    apart = np.hypot(x - x[best], y - y[best]) > settings.rival_m
    rival = float(alike[apart].max()) if apart.any() else -1.0
    if alike[best] < settings.least_alike or rival > settings.rival * alike[best]:
        return None
    return np.asarray(place + np.array([x[best], y[best], 0.0]))


def _coarse(values: NDArray[np.float32], known: NDArray[np.bool_], size: int) -> tuple[Array, Array]:
    """Downsample values (n, n), less their mean where known and 0 elsewhere, and the mask of known ones: (size, size)
    both."""
    shape = size, size
    mask = cv2.resize(known.astype(np.float32), shape, interpolation=cv2.INTER_AREA) > 0.99
    found = cv2.resize(np.where(known, values, np.float32(0)), shape, interpolation=cv2.INTER_AREA)
    mean = found[mask].mean() if mask.any() else 0.0
    return np.where(mask, found - mean, 0.0).astype(float), mask.astype(float)


def refine(
    chart: Chart,
    picture: NDArray[np.float32],
    view: View,
    place: Array,
    grid: Grid,
    fan: FanSettings,
    settings: RegistrationSettings,
    heading_sigma: float = np.inf,
) -> Match | None:
    """Refine a place that is off by less than the width of features on the ground; None where it does not converge.

    heading_sigma: rad, of the place's heading, where it is known.

    A fan at `place` off by d = (dx, dy, turn) from the truth shows at a point c what is at c - dx - turn z x (c - o):
    fan - gain chart = -gain gradient . d, o being the sonar's place.
    """
    cells, values, gradients = _steepest(chart, settings.most_cells)
    if len(cells) < settings.least_cells:
        return None
    points, place, first = chart.points(cells), np.array(place, dtype=float), place
    for _ in range(settings.iterations):
        shown, seen = sample(picture, points, place, view, grid, fan)
        if np.count_nonzero(seen) < settings.least_cells:
            return None
        gradient, arm = gradients[seen], points[seen] - place[:2]
        known, found = values[seen] - values[seen].mean(), shown[seen] - shown[seen].mean()
        energy = float(known @ known)
        gain = float(known @ found) / energy if energy > 0 else 0.0
        if gain < LEAST_GAIN:
            return None
        slope = np.column_stack([gradient, gradient[:, 1] * arm[:, 0] - gradient[:, 0] * arm[:, 1]])
        slope = gain * (slope - slope.mean(axis=0))
        missing = found - gain * known
        variance = float(missing @ missing) / len(missing)
        weight = 1.0 / (1.0 + missing**2 / (settings.cauchy**2 * max(variance, 1e-12)))
        white = max(variance, 1e-12) * settings.alike**2
        information = slope.T @ (weight[:, None] * slope) / white
        information[2, 2] += heading_sigma**-2
        if np.linalg.cond(information) > WORST_CONDITION:
            return None
        pull = slope.T @ (weight * missing) / white
        pull[2] += (first[2] - place[2]) * heading_sigma**-2
        step = np.linalg.solve(information, pull)
        place += step
        if np.abs(step[:2]).max() < settings.tolerance_m and abs(step[2]) < settings.tolerance_rad:
            break
    else:
        return None
    alike = gain * np.sqrt(energy / float(found @ found))
    return Match(place, np.linalg.inv(information), float(alike))


def _steepest(chart: Chart, most: int) -> tuple[NDArray[np.int64], Array, Array]:
    """The most informative cells (N,) of the chart, their values (N,) and gradients (N, 2), 1/m."""
    smooth = cv2.GaussianBlur(chart.values, (0, 0), 0.7)
    scale = 1 / (8 * chart.settings.cell_m)
    by_x, by_y = (cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=scale) for dx in (0, 1))
    inside = cv2.erode((chart.fans > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    steepness = np.where(inside, by_x**2 + by_y**2, 0).ravel()
    cells = np.flatnonzero(steepness > 0)
    if len(cells) > most:
        least = np.partition(steepness[cells], len(cells) - most)[len(cells) - most]
        cells = cells[steepness[cells] >= least]
    values, gradients = smooth.ravel()[cells], np.column_stack([by_x.ravel()[cells], by_y.ravel()[cells]])
    return cells, values.astype(float), gradients.astype(float)
