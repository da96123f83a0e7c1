"""The map: keyframes and landmarks of the final smoothing, coloured from the images of the keyframes."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import LandmarkMap
from oysterbench_baselines.gtsam_vi.bundle import Bundle
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.states import Keyframe, read_state

PATCH_PX = 3
"""Side of the patch whose mean is a corner's colour: a corner is an edge, and a single pixel lies on either side."""


@dataclass
class Palette:
    """Colours of tracks: the mean over the keyframes that saw them."""

    _ids: list[NDArray[np.int64]] = field(default_factory=list)
    _colours: list[NDArray[np.uint8]] = field(default_factory=list)

    def add(self, pixels: NDArray[np.uint8], tracks: FeatureTracks) -> None:
        """Add the image of a keyframe, (H, W, 3) RGB or (H, W) grey, and its tracks."""
        mean = cv2.blur(pixels, (PATCH_PX, PATCH_PX))
        columns, rows = np.round(tracks.pixels).astype(np.int64).T
        found = mean[np.clip(rows, 0, mean.shape[0] - 1), np.clip(columns, 0, mean.shape[1] - 1)]
        self._ids.append(tracks.ids)
        self._colours.append(np.repeat(found[:, None], 3, axis=1) if found.ndim == 1 else found)

    def __bool__(self) -> bool:
        return bool(self._ids)

    def of(self, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Colours (N, 3) of tracks (N,), each of which must have been seen."""
        known, row = np.unique(np.concatenate(self._ids), return_inverse=True)
        colours = np.concatenate(self._colours).astype(float)
        count = np.bincount(row)
        mean = np.column_stack([np.bincount(row, colours[:, channel]) / count for channel in range(3)])
        return np.round(mean[np.searchsorted(known, ids)]).astype(np.uint8)


def landmark_map(model: Model, keyframes: list[Keyframe], bundle: Bundle, palette: Palette) -> LandmarkMap:
    """Map of an adjusted stretch: the landmarks that reproject well in as many keyframes as a new landmark needs.

    bundle: of the same keyframes. The map is in its odom, which the smoothed and the online path share: both start at
    the same pose.
    """
    values, settings = bundle.values, model.settings
    poses = np.array([values.atPose3(X(keyframe.index)).matrix() for keyframe in keyframes])
    points = np.array([values.atPoint3(L(int(i))) for i in bundle.landmarks]).reshape(-1, 3)
    rows = [keyframe.observations.rows() for keyframe in keyframes]
    frame = np.repeat(np.arange(len(keyframes)), [len(ids) for ids, _, _ in rows])
    track, rays, camera = (np.concatenate(part) for part in zip(*rows, strict=True))
    own = np.isin(track, bundle.landmarks)
    frame, rays, camera = frame[own], rays[own], camera[own]
    row = np.searchsorted(bundle.landmarks, track[own])
    near = model.rig.errors_px(poses[frame], points[row], rays, camera) < settings.landmarks.max_error_px
    # A second camera's view does not count as another keyframe.
    views = np.unique(np.column_stack([row, frame])[near], axis=0)
    observations = np.bincount(views[:, 0], minlength=len(points))
    kept = observations >= settings.landmarks.min_views
    at_stamps = [model.at_stamp(keyframe, read_state(values, keyframe.index)).matrix for keyframe in keyframes]
    in_base = np.array(at_stamps) @ invert(model.imu.T_base_imu)
    path = Trajectory(
        np.array([keyframe.stamp_ns for keyframe in keyframes], dtype=np.int64),
        in_base[:, :3, 3].copy(),
        Rotation.from_matrix(in_base[:, :3, :3]).as_quat(),
    )
    colours = palette.of(bundle.landmarks[kept])
    return LandmarkMap(path, points[kept], colours, observations[kept].astype(np.int32))
