"""Augmentation of a training example: mirrored with its commands, moved a little, in other water and with other
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
    """How far things are changed.

    flip: chance of being mirrored. move: px, by which a picture is moved at most: 4 of 96 are 3 deg, a third of a
    class. haze: share of the light that water takes away at the top of the picture, at most. senses: noise on what the
    vehicle tells. colours: as of trainings on masks, whose crop and zoom have no part in this.
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
    """Of a training example, pixels (h, w, 3), senses (SENSES,), looked (memory.SHAPE) and action_values (Y, P): the
    same, pixels standardised."""
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
    """A picture (h, w, 3), the map of what was looked at, and the values of commands (Y, P), as a mirror shows them:
    left is right."""
    return pixels[:, ::-1], looked[:, ::-1], action_values[::-1]


def _hazed(pixels: NDArray[np.uint8], share: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Light of the water over the picture, growing from nothing at the bottom, which is near, to `share` at the top."""
    veil = np.array(cv2.mean(pixels)[:3]) * rng.uniform(0.7, 1.3)
    rows = np.linspace(share, 0, len(pixels))[:, None, None]
    return np.clip(pixels * (1 - rows) + veil * rows, 0, 255).astype(np.uint8)
