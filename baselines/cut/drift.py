"""Mask drift: whether the content of a mask is still in the same place after a translation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.cut.colour import lab
from oysterbench_baselines.cut.pictures import Picture

BAND = 4
"""Width of the band on either side of a mask's border in which drift is measured, px."""
REACH = 12
"""Maximum shift of a border that is searched, px."""
BLUR = 1.0
"""Sigma by which images are smoothed before their gradients are computed, px: noise is not an edge."""
LEAST_BORDER = 200
"""Minimum area of the bands for an image to be judged at all, px."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Drift:
    """Drift of one image. NaN where its masks have too little border to measure.

    edges:    correlation of the two images' gradient magnitudes in the bands along the masks' borders; 1: unmoved
    kept:     share of the strongest tenth of the gradients in the bands that is still so after (within 2 px)
    flow:     px, median length of the optical flow from before to after, in the bands
    offset:   px between the shifts of the whole mask that best fit the gradients before and after
    """

    edges: float
    kept: float
    flow: float
    offset: float


def mask_drift(before: Picture, after: Picture, mask: Mask) -> Drift:
    """Measure the drift between an image (H, W, 3) and its translation, given the mask (H, W) of both."""
    band = border_band(mask, BAND)
    if band.sum() < LEAST_BORDER:
        return Drift(np.nan, np.nan, np.nan, np.nan)
    one, other = gradient(before), gradient(after)
    return Drift(
        edges=float(np.corrcoef(one[band], other[band])[0, 1]) if np.ptp(one[band]) and np.ptp(other[band]) else 0.0,
        kept=_kept(one, other, band),
        flow=float(np.median(np.linalg.norm(_flow(before, after)[band], axis=1))),
        offset=float(np.linalg.norm(np.subtract(best_shift(other, mask), best_shift(one, mask)))),
    )


def border_band(mask: Mask, width: int) -> Mask:
    """Band (H, W) of the pixels within `width` px of a border of the mask, excluding the image's own border."""
    inside = np.pad(mask.astype(np.uint8), 1, mode="edge")
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, 3) + cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    if mask.all() or not mask.any():
        return np.zeros_like(mask)
    return np.asarray(depth[1:-1, 1:-1] <= width)


def gradient(picture: Picture) -> NDArray[np.float64]:
    """Gradient magnitude (H, W) of the smoothed L."""
    light = cv2.GaussianBlur(lab(picture)[..., 0].astype(np.float64), (0, 0), BLUR)
    dy, dx = np.gradient(light)
    return np.asarray(np.hypot(dx, dy))


def best_shift(edges: NDArray[np.float64], mask: Mask) -> tuple[int, int]:
    """Shift in rows and columns for which the mask's border lies on the strongest gradients."""
    border = border_band(mask, 1).astype(np.float32)
    border[:REACH] = border[-REACH:] = border[:, :REACH] = border[:, -REACH:] = 0
    found = cv2.matchTemplate(edges.astype(np.float32), border[REACH:-REACH, REACH:-REACH], cv2.TM_CCORR)
    row, column = np.unravel_index(int(found.argmax()), found.shape)
    return int(row) - REACH, int(column) - REACH


def _kept(one: NDArray[np.float64], other: NDArray[np.float64], band: Mask) -> float:
    strong = band & (one >= np.quantile(one[band], 0.9))
    after = band & (other >= np.quantile(other[band], 0.9))
    near = cv2.dilate(after.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return float(near[strong].mean())


def _flow(before: Picture, after: Picture) -> NDArray[np.float32]:
    """Dense optical flow (H, W, 2) px between the images' lightness, with slow changes and contrast removed."""
    grey = [_levelled(picture) for picture in (before, after)]
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    start = np.zeros((*grey[0].shape, 2), dtype=np.float32)
    return np.asarray(method.calc(grey[0], grey[1], start), dtype=np.float32)


def _levelled(picture: Picture) -> NDArray[np.uint8]:
    light = lab(picture)[..., 0]
    slow = cv2.GaussianBlur(light, (0, 0), 16)
    spread = np.sqrt(cv2.GaussianBlur((light - slow) ** 2, (0, 0), 16)) + 0.5
    return np.clip(128 + 40 * (light - slow) / spread, 0, 255).astype(np.uint8)
