"""Depth of a view from others at known poses: a plane sweep (Collins, CVPR 1996) with normalised cross-correlation.

Correlation is invariant to gain and offset, so to the veil of turbid water and to a lamp that moves with the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.views import View

Picture = NDArray[np.float32]
PEAK = 3  # planes on each side of the best that belong to its peak
SPECKLE_PX, SPECKLE_PLANES, SUBDIVIDED = 100, 2, 16  # two patches; between connected neighbours; steps of a plane
LIKELY = 1.5  # most depths of an image lie within this factor of their median


@dataclass(frozen=True)
class DepthMap:
    """Depth map of a view. depth: (H, W) float m along the optical axis; NaN where it is not known."""

    view: View
    depth: Array

    def points(self) -> tuple[Array, NDArray[np.uint8]]:
        """Points (N, 3) m in the world frame of the pixels with depth, and their colours (N, 3) uint8."""
        rows, columns = np.nonzero(np.isfinite(self.depth))
        T = self.view.T_world_cam
        points = _rays(self.view, rows, columns) * self.depth[rows, columns, None]
        return points @ T[:3, :3].T + T[:3, 3], self.view.colours[rows, columns]


def sweep(view: View, sources: Sequence[View], settings: CloudSettings) -> DepthMap:
    """Compute the depth of each pixel whose patch matches the sources clearly better at one depth than at any other.

    A pixel has no depth where some likely depth is shown by no source, nor has a small group of pixels whose depth
    differs from those around.
    """
    relative = [invert(source.T_world_cam) @ view.T_world_cam for source in sources]
    base = max(float(np.linalg.norm(T[:3, 3])) for T in relative)
    span = 1.0 / settings.near_m - 1.0 / settings.far_m
    wanted = int(np.ceil(view.matrix[0, 0] * base * span / settings.plane_px)) + 1
    inverse_depths = np.linspace(
        1.0 / settings.far_m, 1.0 / settings.near_m, int(np.clip(wanted, 16, settings.max_planes))
    )

    window = (settings.window_px, settings.window_px)
    size = view.grey.shape[::-1]
    inverse_matrix = np.linalg.inv(view.matrix)
    floor = settings.noise_grey**2
    mean: Any = cv2.blur(view.grey, window)
    deviation = _deviation(view.grey, mean, window, floor)
    own_whole, *others_whole = (_whole_patches(one, settings) for one in (view, *sources))
    scores = np.full((len(inverse_depths), *view.grey.shape), -1.0, dtype=np.float32)
    seen_at = np.zeros(scores.shape, dtype=bool)
    for k, inverse_depth in enumerate(inverse_depths):
        for source, T, whole in zip(sources, relative, others_whole, strict=True):
            plane = T[:3, :3] + np.outer(T[:3, 3], [0.0, 0.0, inverse_depth])
            homography = source.matrix @ plane @ inverse_matrix
            warped: Any = cv2.warpPerspective(
                source.grey, homography, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=0.0
            )
            # Outside an image it is black, and the border would correlate with that of another image.
            seen: Any = cv2.warpPerspective(whole, homography, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
            other_mean: Any = cv2.blur(warped, window)
            covariance: Any = cv2.blur(view.grey * warped, window) - mean * other_mean
            correlation = covariance / (deviation * _deviation(warped, other_mean, window, floor))
            # A point that is occluded from one side is visible from the other: the best source counts.
            np.maximum(scores[k], np.where(seen > 0, correlation, -1.0), out=scores[k])
            seen_at[k] |= seen > 0
    scores[:, own_whole == 0] = -1.0
    depth = _peaks(scores, inverse_depths, settings)
    depth = _without_speckles(depth, inverse_depths)
    # If no source shows a pixel at its true depth, a wrong one wins: it must be shown at all likely depths.
    typical = 1.0 / np.nanmedian(depth) if np.isfinite(depth).any() else inverse_depths[0]
    likely = (inverse_depths > typical / LIKELY) & (inverse_depths < typical * LIKELY)
    return DepthMap(view, np.where(seen_at[likely].all(axis=0), depth, np.nan))


def _whole_patches(view: View, settings: CloudSettings) -> Any:
    """Mask (H, W) uint8, 0 where the patch around a pixel extends beyond what the camera shows."""
    shown = np.ones(view.grey.shape, np.uint8) if view.shown is None else view.shown.astype(np.uint8)
    window = np.ones((settings.window_px, settings.window_px), np.uint8)
    return cv2.erode(shown, window, borderType=cv2.BORDER_CONSTANT, borderValue=0)


def _deviation(grey: Picture, mean: Any, window: tuple[int, int], floor: float) -> Picture:
    """Standard deviation (H, W) of the patch around each pixel, noise of variance `floor` included."""
    return np.asarray(np.sqrt(np.maximum(cv2.blur(grey * grey, window) - mean * mean, 0.0) + floor))


def _peaks(scores: Picture, inverse_depths: Array, settings: CloudSettings) -> Array:
    """Depth (H, W) m at the peaks of scores (planes, H, W), refined by a parabola; NaN where no peak stands out."""
    best = scores.argmax(axis=0)
    at_best = np.take_along_axis(scores, best[None], axis=0)[0]
    inner = np.clip(best, 1, len(scores) - 2)
    low, middle, high = (np.take_along_axis(scores, inner[None] + d, axis=0)[0] for d in (-1, 0, 1))
    bend = low - 2.0 * middle + high
    shift = np.where(bend < 0, 0.5 * (low - high) / np.where(bend < 0, bend, 1.0), 0.0)
    step = inverse_depths[1] - inverse_depths[0]
    depth = 1.0 / (inverse_depths[inner] + np.clip(shift, -0.5, 0.5) * step)
    elsewhere = np.abs(np.arange(len(scores))[:, None, None] - best) > PEAK
    second = np.where(elsewhere, scores, -1.0).max(axis=0)
    good = (at_best > settings.min_correlation) & (at_best - second > settings.min_lead) & (best == inner)
    return np.where(good, depth, np.nan)


def _without_speckles(depth: Array, inverse_depths: Array) -> Array:
    """Set small connected groups of pixels that differ from their surroundings to NaN: false peaks are patch-sized."""
    known = np.isfinite(depth)
    step = inverse_depths[1] - inverse_depths[0]
    planes = np.where(known, (1.0 / np.where(known, depth, 1.0) - inverse_depths[0]) / step, -1.0)
    kept = np.rint(SUBDIVIDED * planes).astype(np.int16)
    cv2.filterSpeckles(kept, -SUBDIVIDED, SPECKLE_PX, SPECKLE_PLANES * SUBDIVIDED)
    return np.where(kept >= 0, depth, np.nan)


def agreeing(depths: DepthMap, others: Sequence[DepthMap], share: float) -> DepthMap:
    """Keep pixels whose points at least one other view sees at the same place, within a share of their distance."""
    rows, columns = np.nonzero(np.isfinite(depths.depth))
    points, _ = depths.points()
    agreed = np.zeros(len(points), dtype=bool)
    for other in others:
        T = invert(other.view.T_world_cam)
        seen = points @ T[:3, :3].T + T[:3, 3]
        front = seen[:, 2] > 1e-3
        pixels = seen @ other.view.matrix.T
        u, v = np.rint(pixels[:, :2] / np.where(front, pixels[:, 2], 1.0)[:, None]).astype(int).T
        height, width = other.depth.shape
        front &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
        there = other.depth[np.where(front, v, 0), np.where(front, u, 0)]
        agreed |= front & (np.abs(there - seen[:, 2]) < share * seen[:, 2])
    kept = np.full_like(depths.depth, np.nan)
    kept[rows[agreed], columns[agreed]] = depths.depth[rows[agreed], columns[agreed]]
    return DepthMap(depths.view, kept)


def _rays(view: View, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    """Rays (N, 3) of pixels, z = 1, in the optical frame."""
    pixels = np.column_stack([columns, rows, np.ones(len(rows))])
    return np.asarray(pixels @ np.linalg.inv(view.matrix).T)
