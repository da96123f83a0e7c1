"""Projection of pixels onto the ground: what a camera sees, as points in the world frame of a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.mapping.settings import MapSettings
from oysterbench.sequence.export.ply import pixel_rays
from oysterbench.sequence.types import CameraCalibration

POINTS = 96  # of an oyster in an image, at most: 5 mm apart on a shell of 80 x 60 mm


@dataclass(frozen=True)
class Seen:
    """The oysters of an image.

    numbers: (H, W) int, k where oyster k is seen, 0 elsewhere; states: "live" or "dead" by number, if known; scores: by
    number, 1 if missing
    """

    stamp_ns: int
    camera: str
    numbers: NDArray[np.integer]
    states: Mapping[int, str] = field(default_factory=dict)
    scores: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Patch:
    """An oyster of one image, projected onto the ground.

    frame, number: which image, and which of its oysters
    points:        (N, 3) m, a sample of its pixels' points; centre: (3,) m, mean of all of them
    pixels:        number of pixels
    area_m2:       area, as if it faced the camera
    cut:           whether the image edge or the maximum distance cuts it
    covariance:    (3, 3) m^2, of the centre: elongated along the ray, as depth is the least certain
    sigma_m:       1 sigma of the points' position, from pose and depth; pose_sigma_m: from the pose alone
    """

    frame: int
    number: int
    points: Array
    centre: Array
    pixels: int
    area_m2: float
    cut: bool
    covariance: Array
    sigma_m: float
    state: str = "unknown"
    score: float = 1.0
    pose_sigma_m: float = 0.0

    def laid(self, move: Array, sigma_m: float) -> Patch:
        """Return the patch after a move (4, 4), with `sigma_m` as 1 sigma of its pose; that of its depth remains."""
        less = self.pose_sigma_m**2 - sigma_m**2
        there = self.placed(move)
        return replace(
            there,
            covariance=there.covariance - less * np.eye(3),
            sigma_m=float(np.sqrt(self.sigma_m**2 - less)),
            pose_sigma_m=sigma_m,
        )

    def placed(self, move: Array) -> Patch:
        """Return the patch after a move (4, 4)."""
        turn, by = move[:3, :3], move[:3, 3]
        return replace(
            self,
            points=self.points @ turn.T + by,
            centre=turn @ self.centre + by,
            covariance=turn @ self.covariance @ turn.T,
        )

    def moved(self, by: Array) -> Patch:
        """Return the patch shifted by a vector (3,) m."""
        return replace(self, points=self.points + by, centre=self.centre + by)


class Lens:
    """Rays of a camera's pixels; NaN where the lens shows nothing."""

    def __init__(self, name: str, camera: CameraCalibration) -> None:
        self.name, self.camera = name, camera
        self.shape = (camera.height, camera.width)
        self.pixel_sr = 1.0 / float(camera.matrix[0, 0] * camera.matrix[1, 1])  # solid angle of a pixel on the axis
        self._rays = pixel_rays(camera)

    @property
    def rays(self) -> Array:
        """Rays (H, W, 3), z = 1, in the optical frame. Raises SequenceError behind a flat port: they do not meet."""
        if self.camera.port_m is not None:
            raise SequenceError(
                f"{self.name} looks through a flat port, so its rays do not meet in one point: expected a camera "
                "calibrated in water"
            )
        return np.concatenate([self._rays[..., :2], np.ones((*self.shape, 1))], axis=-1)

    def points(self, depth_m: Array, T_world_cam: Array) -> Array:
        """Points (H, W, 3) m in the world frame of pixels with depths (H, W) m along the optical axis; NaN stays NaN.

        T_world_cam: (H, 4, 4) for each row, or (1, 4, 4) or (4, 4) for all rows.
        """
        across = self._rays[..., :2] * (depth_m - self._rays[..., 2])[..., None]
        points = np.concatenate([across, depth_m[..., None]], axis=-1)
        return points @ np.swapaxes(T_world_cam[..., :3, :3], -1, -2) + T_world_cam[..., None, :3, 3]


def usable(depth_m: Array, settings: MapSettings) -> NDArray[np.bool_]:
    """Mask (H, W) of the pixels in the usable range of depths; False for NaN."""
    return (depth_m > settings.near_m) & (depth_m < settings.far_m)


def patches(
    frame: int,
    seen: Seen,
    points: Array,
    depth_m: Array,
    eye: Array,
    pixel_sr: float,
    pose_sigma_m: float,
    depth_sigma: float,
    settings: MapSettings,
) -> list[Patch]:
    """Oysters of an image, by number, from the points (H, W, 3) m and depths (H, W) m of its pixels.

    eye: (3,) m, position of the camera; pixel_sr: solid angle of a pixel, sr; pose_sigma_m, depth_sigma: 1 sigma of the
    position, m, and of a depth, relative. Of an oyster that reaches beyond the usable range, only the part within it is
    used, and the oyster counts as cut.
    """
    flat = seen.numbers.ravel()
    rows = np.flatnonzero(flat)
    rows = rows[np.argsort(flat[rows], kind="stable")]
    if not len(rows):
        return []
    numbers, starts = np.unique(flat[rows], return_index=True)
    near = usable(depth_m, settings).ravel()
    border = np.ones(seen.numbers.shape, dtype=bool)
    b = settings.border_px
    border[b:-b, b:-b] = False
    edge, depths, places = border.ravel(), depth_m.ravel(), points.reshape(-1, 3)
    found = []
    for number, pixels in zip(numbers.tolist(), np.split(rows, starts[1:]), strict=True):
        score = float(seen.scores.get(number, 1.0))
        chosen = pixels[near[pixels]]
        if score < settings.threshold or len(chosen) < settings.least_px:
            continue
        some = chosen[np.linspace(0, len(chosen) - 1, min(POINTS, len(chosen))).astype(int)]
        far = float(np.mean(depths[chosen]))
        cut = bool(len(chosen) < len(pixels) or edge[pixels].any())
        centre = places[chosen].mean(axis=0)
        ray = (centre - eye) / np.linalg.norm(centre - eye)
        across = pose_sigma_m**2 + (settings.cut_m if cut else settings.middle_m) ** 2
        found.append(
            Patch(
                frame,
                number,
                places[some],
                centre,
                len(chosen),
                len(chosen) * far**2 * pixel_sr,
                cut,
                across * np.eye(3) + (depth_sigma * far) ** 2 * np.outer(ray, ray),
                float(np.hypot(pose_sigma_m, depth_sigma * far)),
                seen.states.get(number, "unknown"),
                score,
                pose_sigma_m,
            )
        )
    return found
