"""Depth of each pixel of an image: from images, from echoes, or from the ground truth of a rendered sequence."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.echoes import range_echoes
from oysterbench.mapping.projection import Lens
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.sweep import DepthMap, sweep
from oysterbench.mapping.views import Pinhole, PoseInterpolator, partner, shown_at, without_repeats
from oysterbench.sequence.types import Sequence

DEPTHS = ("stereo", "motion", "plane", "layer")
"""Sources of depth: a stereo pair, the motion of one camera, a plane fitted to the bottom under DVL and altimeters, or
the true depth of a rendered sequence."""

SIGMA = {"stereo": 0.015, "motion": 0.02, "plane": 0.08, "layer": 0.001}
"""1 sigma of each source, relative to the distance: a quarter of a pixel for a baseline of 12 cm; the same, and pose
errors; relief of a decimetre; millimetres in the file."""

DepthOf = Callable[[int, int], Array | None]
"""Stamps, ns, of an image and of the one that it repeats (usually itself) -> depth of its pixels along the optical
axis, (H, W) float m, NaN where unknown; None if there is no depth at all."""

FILL_PX = (1.5, 6.0, 24.0)  # sigmas at 320 columns, over which depths are extended to pixels without depth
FEWEST_OF_PLANE = 100  # pixels
LEAST_KNOWN = 0.02  # share of an image that must have its own depth for the rest to be filled in
SHARE = 0.16  # baseline of the first and last of three images, as a share of the distance
WINDOW_S = 2.0  # before and after an image, in which the other two are searched for
FIRST_DISTANCE_M = 1.2
LEVEL_SLOPE = 0.15  # 1 sigma of the bottom's slope: echoes along a line do not determine the slope across it
ECHO_SIGMA_M = 0.05  # 1 sigma of an echo relative to the plane


def default_depth(sequence: Sequence, camera: str) -> str:
    """Return the default source of depth: stereo if the camera has a partner, else motion."""
    return "stereo" if partner(sequence, camera, CloudSettings()) is not None else "motion"


def depth_source(
    kind: str, sequence: Sequence, camera: str, lens: Lens, poses: PoseInterpolator, settings: MapSettings
) -> DepthOf:
    """Return a source of depth for a camera's images. Raises SequenceError where the sequence lacks what it needs."""
    makers: dict[str, Callable[[], DepthOf]] = {
        "stereo": lambda: _Pictures(sequence, camera, lens, poses, pair=True).at,
        "motion": lambda: _Pictures(sequence, camera, lens, poses, pair=False).at,
        "plane": lambda: _Plane(sequence, camera, lens, poses, settings).at,
        "layer": lambda: _layer(sequence, camera),
    }
    if kind not in makers:
        raise SequenceError(f"depth: expected one of {', '.join(DEPTHS)}, got {kind!r}")
    return makers[kind]()


def _layer(sequence: Sequence, camera: str) -> DepthOf:
    if f"/{camera}/depth" not in {topic for topic, _, _ in sequence.contents()}:
        raise SequenceError(
            f"{sequence.name}: {camera} has no layer depth: expected a depth from images or echoes, --depth stereo, "
            "motion or plane"
        )

    def at(stamp_ns: int, _first_ns: int) -> Array | None:
        found = next(iter(sequence.layer(camera, "depth", stamp_ns, stamp_ns + 1)), None)
        return None if found is None else np.where(found.pixels > 0, found.pixels, np.nan).astype(float)

    return at


