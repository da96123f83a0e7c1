"""Geometry of several views: a pose from points, points from poses, and the first two poses."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert, transform

# OpenCV's random samples come from a generator of its own with a fixed seed: the same input gives the same answer.


def homogeneous(rays: Array) -> Array:
    """Directions (N, 3), x, y, 1, of rays (N, 2)."""
    return np.column_stack([rays, np.ones(len(rays))])


def reprojection_errors(points: Array, T_map_cam: Array, rays: Array) -> Array:
    """Distances (N,) between rays (N, 2) and points (N, 3) of the map seen from a pose; infinite behind the camera."""
    seen = (points - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
    depth = seen[:, 2]
    errors = np.linalg.norm(seen[:, :2] / np.where(depth > 0, depth, 1.0)[:, None] - rays, axis=1)
    return np.where(depth > 0, errors, np.inf)


def view_errors(point: Array, poses: Array, rays: Array) -> Array:
    """Distances (V,) as in `reprojection_errors`, of one point (3,) seen along rays (V, 2) from poses (V, 4, 4)."""
    seen = np.einsum("vji,vj->vi", poses[:, :3, :3], point - poses[:, :3, 3])
    depth = seen[:, 2]
    errors = np.linalg.norm(seen[:, :2] / np.where(depth > 0, depth, 1.0)[:, None] - rays, axis=1)
    return np.where(depth > 0, errors, np.inf)


def pose_from_points(
    points: Array, rays: Array, tolerance: float, trials: int
) -> tuple[Array, NDArray[np.bool_]] | None:
    """T_map_cam (4, 4) that sees points (N, 3) along rays (N, 2), and which of them (N,) agree within a tolerance.

    Perspective-three-point in RANSAC (Fischler & Bolles 1981), then least squares over those that agree.
    """
    if len(points) < 4:
        return None
    points, rays = np.ascontiguousarray(points), np.ascontiguousarray(rays)
    camera = np.eye(3)
    done, turn, shift, chosen = cv2.solvePnPRansac(
        points,
        rays,
        camera,
        None,
        iterationsCount=trials,
        reprojectionError=tolerance,
        confidence=0.9999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not done or chosen is None or len(chosen) < 4:
        return None
    good = chosen.ravel()
    for _ in range(2):
        turn, shift = cv2.solvePnPRefineLM(points[good], rays[good], camera, None, turn, shift)
        T_map_cam = invert(transform(cv2.Rodrigues(turn)[0], shift.ravel()))
        agree = reprojection_errors(points, T_map_cam, rays) < tolerance
        good = np.flatnonzero(agree)
        if len(good) < 4:
            return None
    return T_map_cam, agree


def point_from_views(poses: Array, rays: Array) -> Array | None:
    """The point (3,) of the map that is seen along rays (V, 2) from poses T_map_cam (V, 4, 4); None at infinity.

    Linear (Hartley & Zisserman 2004, 12.2), each row weighted by the depth that the first solution gives, so that
    what is minimised is the error in the images.
    """
    T_cam_map = invert(poses)
    rows = rays[..., None] * T_cam_map[:, None, 2, :] - T_cam_map[:, :2, :]
    weights = np.ones(len(poses))
    for _ in range(2):
        solution = np.linalg.svd((rows * weights[:, None, None]).reshape(-1, 4))[2][-1]
        if abs(solution[3]) < 1e-9:
            return None
        point: Array = solution[:3] / solution[3]
        depth = T_cam_map[:, 2, :3] @ point + T_cam_map[:, 2, 3]
        if (depth <= 0).any():
            return None
        weights = 1 / depth
    return point


def ray_angle(poses: Array, point: Array) -> float:
    """Greatest angle, rad, at which the first and another of several poses (V, 4, 4) see a point (3,)."""
    lines = point - poses[:, :3, 3]
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    return float(np.arccos(np.clip((lines @ lines[0]).min(), -1, 1)))


def relative_poses(before: Array, after: Array, tolerance: float) -> list[Array]:
    """Candidates for T_before_after (4, 4) by two views of rays (N, 2), (N, 2), each with a translation of length one.

    That of the essential matrix, by five points in RANSAC (Nistér 2004) and with the points in front of both cameras;
    and those of the homography (Malis & Vargas 2007) with the plane in front of both: two views of a level bottom leave
    two.
    """
    found = []
    camera = np.eye(3)
    essential, agree = cv2.findEssentialMat(before, after, camera, method=cv2.RANSAC, prob=0.9999, threshold=tolerance)
    if essential is not None and essential.shape == (3, 3):
        _, rotation, shift, _ = cv2.recoverPose(essential, before, after, camera, mask=agree.copy())
        found.append(invert(transform(rotation, shift.ravel())))
    plane, agree = cv2.findHomography(before, after, cv2.RANSAC, tolerance)
    if plane is not None:
        lines = homogeneous(before[agree.ravel() > 0])
        for rotation, shift, normal in zip(*cv2.decomposeHomographyMat(plane, camera)[1:], strict=True):
            length = np.linalg.norm(shift)
            if length > 1e-6 and (lines @ normal > 0).all():
                found.append(invert(transform(rotation, shift.ravel() / length)))
    return found
