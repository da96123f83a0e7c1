"""What is kept of tracks over their lives: from where each was first seen, and how many each frame loses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.inertial import Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.frontend import homogeneous
from oysterbench_baselines.gtsam_vi.settings import Settings


class TrackBook:
    """Tells which landmark a track shows, and how much tracks are to be trusted.

    A track follows what looks the same from one frame to the next, and a corner of relief goes over into another as it
    is passed: on an orbit over shells, tracks live for a minute and slide over them by tens of pixels, so smoothly that
    no single step gives it away. A track that is seen from another side than at first is therefore another landmark.
    """

    def __init__(self, settings: Settings, R_imu_cam: Array) -> None:
        self._settings, self._R_imu_cam = settings, R_imu_cam
        self._R_start_imu = np.eye(3)
        self._first: dict[int, tuple[int, Array]] = {}  # landmark, and direction of its first ray, by track
        self._count = 0
        self._ids = np.empty(0, dtype=np.int64)  # of the last frame's tracks
        self._kept: list[float] = []  # share of the tracks that each frame since the last key frame left

    def landmarks(self, ids: NDArray[np.int64], rays: Array, segment: Segment, gyro_bias: Array) -> NDArray[np.int64]:
        """Landmarks (N,) of the next frame's tracks, ids (N,) and rays (N, 2); segment: measurements since the last."""
        self._R_start_imu = self._R_start_imu @ relative_rotation(segment, gyro_bias)
        if len(ids) == 0:
            return ids
        if len(self._ids):
            self._kept.append(float(np.isin(self._ids, ids).mean()))
        self._ids = ids
        directions = homogeneous(rays) @ (self._R_start_imu @ self._R_imu_cam).T
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        least = np.cos(np.radians(self._settings.max_turn_deg))
        known, self._first = self._first, {}
        for track, direction in zip(ids.tolist(), directions, strict=True):
            first = known.get(track)
            if first is None or first[1] @ direction < least:
                first, self._count = (self._count, direction), self._count + 1
            self._first[track] = first
        return np.array([self._first[track][0] for track in ids.tolist()], dtype=np.int64)

    def spread(self) -> float:
        """How much less certain than usual the tracks since the last call are: where light moves over the bottom, most
        are lost from frame to frame, and it has moved those that are left."""
        settings, kept = self._settings, max(float(np.mean(self._kept or [1.0])), 1e-3)
        self._kept = []
        return min(kept**-settings.spread_power, settings.max_spread)
