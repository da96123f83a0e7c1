"""Trainings of seconds: small pictures, a small network, a few steps."""

from __future__ import annotations

from pathlib import Path

from oysterbench.annotations import LabelledSet, open_labelled, write_folder
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.loop import FitSettings
from oysterbench_baselines.unet.network import UNetworkSettings
from oysterbench_baselines.unet.training import UNetSettings
from tests.helpers.labelled_folders import image

SMALL = UNetSettings(
    batch=4,
    network=UNetworkSettings(depth=3, base=4, groups=2, scale=0.5),
    augmentation=Augmentation(crop=24),
    fit=FitSettings(steps=12, warm_up=2, threads=1),
)


def small_set(folder: Path, clips: dict[str, tuple[str, int]], first: int = 0) -> LabelledSet:
    """A folder of masks: clip -> side and number of images."""
    images, sides = [], {}
    for clip, (side, count) in clips.items():
        for _ in range(count):
            images.append(image(first, clip, 64, 80))
            sides[images[-1].name] = side
            first += 1
    write_folder(images, folder, sides)
    return open_labelled(folder)
