"""Disturbances of images by water, light and cameras: added to rendered ones, differently for each of a pair."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Disturbances:
    """Probability of each disturbance, and its greatest strength.

    plume, plume_depth: silt, and its optical depth; caustics, caustic_contrast: a web of light, times the light; snow,
    specks: particles, and how many in an image of 100 x 100 px; noise_grey, 1 sigma; blur_px, 1 sigma; gain, 1 sigma
    of the logarithm; coding, quality: of JPEG, for a video link's blocks.
    """

    plume: float = 0.4
    plume_depth: float = 1.5
    caustics: float = 0.3
    caustic_contrast: float = 0.6
    snow: float = 0.4
    specks: float = 20.0
    noise: float = 0.5
    noise_grey: float = 5.0
    blur: float = 0.2
    blur_px: float = 1.0
    gain: float = 0.3
    coding: float = 0.3
    quality: tuple[int, int] = (25, 80)


def disturbed(picture: NDArray[np.uint8], settings: Disturbances, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Disturb a grey image (H, W) as it might have looked at another moment."""
    values = picture.astype(np.float32)
    if rng.random() < settings.caustics:
        values *= 1 + rng.uniform(0, settings.caustic_contrast) * (_web(picture.shape, rng) - 0.4)
    if rng.random() < settings.blur:
        values = _blurred(values, rng.uniform(0.3, settings.blur_px))
    if rng.random() < settings.plume:
        seen = np.exp(-rng.uniform(0, settings.plume_depth) * _cloud(picture.shape, rng))
        values = values * seen + np.float32(rng.uniform(0.5, 1.5) * values.mean()) * (1 - seen)
    if rng.random() < settings.snow:
        values += _specks(picture.shape, rng.uniform(0, settings.specks), rng)
    values *= np.float32(math.exp(rng.normal(0, settings.gain)))
    if rng.random() < settings.noise:
        values += rng.standard_normal(picture.shape, dtype=np.float32) * np.float32(rng.uniform(0, settings.noise_grey))
    found = np.clip(values, 0, 255).astype(np.uint8)
    if rng.random() < settings.coding:
        coded = cv2.imencode(".jpg", found, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*settings.quality))])[1]
        found = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    return found


def _smooth(shape: tuple[int, ...], period_px: float, rng: np.random.Generator) -> Floats:
    """Smooth random field (H, W) of mean 0 and deviation about 1, which varies over `period_px` pixels."""
    small = (max(2, math.ceil(shape[0] / period_px) + 1), max(2, math.ceil(shape[1] / period_px) + 1))
    grid = rng.standard_normal(small, dtype=np.float32)
    return np.asarray(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _cloud(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Optical depth (H, W) of a plume, 1 in the mean: large lumps, with smaller ones in them."""
    lumps = _smooth(shape, rng.uniform(40, 120), rng) + 0.5 * _smooth(shape, rng.uniform(10, 30), rng)
    found = np.maximum(lumps + 0.5, 0)
    return np.asarray(found / max(float(found.mean()), 1e-3), dtype=np.float32)


def _web(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """A web of bright lines (H, W), 0 to 1: where a smooth field passes through zero."""
    field = _smooth(shape, rng.uniform(15, 50), rng)
    return np.exp(-np.abs(field) * rng.uniform(2, 6)).astype(np.float32)


def _specks(shape: tuple[int, ...], per_area: float, rng: np.random.Generator) -> Floats:
    """Light (H, W) of particles in focus and out of focus, grey levels."""
    found = np.zeros(shape, dtype=np.float32)
    for _ in range(rng.poisson(per_area * shape[0] * shape[1] / 1e4)):
        sigma, grey = rng.uniform(0.5, 2.5), rng.uniform(5, 60)
        reach = math.ceil(3 * sigma)
        x, y = rng.uniform(reach + 1, shape[1] - reach - 2), rng.uniform(reach + 1, shape[0] - reach - 2)
        rows, columns = np.arange(int(y) - reach, int(y) + reach + 1), np.arange(int(x) - reach, int(x) + reach + 1)
        spot = np.exp(-((rows[:, None] - y) ** 2 + (columns[None, :] - x) ** 2) / (2 * sigma**2))
        found[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += (grey * spot).astype(np.float32)
    return found


def _blurred(values: Floats, sigma_px: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_px), dtype=np.float32)