class _Pictures:
    """Depth from plane sweeps between images (`mapping.sweep`), extended over untextured areas."""

    def __init__(self, sequence: Sequence, camera: str, lens: Lens, poses: PoseInterpolator, pair: bool) -> None:
        self.settings = CloudSettings()
        self.sequence, self.camera, self.poses = sequence, camera, poses
        self.other = partner(sequence, camera, self.settings) if pair else None
        if pair and self.other is None:
            raise SequenceError(
                f"{sequence.name}: no other camera overlaps with {camera}: expected a pair for --depth stereo; "
                "--depth motion uses one camera, --depth plane echoes"
            )
        self.calibration = sequence.cameras[camera]
        self.pinhole = Pinhole(camera, self.calibration, self.settings.width_px)
        self.second = None
        if self.other is not None:
            self.second = Pinhole(self.other, sequence.cameras[self.other], self.settings.width_px)
        self.distance_m = FIRST_DISTANCE_M
        pixels = lens.rays @ self.pinhole.matrix.T
        self._maps: tuple[Any, Any] = pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32)

    def at(self, _stamp_ns: int, first_ns: int) -> Array | None:
        found = self._pair(first_ns) if self.other is not None else self._motion(first_ns)
        if found is None or np.isfinite(found.depth).mean() < LEAST_KNOWN:
            return None
        self.distance_m = float(np.nanmedian(found.depth))
        dense: Any = 1.0 / carried_on(found.depth)
        inverse: Any = cv2.remap(dense, self._maps[0], self._maps[1], cv2.INTER_LINEAR, borderValue=math.nan)
        return np.asarray(1.0 / inverse, dtype=float)

    def _pair(self, stamp_ns: int) -> DepthMap | None:
        assert self.other is not None
        assert self.second is not None
        T = self.poses.taking(self.calibration, stamp_ns)
        slack = round(self.settings.pair_tolerance_s * 1e9)
        own = next(iter(self.sequence.images(self.camera, stamp_ns, stamp_ns + 1)), None)
        other = next(iter(self.sequence.images(self.other, stamp_ns - slack, stamp_ns + slack + 1)), None)
        if T is None or own is None or other is None:
            return None
        found = shown_at(self.sequence, self.other, other.stamp_ns)
        if found is None or found[1] != other.stamp_ns:
            return None  # not a true pair: the other camera repeats an earlier image
        return sweep(self.pinhole.view(own, T), [self.second.view(other, T)], self.settings)

    def _motion(self, stamp_ns: int) -> DepthMap | None:
        """Sweep an image against the two taken half of the wanted baseline before and after it."""
        T = self.poses.taking(self.calibration, stamp_ns)
        window = round(WINDOW_S * 1e9)
        views = []
        for image in without_repeats(self.sequence.images(self.camera, stamp_ns - window, stamp_ns + window + 1)):
            pose = self.poses.taking(self.calibration, image.stamp_ns)
            if pose is not None:
                views.append((image, pose))
        own = next((image for image, _ in views if image.stamp_ns == stamp_ns), None)
        if T is None or own is None:
            return None
        place = (T @ self.pinhole.T_base_cam)[:3, 3]
        wanted = 0.5 * SHARE * self.distance_m
        sources = []
        for side in (-1, 1):
            apart = [
                (abs(float(np.linalg.norm((pose @ self.pinhole.T_base_cam)[:3, 3] - place)) - wanted), image, pose)
                for image, pose in views
                if side * (image.stamp_ns - stamp_ns) > 0
            ]
            near = min(apart, key=lambda row: row[0], default=None)
            if near is not None and near[0] < 0.7 * wanted:
                sources.append(self.pinhole.view(near[1], near[2]))
        return sweep(self.pinhole.view(own, T), sources, self.settings) if sources else None


def carried_on(depth_m: Array) -> Array:
    """Fill in depths (H, W) m: unknown ones come from the depths around them, within FILL_PX; NaN beyond.

    Works on inverse depths, which are linear over the image for a plane: a plane is fitted to the image, and the mean
    residual of the depths around a pixel (normalised convolution, Knutsson & Westin 1993) is added to it, each at the
    smallest scale with enough known depths.
    """
    known = np.isfinite(depth_m)
    exact = np.where(known, 1.0 / np.where(known, depth_m, 1.0), np.nan)
    plane = _plane_of(exact)
    above = np.where(known, exact - plane, 0.0).astype(np.float32)
    weights = known.astype(np.float32)
    found = exact.copy()
    for sigma in FILL_PX:
        missing = np.isnan(found)
        if not missing.any():
            break
        sums: Any = cv2.GaussianBlur(above, (0, 0), sigma)
        shares: Any = cv2.GaussianBlur(weights, (0, 0), sigma)
        enough = missing & (shares > 0.05)
        found[enough] = plane[enough] + sums[enough] / shares[enough]
    return np.asarray(1.0 / np.where(found > 0.0, found, np.nan), dtype=float)


