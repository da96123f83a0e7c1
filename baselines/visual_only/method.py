"""The method: a sequence in, a trajectory out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Estimate
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.visual_only.lens import Lens
from oysterbench_baselines.visual_only.odometry import Frame, MatchRight, Odometry
from oysterbench_baselines.visual_only.settings import VisualOnlySettings
from oysterbench_baselines.visual_only.tracks import FeatureTracks, Tracker, follow
from oysterbench_baselines.visual_only.views import homogeneous


class VisualOnly:
    """Plain visual odometry of one camera, or of a stereo pair where two cameras overlap; no other sensor.

    camera: name of the (left) camera; the first one by default. stereo: False to use one camera in any case.
    """

    name = "visual_only"
    track = "slam"

    def __init__(
        self, camera: str | None = None, stereo: bool = True, settings: VisualOnlySettings | None = None
    ) -> None:
        self.camera = camera
        self.stereo = stereo
        self.settings = settings or VisualOnlySettings()
        self.about = {
            "sensors": ["stereo" if stereo else "mono"],
            "online": False,  # frames before a map get their poses from the one that begins after them
            "code": "baselines/visual_only",
        }

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the frames that could be located; odom is base_link at the first of them."""
        left = self.camera or next(iter(sequence.cameras), "")
        if left not in sequence.cameras:
            which = f" {left!r}; cameras: {', '.join(sequence.cameras) or 'none'}" if left else ""
            raise MethodError(f"visual_only: sequence {sequence.name} has no camera{which}")
        right = overlapping(sequence, left, self.settings) if self.stereo else None
        if right is not None and next(iter(sequence.images(right)), None) is None:
            right = None  # calibrated, but never recorded
        T_base_left = sequence.cameras[left].T_base_cam
        lens, tracker = Lens(sequence.cameras[left]), Tracker(self.settings)
        pair = T_left_right = None
        if right is not None:
            T_left_right = invert(T_base_left) @ sequence.cameras[right].T_base_cam
            pair = Pair(lens, Lens(sequence.cameras[right]), T_left_right, self.settings)
        odometry = Odometry(self.settings, lens.focal_px, T_left_right)
        frames = 0
        for image, other in frames_of(sequence, left, right, self.settings):
            frames += 1
            tracks = tracker.add(image.pixels)
            if tracks is None:
                continue
            frame = Frame(image.stamp_ns, tracks.ids, lens.rays(tracks.pixels))
            match = None if pair is None or other is None else pair.matcher(tracker, tracks, other.pixels)
            odometry.add(frame, match)
        if len(odometry.poses) < 2:
            raise MethodError(
                f"visual_only: no map could be begun in {frames} frames of {left}: too few corners, or no motion"
            )
        info: dict[str, Any] = {
            "cameras": [left] if right is None else [left, right],
            "scale": "of the stereo base" if right else "none: the median depth at the start is taken as known",
            "frames": frames,
            "located": len(odometry.poses),
            "maps": odometry.maps,
            "lost_at_ns": odometry.lost_ns,
            "settings": dataclasses.asdict(self.settings),
        }
        return Estimate(poses_of_base(odometry.poses, T_base_left), info)


def poses_of_base(poses: dict[int, Array], T_base_cam: Array) -> Trajectory:
    """T_odom_base from T_map_cam by stamp, ns. odom: base_link at the first of them.

    T_base_cam is kept with them: without a second camera the map has no scale, and the lever arm has one.
    """
    T_map_base = np.array(list(poses.values())) @ invert(T_base_cam)
    T_odom_base = invert(T_map_base[0]) @ T_map_base
    quaternions = Rotation.from_matrix(T_odom_base[:, :3, :3]).as_quat()
    stamps_ns = np.array(list(poses), dtype=np.int64)
    return Trajectory(stamps_ns, T_odom_base[:, :3, 3].copy(), quaternions, T_body_estimate=T_base_cam)


def overlapping(sequence: Sequence, left: str, settings: VisualOnlySettings) -> str | None:
    """Name of a camera beside `left`, with pictures of the same size, that sees much of what `left` sees; None if
    there is none."""
    first = sequence.cameras[left]
    T_base_left = first.T_base_cam
    for name, camera in sequence.cameras.items():
        T_left_other = invert(T_base_left) @ camera.T_base_cam
        angle = np.degrees(np.arccos(np.clip(T_left_other[2, 2], -1, 1)))
        base = float(np.linalg.norm(T_left_other[:3, 3]))
        beside = name != left and 0.01 < base < settings.max_base_m and angle < settings.max_axes_angle_deg
        if beside and (camera.width, camera.height) == (first.width, first.height):
            return name
    return None


def frames_of(
    sequence: Sequence, left: str, right: str | None, settings: VisualOnlySettings
) -> Iterator[tuple[Image, Image | None]]:
    """Yield the frames of `left` in time order, each with that of `right` at its stamp where there is one."""
    if right is None:
        yield from ((image, None) for image in sequence.images(left))
        return
    others = sequence.images(right)
    other = next(others, None)
    tolerance = settings.max_stamp_difference_s * 1e9
    for image in sequence.images(left):
        while other is not None and other.stamp_ns < image.stamp_ns - tolerance:
            other = next(others, None)
        together = other is not None and other.stamp_ns <= image.stamp_ns + tolerance
        yield image, other if together else None


class Pair:
    """Search for the corners of the left image in the right one."""

    def __init__(self, left: Lens, right: Lens, T_left_right: Array, settings: VisualOnlySettings) -> None:
        self.left, self.right, self.settings = left, right, settings
        self.T_right_left = invert(T_left_right)

    def matcher(self, tracker: Tracker, tracks: FeatureTracks, pixels: NDArray[np.uint8]) -> MatchRight:
        """Return a matcher of the frame that the tracker has just taken and the right image (H, W, 3) of its stamp."""
        left_image = tracker.image
        assert left_image is not None

        def match(depth_m: float | None) -> tuple[NDArray[np.int64], Array]:
            right_image = tracker.equalised(pixels)
            depths = self.settings.stereo_depths_m if depth_m is None else (depth_m,)
            best: tuple[NDArray[np.int64], Array] = (tracks.ids[:0], np.empty((0, 2)))
            for depth in depths:
                guess = self.right.pixels(self._seen_from_right(self.left.rays(tracks.pixels), depth))
                end, good = follow(left_image, right_image, tracks.pixels, guess, self.settings)
                if good.sum() > len(best[0]):
                    best = tracks.ids[good], self.right.rays(end[good])
            return best

        return match

    def _seen_from_right(self, rays: Array, depth_m: float) -> Array:
        """Rays (N, 2) of the right camera to points along rays (N, 2) of the left one, at a depth along its axis."""
        points = depth_m * homogeneous(rays) @ self.T_right_left[:3, :3].T + self.T_right_left[:3, 3]
        return points[:, :2] / points[:, 2:]
