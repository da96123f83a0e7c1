"""A second camera: which one, frames that were taken together, and the tracked corners found in its image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import Image
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, distort, follow, undistort
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings, StereoSettings

EARLY_FRAMES = 100
"""Frames of both cameras after which there must have been a pair."""
LEAST_SHARE = 0.1
"""Share of the frames that must be in pairs, of the camera that has fewer of them."""


def second_camera(sequence: Sequence, first: str, settings: StereoSettings) -> str | None:
    """Name of a camera beside the first that looks in the same direction and has pictures of the same size; None if
    there is none."""
    one = sequence.cameras[first]
    T_first_base = invert(one.T_base_cam)
    for name, camera in sequence.cameras.items():
        T_first_second = T_first_base @ camera.T_base_cam
        angle = np.degrees(np.arccos(np.clip(T_first_second[2, 2], -1, 1)))
        base = float(np.linalg.norm(T_first_second[:3, 3]))
        beside = name != first and settings.min_baseline_m < base and angle < settings.max_angle_deg
        if beside and (camera.width, camera.height) == (one.width, one.height):
            return name
    return None


def pairs(stream: Iterator[Any], first: str, second: str | None, tolerance_s: float) -> Iterator[Any]:
    """Yield the stream, with each frame of the first camera paired with that of the second taken with it, or None.

    Raises MethodError where hardly any frame has one: one camera would do the work of two unnoticed.
    """
    if second is None:
        yield from _paired(stream, first, None, tolerance_s)
        return
    stamps_ns: dict[str, list[int]] = {first: [], second: []}
    found = 0
    for item in _paired(_noted(stream, stamps_ns), first, second, tolerance_s):
        found += isinstance(item, tuple) and item[1] is not None
        if not found and min(map(len, stamps_ns.values())) == EARLY_FRAMES:
            raise MethodError(_apart(stamps_ns, 0, tolerance_s))
        yield item
    if stamps_ns[first] and found <= LEAST_SHARE * min(map(len, stamps_ns.values())):
        raise MethodError(_apart(stamps_ns, found, tolerance_s))


def _noted(stream: Iterator[Any], stamps_ns: dict[str, list[int]]) -> Iterator[Any]:
    for item in stream:
        if isinstance(item, Image):
            stamps_ns[item.camera].append(item.stamp_ns)
        yield item


def _apart(stamps_ns: dict[str, list[int]], found: int, tolerance_s: float) -> str:
    """Say how far apart in time the frames of two cameras are, of which only `found` make a pair."""
    first, second = stamps_ns
    if not stamps_ns[second]:
        return f"camera {second!r} has no frames to pair with those of {first!r}: run gtsam_vi, with one camera"
    rare, frequent = (np.array(stamps) for stamps in sorted(stamps_ns.values(), key=len))
    apart_ms = np.abs(rare[:, None] - frequent[_neighbours(frequent, rare)]).min(axis=1) * 1e-6
    return (
        f"of {len(rare)} frames of {first!r} and {second!r}, {found} were taken within {1e3 * tolerance_s:g} ms of "
        f"each other: the nearest stamps differ by {apart_ms.min():.3g} ms at least, {np.median(apart_ms):.3g} ms in "
        "the median; correct the stamps, give --set stereo.sync_s=SECONDS if the images are taken together all the "
        "same, or run gtsam_vi, with one camera"
    )


def _neighbours(frequent: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices (N, 2) of the stamps before and after each of N stamps."""
    after = np.searchsorted(frequent, stamps)
    return np.clip(np.stack([after - 1, after], axis=1), 0, len(frequent) - 1)


def _paired(stream: Iterator[Any], first: str, second: str | None, tolerance_s: float) -> Iterator[Any]:
    waiting: Image | None = None  # of the first camera
    other: Image | None = None  # the latest of the second
    tolerance = tolerance_s * 1e9
    for item in stream:
        if waiting is not None and item.stamp_ns - waiting.stamp_ns > tolerance:
            yield waiting, None
            waiting = None
        if not isinstance(item, Image):
            yield item
        elif item.camera == first:
            if waiting is not None:  # two of the first camera within the tolerance
                yield waiting, None
            if second is None or (other is not None and item.stamp_ns - other.stamp_ns <= tolerance):
                yield item, other
                waiting = None
            else:
                waiting = item
        elif waiting is not None:
            yield waiting, item
            waiting = None
        else:
            other = item
    if waiting is not None:
        yield waiting, None


