"""Application of a trained generator to whole images, at their own size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn import functional

from oysterbench.annotations import LabelledImage
from oysterbench.core.errors import MethodError
from oysterbench.core.text import in_one_line
from oysterbench_baselines.cut.networks import Generator
from oysterbench_baselines.cut.pictures import Picture, as_picture, as_tensor, shrunk
from oysterbench_baselines.cut.settings import CutSettings
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint

MULTIPLE = 4  # px: the generator halves width and height twice, so both must be multiples of it


def load_generator(path: Path) -> tuple[Generator, CutSettings]:
    """Load the generator of a checkpoint, finished or not. Raises MethodError where it is of another kind of
    training."""
    return generator_of(read_checkpoint(path), str(path))


def generator_of(checkpoint: Checkpoint, where: str) -> tuple[Generator, CutSettings]:
    """Build the generator that a checkpoint holds. where: the file, for messages. Raises MethodError where there is
    none."""
    try:
        settings = CutSettings(**{**checkpoint.network, "layers": tuple(checkpoint.network["layers"])})
        generator = Generator(settings)
        generator.load_state_dict(checkpoint.weights["generator"])
    except (KeyError, TypeError, RuntimeError) as error:
        raise MethodError(
            f"{where}: holds no translation ({in_one_line(error, 100)}); `oysterbench train cut` makes one"
        ) from None
    return generator.eval(), settings


def translate(generator: Generator, settings: CutSettings, picture: Picture) -> Picture:
    """Translate an image (H, W, 3) uint8 at its own size.

    Where the generator works at a smaller scale, the change it makes there is enlarged to full size and added, so that
    edges stay as sharp as they were, and where they were.
    """
    small = shrunk(picture, settings.scale)
    height, width = small.shape[:2]
    values = as_tensor(small).to(next(generator.parameters()).device)
    room = (0, -width % MULTIPLE, 0, -height % MULTIPLE)
    with torch.inference_mode():
        found = generator(functional.pad(values, room, mode="replicate"))[..., :height, :width]
    if settings.scale == 1.0:
        return as_picture(found)
    change = (found - values)[0].cpu().numpy().transpose(1, 2, 0) * 127.5
    size = (picture.shape[1], picture.shape[0])
    grown = cv2.resize(np.ascontiguousarray(change), size, interpolation=cv2.INTER_LINEAR)
    return np.clip(np.round(picture + grown), 0, 255).astype(np.uint8)


def translated(generator: Generator, settings: CutSettings, images: Iterable[LabelledImage]) -> Iterator[LabelledImage]:
    """Translate labelled images; their labels stay as they are."""
    for image in images:
        yield replace(image, pixels=translate(generator, settings, image.pixels))
