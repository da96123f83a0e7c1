"""A mask network and its predictions for images of any size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from oysterbench_baselines.learning.samples import Floats, shrink, standardised, statistics, working_scale

LARGEST_TILE = 768
"""px at the working scale: larger images are processed in tiles, so that memory does not grow with them."""
MARGIN = 64
"""Margin of a tile, px: predictions nearer than this to a tile's border are taken from the adjacent tile."""


@dataclass
class MaskModel:
    """A network with its weights, ready to predict: (1, 3, h, w) standardised pixels to (1, K, h, w) logits.

    scale, side: at which an image is processed, see `working_scale`; multiple: h and w must be multiples of it, px;
    planes: K, of which the first two are oyster and depth
    """

    network: torch.nn.Module
    scale: float
    multiple: int
    device: torch.device
    side: int = 0
    planes: int = 2

    def small_logits(self, pixels: NDArray[np.uint8], zoom: float = 1.0) -> Floats:
        """Logits (K, h, w), float32, at the working scale times zoom, for an image (H, W, 3) uint8 RGB."""
        small = shrink(pixels, zoom * working_scale(pixels.shape, self.scale, self.side))
        values = standardised(small, *statistics(small))
        prediction = np.empty((self.planes, *small.shape[:2]), dtype=np.float32)
        for rows, inner_rows in _parts(small.shape[0]):
            for columns, inner_columns in _parts(small.shape[1]):
                part = self._logits(values[rows, columns])
                prediction[:, inner_rows, inner_columns] = part[
                    :, _within(inner_rows, rows.start), _within(inner_columns, columns.start)
                ]
        return prediction

    def logits(self, pixels: NDArray[np.uint8]) -> Floats:
        """Logits (K, H, W), float32, at the size of the image (H, W, 3) uint8 RGB."""
        return enlarged(self.small_logits(pixels), pixels.shape[0], pixels.shape[1])

    def _logits(self, values: Floats) -> Floats:
        height, width = values.shape[:2]
        with torch.inference_mode():
            found = self.network(self.batch(values))[0, :, :height, :width]
        return np.asarray(found.float().cpu().numpy(), dtype=np.float32)

    def batch(self, values: Floats) -> torch.Tensor:
        """Convert standardised pixels (h, w, 3) to the network's input (1, 3, h, w), h and w padded to `multiple`."""
        height, width = values.shape[:2]
        step = self.multiple
        padded = cv2.copyMakeBorder(values, 0, -height % step, 0, -width % step, cv2.BORDER_REPLICATE)
        planes = torch.from_numpy(padded)[None].permute(0, 3, 1, 2)  # channels last already
        return planes.to(device=self.device, memory_format=torch.channels_last)


def enlarged(logits: Floats, height: int, width: int) -> Floats:
    """Resize logits (K, h, w) bilinearly to (K, height, width), with the outer corners of the images aligned."""
    tensor = torch.from_numpy(np.ascontiguousarray(logits))[None]
    found = functional.interpolate(tensor, size=(height, width), mode="bilinear", align_corners=False)
    return np.asarray(found[0].numpy(), dtype=np.float32)


def probability(logits: Floats) -> Floats:
    """Convert logits to probabilities, 0 to 1."""
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -30, 30))), dtype=np.float32)


def _parts(length: int) -> Iterator[tuple[slice, slice]]:
    """Tiles along a side, and the part of each that is kept; the kept parts together cover the side."""
    if length <= LARGEST_TILE:
        yield slice(0, length), slice(0, length)
        return
    stride = LARGEST_TILE - 2 * MARGIN
    begin = 0
    while True:
        end = min(begin + LARGEST_TILE, length)
        first, last = begin == 0, end == length
        yield slice(begin, end), slice(begin if first else begin + MARGIN, end if last else end - MARGIN)
        if last:
            return
        begin += stride


def _within(inner: slice, begin: int) -> slice:
    return slice(inner.start - begin, inner.stop - begin)