class StereoMatcher:
    """Search for the corners of the first camera's image in that of the second.

    Lucas-Kanade, started where the corner would be at the depth it had in the last pair or, for a new one, on the plane
    fitted to those depths: a reef is flat to first order, and inverse depth is linear over the image of a plane.
    """

    def __init__(self, first: CameraCalibration, second: CameraCalibration, settings: GtsamViSettings) -> None:
        self.second = second
        self.settings = settings
        self._T_second_first = invert(second.T_base_cam) @ first.T_base_cam
        self._focal = float(second.matrix[0, 0] + second.matrix[1, 1]) / 2
        self._known: dict[int, float] = {}  # inverse depth, 1/m, of tracks in the last pair
        self._plane: Array | None = None  # inverse depth = plane @ (x, y, 1), of the last pair

    def match(self, first: NDArray[np.uint8], second: NDArray[np.uint8], tracks: FeatureTracks) -> Array:
        """Rays (N, 2) of the second camera at depth 1 to the tracks; NaN where it does not see them.

        first, second (H, W): both images as equalised by the front end.
        """
        found = np.full((len(tracks.ids), 2), np.nan)
        if len(tracks.ids) == 0:
            return found
        best, inverse = np.zeros(len(tracks.ids), dtype=bool), np.zeros(len(tracks.ids))
        for guess in self._guesses(tracks):
            end, good = follow(first, second, tracks.pixels, self._project(tracks.rays, guess), self.settings.frontend)
            rays = undistort(end, self.second)
            depths, error = self._triangulate(tracks.rays, rays)
            good &= error < self.settings.stereo.epipolar_error_px
            good &= (depths > 1 / self.settings.landmarks.max_depth_m) & (
                depths < 1 / self.settings.landmarks.min_depth_m
            )
            if good.sum() > best.sum():
                best, inverse = good, depths
                found[:] = np.nan
                found[good] = rays[good]
        self._known = dict(zip(tracks.ids[best].tolist(), inverse[best].tolist(), strict=True))
        self._plane = _fit_plane(tracks.rays[best], inverse[best])
        return found

    def _guesses(self, tracks: FeatureTracks) -> list[Array]:
        """Inverse depths (N,) to start from: one set once there is a plane, several while there is none."""
        if self._plane is None:
            return [np.full(len(tracks.ids), 1 / depth) for depth in self.settings.stereo.depths_m]
        limits = 1 / self.settings.landmarks.max_depth_m, 1 / (2 * self.settings.landmarks.min_depth_m)
        on_plane = np.clip(homogeneous(tracks.rays) @ self._plane, *limits)
        return [np.array([self._known.get(int(i), p) for i, p in zip(tracks.ids, on_plane, strict=True)])]

    def _project(self, rays: Array, inverse: Array) -> Array:
        """Pixels (N, 2) in the second camera of rays (N, 2) of the first at inverse depths (N,)."""
        seen = homogeneous(rays) @ self._T_second_first[:3, :3].T + inverse[:, None] * self._T_second_first[:3, 3]
        return distort(seen[:, :2] / np.maximum(seen[:, 2:], 0.1), self.second)

    def _triangulate(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Inverse depths (N,) along rays of the first camera, and distances (N,) px from their epipolar lines."""
        turned = homogeneous(first) @ self._T_second_first[:3, :3].T
        base = self._T_second_first[:3, 3]
        # (turned + inverse base) projects to `second`: two equations, linear in the inverse depth.
        slope = base[:2] - second * base[2]
        offset = second * turned[:, 2:] - turned[:, :2]
        length = np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-18)
        inverse = np.einsum("ni,ni->n", slope, offset) / length
        away = offset[:, 0] * slope[:, 1] - offset[:, 1] * slope[:, 0]
        depth = np.maximum(turned[:, 2] + inverse * base[2], 1e-6)
        return inverse, np.abs(away) / np.sqrt(length) / depth * self._focal


def _fit_plane(rays: Array, inverse: Array) -> Array | None:
    """Plane (3,), inverse depth = plane @ (x, y, 1), by least squares without the worst fifth; None if too few."""
    if len(rays) < 10:
        return None
    places = homogeneous(rays)
    plane = np.linalg.lstsq(places, inverse, rcond=None)[0]
    error = np.abs(places @ plane - inverse)
    kept = error <= np.quantile(error, 0.8)
    return np.asarray(np.linalg.lstsq(places[kept], inverse[kept], rcond=None)[0], dtype=float)
