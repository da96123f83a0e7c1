"""Front end: that of gtsam_vi, with corners chosen by the error that a network expects, and tracked in its maps."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd, follow, spread_out
from oysterbench_baselines.gtsam_vi_learned.model import LearnedMaps, MapModel
from oysterbench_baselines.gtsam_vi_learned.settings import GtsamViLearnedSettings


class LearnedFrontEnd(FrontEnd):
    """Tracker of corners through the frames of one camera, where a network says that they can be tracked.

    Everything else is as in gtsam_vi: veil, uneven contrast and fixed pattern are removed from what the network is
    given, and tracks are checked against the known rotation and translation.
    """

    def __init__(
        self, calibration: CameraCalibration, settings: GtsamViLearnedSettings, model: MapModel, seed: int = 0
    ) -> None:
        super().__init__(calibration, settings.frontend, seed)
        self.model, self.learned = model, settings.learned
        self._seen: list[tuple[NDArray[np.uint8], LearnedMaps]] = []  # the latest two images and their maps

    def maps_of(self, image: NDArray[np.uint8]) -> LearnedMaps:
        """Maps of an equalised image (H, W), computed once."""
        for known, maps in self._seen:
            if known is image:
                return maps
        maps = self.model(image, self.learned.maps)
        self._seen = [*self._seen[-1:], (image, maps)]
        return maps

    def find(
        self, before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: Array, guess: Array, levels: int
    ) -> tuple[Array, NDArray[np.bool_]]:
        first, second = self.maps_of(before), self.maps_of(after)
        if first.maps is not None and second.maps is not None:
            before, after = first.maps, second.maps
        end, good = follow(before, after, pixels, guess, replace(self.settings, flow_levels=levels))
        good[good] = _at(second.error_px, end[good]) < self.learned.max_error_px
        return end, good

    def corners(self, image: NDArray[np.uint8], taken: Array) -> Array:
        error_px = self.maps_of(image).error_px
        score = cv2.cornerMinEigenVal(image, self.settings.corner_block_px) / error_px**self.learned.error_power
        score = np.where(error_px < self.learned.max_error_px, score, 0.0)
        return spread_out(np.asarray(score, dtype=np.float32), taken, self.settings)


def _at(values: NDArray[np.float32], pixels: Array) -> NDArray[np.float32]:
    """Values (N,) of a map (H, W) at the pixels nearest to (N, 2), which all lie within it."""
    x, y = np.round(pixels).astype(int).T
    return np.asarray(values[y, x], dtype=np.float32)
