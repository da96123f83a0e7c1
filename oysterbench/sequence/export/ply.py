"""Point clouds in `map` as binary PLY: from the cameras' depth, in colour, and from the sonars' returns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.ply import write_ply
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.export.parts import frames_with_layers, sensor_poses
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.types import CameraCalibration, Sequence

VOXEL_M = 0.01
"""Edge of the voxels, each of which keeps only its first point: a reef is seen in frame after frame."""

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("class", "u1"),
        ("instance", "<u2"),
    ]
)
ECHO = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("class", "u1"), ("instance", "<u2")])


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write a file per camera with depth, and per sonar with clouds."""
    topics = {topic for topic, _, _ in sequence.contents()}
    cameras = [name for name in sequence.cameras if f"/{name}/depth" in topics]
    sonars = [name for name in sequence.sonars if f"/{name}/cloud" in topics]
    if not truth or not (cameras or sonars):
        raise SequenceError(
            f"{sequence.name}: point clouds need the ground truth: expected a camera with depth or a sonar with "
            f"clouds, and no --no-truth, got {'--no-truth' if not truth else 'neither'}"
        )
    path, sequence = sequence.truth(), sequence.truly_calibrated()
    notes = []
    steps.expect(frames(sequence, cameras, "depth") + frames(sequence, sonars, "cloud"))
    for name in cameras:
        cloud = camera_cloud(sequence, name, path, topics, steps)
        write_ply(folder / f"{name}.ply", cloud, f"{sequence.name}, {name}, in map, m")
        notes.append(f"{name}.ply: {len(cloud)} points, one per {1000 * VOXEL_M:g} mm")
    for name in sonars:
        cloud = sonar_cloud(sequence, name, path, steps)
        write_ply(folder / f"{name}.ply", cloud, f"{sequence.name}, {name}, in map, m")
        notes.append(f"{name}.ply: {len(cloud)} returns")
    return notes


def camera_cloud(sequence: Sequence, camera: str, path: Trajectory, topics: set[str], steps: Steps) -> NDArray[Any]:
    """Points (N,) POINT in map: the pixels with depth of all frames that the truth spans, thinned to one per voxel."""
    calibration = sequence.cameras[camera]
    rays = pixel_rays(calibration)
    known_rays = np.isfinite(rays[..., 0])
    layers = ["depth", *(name for name in ("class", "instance") if f"/{camera}/{name}" in topics)]
    kept = [np.zeros(0, dtype=POINT)]
    known = np.zeros(0, dtype=np.int64)
    for image, found in steps.counted(frames_with_layers(sequence, camera, layers)):
        if not _spans(path, calibration.taken_ns(image.stamp_ns)):
            continue
        depth = found.pop("depth")
        seen = (depth > 0) & known_rays
        shown = points_at(rays[seen], depth[seen].astype(float))
        taken = np.clip(calibration.rows_taken_ns(image.stamp_ns), path.stamps_ns[0], path.stamps_ns[-1])
        poses = sensor_poses(path.at(taken), calibration.T_base_cam)[np.nonzero(seen)[0]]
        points = (poses[:, :3, :3] @ shown[..., None])[..., 0] + poses[:, :3, 3]
        rows = _rows(points, POINT)
        for k, colour in enumerate(("red", "green", "blue")):
            rows[colour] = image.pixels[seen][:, k]
        for name, layer in found.items():
            rows[name] = layer[seen]
        # The frame's new voxels, each with its first point.
        keys, first = np.unique(voxels(points), return_index=True)
        new = ~np.isin(keys, known, assume_unique=True)
        known = np.union1d(known, keys[new])
        kept.append(rows[np.sort(first[new])])
    return np.concatenate(kept)


def sonar_cloud(sequence: Sequence, sonar: str, path: Trajectory, steps: Steps) -> NDArray[Any]:
    """Points (N,) ECHO in map: the returns of all pings that the truth spans."""
    kept = [np.zeros(0, dtype=ECHO)]
    for cloud in steps.counted(sequence.clouds(sonar)):
        if not _spans(path, cloud.stamp_ns):
            continue
        points = _in_map(path, cloud.stamp_ns, sequence.sonars[sonar].T_base_sensor, cloud.points.astype(float))
        rows = _rows(points, ECHO)
        rows["intensity"], rows["class"], rows["instance"] = cloud.intensity, cloud.classes, cloud.instances
        kept.append(rows)
    return np.concatenate(kept)


