"""Small images for the report: oyster pixels found, missed, and falsely detected."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import OysterbenchError
from oysterbench.evaluate.segmentation import TruthImage
from oysterbench.report.images import Sample

WIDTH = 480  # px, width in the report
COLOURS = {"found": (0, 200, 120), "missed": (60, 130, 255), "wrong": (255, 90, 40), "ignored": (128, 128, 128)}
"""RGB; `report.images.LEGEND` explains them."""
STRENGTH = 0.55


def overlay(truth: TruthImage, pixels: NDArray[np.uint8] | None, mask: NDArray[np.bool_], method: str) -> Sample:
    """Overlay an image, or grey if there is none, with the pixels of each kind in their colour."""
    height, width = mask.shape
    base = np.full((height, width, 3), 90, np.uint8) if pixels is None else pixels
    true = truth.oyster
    painted = base.astype(np.float32)
    for kind, where in (("found", true & mask), ("missed", true & ~mask), ("wrong", ~true & mask)):
        painted[where] += STRENGTH * (np.array(COLOURS[kind], np.float32) - painted[where])
    if truth.ignore is not None:
        painted[truth.ignore] = np.array(COLOURS["ignored"], np.float32)
    return Sample(truth.name, method, jpeg(painted.astype(np.uint8)))


def jpeg(pixels: NDArray[np.uint8]) -> bytes:
    """Encode an image (H, W, 3) uint8 RGB as a small JPEG."""
    height, width = pixels.shape[:2]
    size = (min(WIDTH, width), round(height * min(WIDTH, width) / width))
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 82])
    if not done:
        raise OysterbenchError("an image of the report could not be encoded")
    return data.tobytes()


def sampled(names: tuple[str, ...], count: int) -> set[str]:
    """Choose at most `count` names, evenly spaced."""
    count = min(count, len(names))
    return {names[round(k * (len(names) - 1) / max(1, count - 1))] for k in range(count)}
