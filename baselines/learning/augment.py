"""Augmentation: randomly rotated, flipped and scaled crops of images, with changed colours, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.learning.samples import Floats, Sample, joined, offsets, standardised


@dataclass(frozen=True)
class Augmentation:
    """Strength of the augmentation. In units of the image's own contrast: gain and shift of the brightness, tint (an
    independent shift of each channel), noise, and veil (changes that vary over the crop, as light and water do). zoom:
    smallest and largest. Probabilities: grey, of losing the colours; blur, of a blur by up to blur_px."""

    crop: int = 128
    zoom: tuple[float, float] = (0.75, 1.35)
    gain: float = 0.25
    shift: float = 0.3
    tint: float = 0.15
    noise: float = 0.1
    grey: float = 0.15
    blur: float = 0.25
    blur_px: float = 1.5
    veil: float = 0.0


def augmented(
    sample: Sample, settings: Augmentation, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Draw an augmented crop: standardised pixels (C, C, 3), truth (C, C, 7) as in a `LabelledDataset`, and known
    (C, C) uint8."""
    matrix = _placement(sample.known.shape, settings, rng)
    size = (settings.crop, settings.crop)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    # Mirror the image beyond its border: with black the network would learn the border, and mirrored pixels are as good
    # as any others.
    mirror = cv2.BORDER_REFLECT_101
    pixels = cv2.warpAffine(sample.pixels, matrix, size, flags=flags, borderMode=mirror)
    truth = cv2.warpAffine(sample.truth, matrix, size, flags=flags, borderMode=mirror)
    known = cv2.warpAffine(sample.known, matrix, size, flags=flags, borderMode=mirror)
    values = recoloured(
        standardised(np.asarray(pixels, np.uint8), sample.mean, sample.contrast), sample.contrast, settings, rng
    )
    # No centres beyond the image: mirrored pixels would need the mirrored centre.
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    numbers = cv2.warpAffine(sample.numbers, matrix, size, flags=nearest, borderMode=cv2.BORDER_CONSTANT)
    towards = offsets(np.asarray(numbers, np.uint16), _moved(sample.centres, matrix))
    return values, joined(np.asarray(truth, np.uint8), towards), np.where(known == 255, 255, 0).astype(np.uint8)


def _moved(centres: Floats, matrix: Floats) -> Floats:
    """Transform centres and radii (N, 3) from px of the image to px of a crop; `matrix` (2, 3) maps crop to image."""
    back = np.linalg.inv(matrix[:, :2].astype(np.float64))
    places = (centres[:, :2] - matrix[:, 2]) @ back.T
    return np.column_stack([places, centres[:, 2] * math.sqrt(abs(np.linalg.det(back)))]).astype(np.float32)


def _placement(shape: tuple[int, ...], settings: Augmentation, rng: np.random.Generator) -> Floats:
    """Draw the affine matrix (2, 3) from crop pixels to image pixels: any rotation, mirrored half the time, centred so
    that the crop stays inside the image where it fits."""
    height, width = shape
    zoom = math.exp(rng.uniform(math.log(settings.zoom[0]), math.log(settings.zoom[1])))
    angle = rng.uniform(0, 2 * math.pi)
    flip = -1.0 if rng.random() < 0.5 else 1.0
    cos, sin = math.cos(angle) / zoom, math.sin(angle) / zoom
    turn = np.array([[cos * flip, -sin], [sin * flip, cos]])
    reach = settings.crop / 2 / zoom
    centre = [rng.uniform(min(reach, n / 2), max(n - reach, n / 2)) for n in (width, height)]
    middle = (settings.crop - 1) / 2
    offset = np.array(centre) - 0.5 - turn @ [middle, middle]
    return np.column_stack([turn, offset]).astype(np.float32)


def recoloured(values: Floats, contrast: Floats, settings: Augmentation, rng: np.random.Generator) -> Floats:
    """Change the colours of standardised pixels (h, w, 3) and add blur and noise. contrast: (3,), of the original
    image."""
    if rng.random() < settings.blur:
        values = np.asarray(cv2.GaussianBlur(values, (0, 0), rng.uniform(0.4, settings.blur_px)), np.float32)
    if rng.random() < settings.grey:
        weights = contrast / contrast.sum()
        values = np.repeat((values @ weights)[..., None], 3, axis=2)
    if settings.veil:
        values = veiled(values, settings.veil, rng)
    gain = math.exp(rng.normal(0, settings.gain))
    shift = rng.normal(0, settings.shift) + rng.normal(0, settings.tint, 3)
    noise = rng.standard_normal(values.shape, dtype=np.float32) * np.float32(abs(rng.normal(0, settings.noise)))
    return (values * np.float32(gain) + shift.astype(np.float32) + noise).astype(np.float32)


def veiled(values: Floats, strength: float, rng: np.random.Generator) -> Floats:
    """Simulate uneven light and water on standardised pixels (h, w, 3): contrast and brightness that vary smoothly over
    the image. strength: standard deviation of the logarithm of the contrast, and of the brightness."""
    height, width = values.shape[:2]
    coarse = (strength * rng.standard_normal((3, 3, 2))).astype(np.float32)
    fields = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(values * np.exp(fields[..., :1]) + fields[..., 1:], dtype=np.float32)
