"""Corners tracked from frame to frame by optical flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.visual_only.settings import VisualOnlySettings


@dataclass(frozen=True)
class FeatureTracks:
    """Corners of one frame: ids (N,) int64, the same as long as a corner is followed, and pixels (N, 2)."""

    ids: NDArray[np.int64]
    pixels: Array


def follow(
    before: NDArray[np.uint8], after: NDArray[np.uint8], start: Array, guess: Array, settings: VisualOnlySettings
) -> tuple[Array, NDArray[np.bool_]]:
    """Track pixels `start` (N, 2) into another image: pixels (N, 2), and which of them (N,) were found there.

    Pyramidal Lucas-Kanade (Bouguet 2001) from `guess` (N, 2), and back again: a point that does not return is not
    found.
    """
    if len(start) == 0:
        return np.empty((0, 2)), np.zeros(0, dtype=bool)
    options: dict[str, Any] = {
        "winSize": (settings.flow_window_px, settings.flow_window_px),
        "maxLevel": settings.flow_levels,
        "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    }
    origin, first = start.astype(np.float32), guess.astype(np.float32)
    end, found, _ = cv2.calcOpticalFlowPyrLK(before, after, origin, first.copy(), **options)
    home, back, _ = cv2.calcOpticalFlowPyrLK(after, before, end, (end - (first - origin)).copy(), **options)
    height, width = after.shape
    good = (found.ravel() == 1) & (back.ravel() == 1)
    good &= np.linalg.norm(home - origin, axis=1) < settings.backward_error_px
    good &= (end >= 1).all(axis=1) & (end[:, 0] < width - 1) & (end[:, 1] < height - 1)
    return end.astype(np.float64), good


class Tracker:
    """Tracker of corners through the frames of one camera, which finds new ones where there are few."""

    def __init__(self, settings: VisualOnlySettings) -> None:
        self.settings = settings
        self.image: NDArray[np.uint8] | None = None
        self.tracks = FeatureTracks(np.empty(0, dtype=np.int64), np.empty((0, 2)))
        self._clahe = cv2.createCLAHE(settings.clahe_clip, (settings.clahe_tiles, settings.clahe_tiles))
        self._next_id = 0
        self._unusable = 0

    def equalised(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Convert an image (H, W, 3) RGB or (H, W) to grey (H, W) with enhanced contrast."""
        grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        return np.asarray(self._clahe.apply(grey), dtype=np.uint8)

    def add(self, pixels: NDArray[np.uint8]) -> FeatureTracks | None:
        """Track corners into the next frame (H, W, 3) RGB or (H, W) grey, uint8.

        None where too few are found in it: the next frame is then tracked from the last usable one, until patience
        ends and all starts anew.
        """
        settings, image = self.settings, self.equalised(pixels)
        if self.image is not None:
            end, good = follow(self.image, image, self.tracks.pixels, self.tracks.pixels, settings)
            if good.sum() < min(settings.min_followed, len(self.tracks.ids)):
                self._unusable += 1
                if self._unusable <= settings.patience_frames:
                    return None
            self.tracks = FeatureTracks(self.tracks.ids[good], end[good])
        self.image, self._unusable = image, 0
        self._replenish()
        return self.tracks

    def _replenish(self) -> None:
        """Add new corners (Shi & Tomasi 1994), the best of each cell of a grid that has room for more."""
        settings, tracks = self.settings, self.tracks
        assert self.image is not None
        if len(tracks.ids) > 0.8 * settings.max_tracks:
            return
        height, width = self.image.shape
        free = np.full(self.image.shape, 255, dtype=np.uint8)
        for x, y in tracks.pixels:
            cv2.circle(free, (round(x), round(y)), round(settings.corner_spacing_px), 0, -1)
        found = cv2.goodFeaturesToTrack(
            self.image, 4 * settings.max_tracks, settings.corner_quality, settings.corner_spacing_px, mask=free
        )
        if found is None:
            return
        corners = found.reshape(-1, 2).astype(np.float64)  # the best first
        columns, rows = settings.grid
        share = -(-settings.max_tracks // (columns * rows))

        def cells(pixels: Array) -> NDArray[np.int64]:
            x, y = pixels.astype(int).T
            return np.asarray((y * rows // height) * columns + x * columns // width)

        room = share - np.bincount(cells(tracks.pixels), minlength=columns * rows)
        chosen = np.zeros(len(corners), dtype=bool)
        for k, cell in enumerate(cells(corners)):
            chosen[k] = room[cell] > 0
            room[cell] -= 1
        ids = self._next_id + np.arange(chosen.sum(), dtype=np.int64)
        self._next_id += len(ids)
        self.tracks = FeatureTracks(np.append(tracks.ids, ids), np.vstack([tracks.pixels, corners[chosen]]))
