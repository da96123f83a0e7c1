"""The mask of what moves in an image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.methods.weights import existing
from oysterbench_baselines.learning.trained import on_torch, used_path

if TYPE_CHECKING:
    from oysterbench_baselines.learning.masks import MaskModel

PROBABILITY = 0.3
"""Probability above which a pixel counts as moving: one moving corner missed costs more than ten static ones left
out."""
MARGIN_PX = 4
"""Margin by which a mask is dilated, px: a patch beside a blade partly moves with it."""


class MovingMask:
    """Detector of moving pixels: maps an image (H, W, 3) uint8 RGB, or (H, W) grey, to a mask (H, W) bool.

    weights: checkpoint file; "moving" stands for the one that OYSTERBENCH_MOVING names, or that `oysterbench train
    moving` or `oysterbench download moving` leaves. Runs on one thread, so that the CPU time of a method stays its own.
    Raises MethodError, which says what to type, where the weights or PyTorch are missing.
    """

    def __init__(self, weights: str = "moving") -> None:
        self._model = _read(existing("moving", _path(weights)))
        self._around = np.ones((2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1), dtype=np.uint8)

    def __call__(self, pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """See the class."""
        from oysterbench_baselines.learning.masks import probability

        rgb = pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
        found = (probability(self._model.small_logits(np.asarray(rgb))[0]) > PROBABILITY).astype(np.uint8)
        height, width = pixels.shape[:2]
        whole = cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(cv2.dilate(whole, self._around) > 0)


def mask_weights(weights: str) -> dict[str, Path]:
    """Files of the trained weights that a mask needs; empty without a mask."""
    return {"moving": _path(weights)} if weights else {}


def _path(weights: str) -> Path:
    return used_path("moving", "" if weights == "moving" else weights)


def _read(path: Path) -> MaskModel:
    with on_torch("mask"):
        import torch

        from oysterbench_baselines.learning.checkpoint import read_finished
        from oysterbench_baselines.moving.labels import SET
        from oysterbench_baselines.unet.model import unet_model
    torch.set_num_threads(1)
    checkpoint = read_finished(path)
    learnt = list(checkpoint.identity.get("data", {}))
    if not learnt or not all(name.startswith(SET) for name in learnt):
        raise MethodError(
            f"mask: {path}: expected weights of `oysterbench train moving`, got some that have learnt from "
            f"{', '.join(learnt) or 'nothing that they name'}"
        )
    return unet_model(checkpoint)
