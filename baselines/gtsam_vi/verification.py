"""Whether two places are the same: a rigid, level alignment of their corners, then their landmarks found again."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.core.streams import stream
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import follow, undistort
from oysterbench_baselines.gtsam_vi.places import Place, heading_of, heading_pose, nodes, project, upsample, warp
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings


def match(first: NDArray[np.uint8], second: NDArray[np.uint8], settings: GtsamViSettings) -> NDArray[np.int64]:
    """Match descriptors (N, 32), (N', 32): index pairs (M, 2) of nearest ones, by the ratio test (Lowe 2004)."""
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), dtype=np.int64)
    pairs = []
    for best, other in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(second, first, k=2):
        if best.distance <= settings.loops.match_bits and best.distance < settings.loops.match_ratio * other.distance:
            pairs.append((best.trainIdx, best.queryIdx))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def align(
    first: Array, second: Array, tolerance: float, trials: int, generator: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """T_first_second (4, 4), level, and which of the pairs of points (M, 3), (M, 3) in level frames agree with it.

    RANSAC over heading and position: two pairs determine them, if their horizontal distances agree.
    """
    n = len(first)
    nothing = np.eye(4), np.zeros(n, dtype=bool)
    if n < 3:
        return nothing
    a, b = generator.integers(0, n, size=(2, trials))
    there, here = first[b] - first[a], second[b] - second[a]
    span, length = np.linalg.norm(there[:, :2], axis=1), np.linalg.norm(here[:, :2], axis=1)
    fits = (np.minimum(span, length) > 3 * tolerance) & (np.abs(span - length) < 2 * tolerance)
    fits &= np.abs(there[:, 2] - here[:, 2]) < 2 * tolerance
    if not fits.any():
        return nothing
    a, there, here = a[fits], there[fits], here[fits]
    heading = np.arctan2(there[:, 1], there[:, 0]) - np.arctan2(here[:, 1], here[:, 0])
    c, s = np.cos(heading), np.sin(heading)
    x = c[:, None] * second[None, :, 0] - s[:, None] * second[None, :, 1]
    y = s[:, None] * second[None, :, 0] + c[:, None] * second[None, :, 1]
    rows = np.arange(len(a))
    dx = (first[:, 0] - x) - (first[a, 0] - x[rows, a])[:, None]
    dy = (first[:, 1] - y) - (first[a, 1] - y[rows, a])[:, None]
    dz = (first[:, 2] - second[:, 2]) - (first[a, 2] - second[a, 2])[:, None]
    inliers = dx**2 + dy**2 + dz**2 < tolerance**2
    chosen = inliers[int(np.argmax(inliers.sum(axis=1)))]
    for _ in range(2):
        T = _fit(first[chosen], second[chosen])
        left = first - second @ T[:3, :3].T - T[:3, 3]
        chosen = np.linalg.norm(left, axis=1) < tolerance
        if chosen.sum() < 2:
            return nothing
    return T, chosen


def _fit(first: Array, second: Array) -> Array:
    """Least-squares level pose T_first_second that takes points `second` (M, 3) onto `first` (M, 3)."""
    p, q = first - first.mean(axis=0), second - second.mean(axis=0)
    heading = np.arctan2(np.sum(q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]), np.sum(q[:, :2] * p[:, :2]))
    T = heading_pose(float(heading), np.zeros(3))
    T[:3, 3] = first.mean(axis=0) - T[:3, :3] @ second.mean(axis=0)
    return T


def reprojection(parameters: Array, points: Array, rays: Array, T_level_cam: Array) -> tuple[Array, Array]:
    """Residuals (M, 2) of rays at depth 1, and their derivatives (M, 2, 4) by heading and position.

    parameters (4,): heading (rad) and position (m) of the second level frame in the first; points (M, 3) in the first,
    seen along rays (M, 2) by a camera at T_level_cam in the second.
    """
    T_first_second = heading_pose(parameters[0], parameters[1:])
    there = (points - parameters[1:]) @ T_first_second[:3, :3]
    T = invert(T_level_cam)
    local = there @ T[:3, :3].T + T[:3, 3]
    depth = np.maximum(local[:, 2], 0.05)
    seen = local[:, :2] / depth[:, None]
    turned = np.column_stack([there[:, 1], -there[:, 0], np.zeros(len(there))])
    moved = np.empty((len(points), 3, 4))
    moved[:, :, 0] = turned @ T[:3, :3].T
    moved[:, :, 1:] = -T[:3, :3] @ T_first_second[:3, :3].T
    jacobian = (moved[:, :2] - seen[:, :, None] * moved[:, 2:]) / depth[:, None, None]
    return seen - rays, jacobian