def _plane_of(values: Array) -> Array:
    """Robustly fit a plane (H, W) to values (H, W), NaN where unknown; with too few values, return their mean."""
    rows, columns = np.nonzero(np.isfinite(values))
    given = values[rows, columns]
    if len(given) < FEWEST_OF_PLANE:
        return np.full(values.shape, given.mean() if len(given) else 0.0)
    design = np.column_stack([columns, rows, np.ones(len(rows))])
    weights = np.ones(len(given))
    for _ in range(4):
        solution = np.linalg.lstsq(design * weights[:, None], given * weights, rcond=None)[0]
        off = np.abs(given - design @ solution)
        weights = 1.0 / np.sqrt(1.0 + (off / max(float(np.median(off)), 1e-9)) ** 2)
    over_columns, over_rows, constant = solution
    height, width = values.shape
    return np.asarray(over_columns * np.arange(width) + over_rows * np.arange(height)[:, None] + constant)


class _Plane:
    """Depth from the bottom as a plane, fitted to the echoes of DVL and altimeters around the time of an image."""

    def __init__(
        self, sequence: Sequence, camera: str, lens: Lens, poses: PoseInterpolator, settings: MapSettings
    ) -> None:
        if sequence.dvl_calibration is None and not sequence.altimeters:
            raise SequenceError(
                f"{sequence.name} has neither DVL nor altimeter: expected one of them for --depth plane; --depth "
                "stereo and motion take images"
            )
        self.rays, self.poses, self.window_ns = lens.rays, poses, settings.plane_s * 1e9
        self.calibration = sequence.cameras[camera]
        stamps, places = [], []
        for stamp_ns, points, T_base_sensor in range_echoes(sequence):
            T = poses.at(stamp_ns)
            if T is not None and len(points):
                T = T @ T_base_sensor
                stamps += [stamp_ns] * len(points)
                places.append(points @ T[:3, :3].T + T[:3, 3])
        self.stamps = np.array(stamps, dtype=np.int64)
        self.places = np.concatenate([np.zeros((0, 3)), *places])

    def at(self, _stamp_ns: int, first_ns: int) -> Array | None:
        T_world_cam = self.poses.of_rows(self.calibration, first_ns)
        near = self.places[np.abs(self.stamps - self.calibration.taken_ns(first_ns)) <= self.window_ns]
        if T_world_cam is None or len(near) < 3:
            return None
        slope_x, slope_y, height = fit_plane(near)
        normal = np.array([-slope_x, -slope_y, 1.0])
        normals = np.swapaxes(T_world_cam[:, :3, :3], -1, -2) @ normal  # in the optical frame of each row
        along = (self.rays * normals[:, None]).sum(axis=-1)
        above = (T_world_cam[:, :3, 3] @ normal - height)[:, None]
        meets = above * along < 0
        return np.where(meets, -above / np.where(meets, along, 1.0), np.nan)


def fit_plane(points: Array) -> tuple[float, float, float]:
    """Fit z = a x + b y + c to points (N, 3) m, robustly (Huber), level where they leave the slope open: a, b, c."""
    middle = points[:, :2].mean(axis=0)
    design = np.column_stack([points[:, :2] - middle, np.ones(len(points))])
    prior = np.diag([LEVEL_SLOPE**-2, LEVEL_SLOPE**-2, 0.0])
    weights: Array = np.ones(len(points))
    solution: Array = np.zeros(3)
    for _ in range(5):
        normal = design.T @ (design * weights[:, None]) / ECHO_SIGMA_M**2 + prior
        right = design.T @ (weights * points[:, 2]) / ECHO_SIGMA_M**2
        solution = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        residuals = np.abs(points[:, 2] - design @ solution) / ECHO_SIGMA_M
        weights = np.asarray(np.minimum(1.0, 1.345 / np.maximum(residuals, 1e-9)), dtype=np.float64)
    a, b, c = solution
    return float(a), float(b), float(c - a * middle[0] - b * middle[1])