def pixel_rays(camera: CameraCalibration) -> Array:
    """Ray in water of each pixel's centre (H, W, 3): its slopes x / z and y / z in the optical frame, and the z at
    which it meets the optical axis, m; NaN where the lens shows nothing.

    That z is 0, except behind a flat port, which refracts every ray by Snell's law: none of them passes through the
    pupil.
    """
    columns, rows = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    return rays_at(camera, columns, rows)


UNFOUND = 1e6
"""Both slopes of a ray that OpenCV does not find."""


def rays_at(camera: CameraCalibration, columns: Array, rows: Array) -> Array:
    """Rays (H, W, 3), as in `pixel_rays`, of the points at columns and rows (H, W) px of the image."""
    if camera.distortion_model == "equidistant":
        pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
        plane = np.asarray(cv2.fisheye.undistortPoints(pixels, camera.matrix, camera.distortion[:4]))
        x, y = plane.reshape(*columns.shape, 2).transpose(2, 0, 1)
        across = (columns - camera.matrix[0, 2]) / camera.matrix[0, 0]
        down = (rows - camera.matrix[1, 2]) / camera.matrix[1, 1]
        # OpenCV takes no distorted angle beyond 90 degrees, and continues rays from behind to the front.
        ahead = (np.hypot(across, down) < np.pi / 2) & (x * across + y * down >= 0) & (np.hypot(x, y) < UNFOUND)
        x, y = np.where(ahead, [x, y], np.nan)
    else:
        matrix = camera.matrix
        x, y = _without_distortion(
            (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1], camera.distortion
        )
    if camera.port_m is None:
        return np.stack([x, y, np.zeros_like(x)], axis=-1)
    air = np.hypot(x, y)
    sine = air / np.sqrt(1.0 + air**2) / camera.port_index
    water = sine / np.sqrt(1.0 - sine**2)
    shrink = np.divide(water, air, out=np.full_like(air, 1.0 / camera.port_index), where=air > 1e-9)
    return np.stack([x * shrink, y * shrink, camera.port_m * (1.0 - 1.0 / shrink)], axis=-1)


def points_at(rays: Array, depth: Array) -> Array:
    """Points (N, 3) m in the optical frame, on rays (N, 3) at depths (N,) m along the optical axis."""
    return np.column_stack([rays[:, :2] * (depth - rays[:, 2])[:, None], depth])


def _without_distortion(distorted_x: Array, distorted_y: Array, coefficients: Array) -> tuple[Array, Array]:
    """Undo Brown-Conrady distortion by fixed-point iteration from the distorted point, on the plane at depth 1."""
    k1, k2, p1, p2, k3 = np.pad(coefficients, (0, 5 - len(coefficients)))

    def bent(x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Radial factor of the distortion, and its tangential terms in x and y."""
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return radial, 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y

    x, y = distorted_x, distorted_y
    with np.errstate(all="ignore"):  # where the lens shows nothing, the iteration diverges
        for _ in range(100):
            radial, side, up = bent(x, y)
            x, y = (distorted_x - side) / radial, (distorted_y - up) / radial
        radial, side, up = bent(x, y)
        found = np.hypot(x * radial + side - distorted_x, y * radial + up - distorted_y) < 1e-7
    x, y = np.where(found, x, np.nan), np.where(found, y, np.nan)
    return x, y


def voxels(points: Array) -> NDArray[np.int64]:
    """Number (N,) of the voxel that contains each point (N, 3); valid within 10 km of the origin."""
    cells = np.floor(points / VOXEL_M).astype(np.int64) + (1 << 20)
    return (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]


def _rows(points: Array, kind: np.dtype[Any]) -> NDArray[Any]:
    rows = np.zeros(len(points), dtype=kind)
    rows["x"], rows["y"], rows["z"] = points.T
    return rows


def _spans(path: Trajectory, stamp_ns: int) -> bool:
    return int(path.stamps_ns[0]) <= stamp_ns <= int(path.stamps_ns[-1])


def _in_map(path: Trajectory, stamp_ns: int, T_base_sensor: Array, points: Array) -> Array:
    (pose,) = sensor_poses(path.at(np.array([stamp_ns], dtype=np.int64)), T_base_sensor)
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