def refine(
    T_first_second: Array, points: Array, rays: Array, T_level_cam: Array, sigma: float, gate: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Refine the pose that sees points along rays: T_first_second (4, 4), covariance (4, 4) and inliers (M,).

    Iteratively reweighted least squares: Cauchy weights at `sigma`, wider at first; then only points within `gate`.
    """
    x = np.concatenate([[heading_of(T_first_second)], T_first_second[:3, 3]])
    inliers = np.ones(len(points), dtype=bool)
    for k in range(12):
        residual, jacobian = reprojection(x, points, rays, T_level_cam)
        error = np.linalg.norm(residual, axis=1)
        scale = max(sigma, (8.0, 4.0, 2.0)[k] * sigma if k < 3 else 0.0)
        weight = 1.0 / (1.0 + (error / scale) ** 2)
        if k >= 8:
            inliers = error < gate
            weight = inliers.astype(float)
        information = np.einsum("mia,m,mib->ab", jacobian, weight, jacobian) + np.diag([1e-9] * 4)
        x = x - np.linalg.solve(information, np.einsum("mia,m,mi->a", jacobian, weight, residual))
    residual, _ = reprojection(x, points, rays, T_level_cam)
    inliers = np.linalg.norm(residual, axis=1) < gate
    return heading_pose(x[0], x[1:]), np.linalg.inv(information) * sigma**2, inliers


class Verifier:
    """Verification that two places are the same."""

    def __init__(self, calibration: CameraCalibration, settings: GtsamViSettings) -> None:
        self.calibration = calibration
        self.settings = settings
        self.focal = float(calibration.matrix[0, 0] + calibration.matrix[1, 1]) / 2
        x, y = nodes(calibration.height, calibration.width)
        self._nodes = x.shape
        self._node_rays = undistort(np.column_stack([x.ravel(), y.ravel()]), calibration)
        self._generator = stream(0, b"", "gtsam_vi", "loops")

    def align(self, first: Place, second: Place) -> tuple[Array, int]:
        """T_first_second (4, 4) from the corners of both ground views, and how many of them agree with it."""
        settings = self.settings
        pairs = match(first.descriptors, second.descriptors, settings)
        there, here = first.corners[pairs[:, 0]], second.corners[pairs[:, 1]]
        depth = np.median(np.linalg.norm(second.points - second.T_level_cam[:3, 3], axis=1))
        T, inliers = align(
            there, here, settings.loops.align_share * depth, settings.loops.align_trials, self._generator
        )
        return T, int(inliers.sum())

    def confirm(
        self, first: Place, second: Place, T: Array, picture: NDArray[np.uint8]
    ) -> tuple[Array, Array, NDArray[np.int64], Array, Array] | None:
        """T_first_second and covariance; indices of the first's landmarks that were found in the second image, with
        their pixels and rays. None if they do not confirm the alignment `T`."""
        settings = self.settings
        sigma = settings.loops.pixel_sigma_px / self.focal
        there = first.pixels
        for _ in range(2):  # the second time from the result of the first
            expected, index, found = self.track(first, there, second, T, picture)
            if len(index) < settings.loops.min_inliers:
                return None
            rays = undistort(found, self.calibration)
            before = T
            T, covariance, inliers = refine(T, first.points[index], rays, second.T_level_cam, sigma, 3 * sigma)
            if inliers.sum() >= settings.loops.min_share * len(expected) and _near(before, T, settings.loops.retry_m):
                break
        index, found, rays = index[inliers], found[inliers], rays[inliers]
        if len(index) < max(settings.loops.min_inliers, settings.loops.min_share * len(expected)):
            return None
        spread = np.sqrt(np.linalg.eigvalsh(np.cov(found.T))[0]) if len(found) > 2 else 0.0
        if spread < settings.loops.min_spread * self.calibration.height:
            return None
        return T, covariance, index, found, rays

    def track(
        self, first: Place, there: NDArray[np.uint8], second: Place, T: Array, picture: NDArray[np.uint8]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Landmarks of the first place that should be in the second's image, and those found in it with pixels.

        The first image (H, W) is projected onto the ground and seen from the second camera; what remains for
        Lucas-Kanade is the relief and the error of the alignment.
        """
        settings, calibration = self.settings, self.calibration
        width, height = calibration.width, calibration.height
        T_first_cam = T @ second.T_level_cam
        goal, depth = project(first.points, T_first_cam, calibration)
        border = settings.frontend.flow_window_px
        inside = (depth > settings.landmarks.min_depth_m) & (goal > border).all(axis=1)
        inside &= (goal < np.array([width - border, height - border])).all(axis=1)
        expected = np.flatnonzero(inside)
        nothing = np.empty(0, dtype=np.int64), np.empty((0, 2))
        if len(expected) < 3:
            return expected, *nothing
        # Where the first image shows the ground that a pixel of the second sees.
        ground = _on_ground(self._node_rays, T_first_cam, first.plane)
        source, seen = project(ground, first.T_level_cam, calibration)
        source[(seen <= 0.05) | ~np.isfinite(ground).all(axis=1)] = -1e4
        warped = warp(there, upsample(source.reshape(*self._nodes, 2), height, width))
        # A landmark off the ground is elsewhere in the warped image than in the second.
        on_ground = _on_ground(first.rays[expected], first.T_level_cam, first.plane)
        start, ahead = project(on_ground, T_first_cam, calibration)
        usable = (ahead > 0.05) & (start > border).all(axis=1)
        usable &= (start < np.array([width - border, height - border])).all(axis=1)
        expected, start, goal = expected[usable], start[usable], goal[expected][usable]
        if len(expected) < 3:
            return expected, *nothing
        loops = settings.loops
        wide = replace(settings.frontend, flow_window_px=loops.flow_window_px, flow_levels=loops.flow_levels)
        end, good = follow(warped, picture, start, goal, wide)
        good &= np.linalg.norm(end - goal, axis=1) < settings.loops.search_px
        return expected, expected[good], end[good]


def _near(one: Array, other: Array, limit: float) -> bool:
    """Whether two alignments (4, 4) differ by less than `limit` (m) and as many radians."""
    off = invert(one) @ other
    return bool(np.linalg.norm(off[:3, 3]) < limit and abs(heading_of(off)) < limit)


def _on_ground(rays: Array, T_level_cam: Array, plane: Array) -> Array:
    """Points (N, 3) at which rays (N, 2) of a camera meet the ground; NaN where they do not."""
    directions = homogeneous(rays) @ T_level_cam[:3, :3].T
    centre = T_level_cam[:3, 3]
    rate = directions[:, 2] - directions[:, :2] @ plane[:2]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = (plane[:2] @ centre[:2] + plane[2] - centre[2]) / rate
    scale[~(scale > 0.01)] = np.nan
    return np.asarray(centre + scale[:, None] * directions, dtype=float)
