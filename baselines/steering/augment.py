"""Augmentation of a training example: mirrored together with its commands, shifted slightly, with changed water and
colours."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.learning.augment import Augmentation, recoloured
from oysterbench_baselines.learning.samples import Floats, standardised, statistics


@dataclass(frozen=True)
class SteeringAugmentation:
    """Strength of the augmentation.

    flip: probability of mirroring. move: maximum shift of an image, px: 4 of 96 are 3 deg, a third of a class. haze:
    maximum share of the light that water takes away at the top of the image. senses: noise on the vehicle's senses.
    colours: as in trainings on masks, whose crop and zoom are not used here.
    """

    flip: float = 0.5
    move: float = 4.0
    haze: float = 0.5
    senses: float = 0.1
    colours: Augmentation = field(default_factory=Augmentation)


def augmented(
    pixels: NDArray[np.uint8],
    senses: Floats,
    looked: NDArray[np.uint8],
    action_values: Floats,
    settings: SteeringAugmentation,
    rng: np.random.Generator,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Augment a training example: pixels (h, w, 3), senses (SENSES,), looked (memory.SHAPE) and action_values (Y, P).
    Returns the same four, with standardised pixels."""
    if rng.random() < settings.flip:
        pixels, looked, action_values = mirrored(pixels, looked, action_values)
    shift = np.column_stack([np.eye(2), rng.uniform(-settings.move, settings.move, 2)])
    size = (pixels.shape[1], pixels.shape[0])
    moved = cv2.warpAffine(np.ascontiguousarray(pixels), shift, size, borderMode=cv2.BORDER_REFLECT_101)
    hazy = _hazed(np.asarray(moved, np.uint8), rng.uniform(0, settings.haze), rng)
    mean, contrast = statistics(hazy)
    shown = recoloured(standardised(hazy, mean, contrast), contrast, settings.colours, rng)
    told = senses + rng.normal(0, settings.senses, senses.shape)
    return shown, told.astype(np.float32), looked.astype(np.float32), action_values


def mirrored(
    pixels: NDArray[np.uint8], looked: NDArray[np.uint8], action_values: Floats
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Mirror an image (h, w, 3), the map of what was looked at, and the values of commands (Y, P), left to right."""
    return pixels[:, ::-1], looked[:, ::-1], action_values[::-1]


def _hazed(pixels: NDArray[np.uint8], share: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Blend the image with light of the water, from nothing at the bottom, which is near, to `share` at the top."""
    veil = np.array(cv2.mean(pixels)[:3]) * rng.uniform(0.7, 1.3)
    rows = np.linspace(share, 0, len(pixels))[:, None, None]
    return np.clip(pixels * (1 - rows) + veil * rows, 0, 255).astype(np.uint8)
