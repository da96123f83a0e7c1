"""Places: keyframes that can be recognised. Each is described by its ground view, to be recognised from any heading.

A survey camera looks ahead and down, and a reef seen from the other side is a different image. What is known from the
attitude, the height over the bottom and the landmarks is therefore removed first: the image is projected onto the
ground and seen level, from above, at a fixed scale. What remains of a heading is a rotation in the image, to which the
descriptors are invariant.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array, invert, transform
from oysterbench.core.streams import stream
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import distort, undistort
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe

NODE_STEP = 9
"""Pixels (odd) between the nodes at which a warp is computed exactly; between them it is linear. Landmarks found again
from the opposite heading are 0.1 px off; with steps of 27, 0.8 px."""
JPEG_QUALITY = 85
"""JPEG quality of the images that are kept: 40 to 60 kB each, and no corner moves."""


def level_pose(T_odom_imu: Array) -> Array:
    """T_odom_level (4, 4): the same position, level, with the heading of the IMU's x axis."""
    heading = np.arctan2(T_odom_imu[1, 0], T_odom_imu[0, 0])
    return heading_pose(heading, T_odom_imu[:3, 3])


def heading_pose(heading: float, position: Array) -> Array:
    """(4, 4) pose of a level frame: turned about z by a heading (rad), at a position (3,) m."""
    c, s = np.cos(heading), np.sin(heading)
    return transform(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), position)


def heading_of(T: Array) -> float:
    """Heading (rad) of a level pose."""
    return float(np.arctan2(T[1, 0], T[0, 0]))


def encode(picture: NDArray[np.uint8]) -> bytes:
    """Encode a grey image (H, W) as JPEG."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])


def decode(coded: bytes) -> NDArray[np.uint8]:
    """Decode an image (H, W) from JPEG."""
    return np.asarray(cv2.imdecode(np.frombuffer(coded, dtype=np.uint8), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


@dataclass
class Place:
    """What is stored of a keyframe to recognise it.

    T_level_cam (4, 4): the camera in the level frame of the keyframe (`level_pose`). plane (3,): the ground there,
    z = plane @ (x, y, 1). ids (L,), rays (L, 2), points (L, 3): landmarks in it, with their points in the level frame.
    descriptors (N, 32) uint8 and corners (N, 3) of the ground view: points in the level frame, depths interpolated
    between landmarks. picture: the equalised grey frame as JPEG.
    """

    keyframe: int
    T_level_cam: Array
    plane: Array
    ids: NDArray[np.int64]
    rays: Array
    points: Array
    descriptors: NDArray[np.uint8]
    corners: Array
    picture: bytes

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """The decoded image (H, W)."""
        return decode(self.picture)

    def forget(self) -> None:
        """Release all that serves recognition, keeping what a node of the pose graph needs."""
        # New arrays: a slice would keep the whole array alive.
        self.descriptors, self.corners, self.picture = np.empty((0, 32), dtype=np.uint8), np.empty((0, 3)), b""
        self.ids, self.rays, self.points = np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 3))

    @property
    def forgotten(self) -> bool:
        """Whether it is no more than a node of the pose graph: see `forget`."""
        return not self.picture

    @property
    def size(self) -> int:
        """Memory, bytes."""
        arrays = (self.ids, self.rays, self.points, self.descriptors, self.corners)
        return len(self.picture) + sum(array.nbytes for array in arrays)


def landmarks_of(model: Model, keyframes: list[Keyframe], k: int, reach: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Ids (L,), rays (L, 2) and points (L, 3) in odom of the landmarks in keyframe k, from `reach` more each way."""
    view = keyframes[k].observations
    around = [f for f in keyframes[max(0, k - reach) : k + reach + 1] if f.state is not None]
    rows = [f.observations.rows() for f in around]
    poses = np.repeat([f.estimate.matrix for f in around], [len(seen[0]) for seen in rows], axis=0)
    track, rays, camera = (np.concatenate(part) for part in zip(*rows, strict=True))
    own = np.isin(track, view.ids)
    limit = model.settings.landmarks.max_error_px
    ids, points = model.rig.triangulate(track[own], rays[own], poses[own], limit, model.settings.landmarks, camera[own])
    _, seen, found = np.intersect1d(view.ids, ids, assume_unique=True, return_indices=True)
    return view.ids[seen], view.rays[seen], points[found]


def fit_ground(points: Array) -> Array:
    """Plane (3,), z = plane @ (x, y, 1), through points (L, 3), by iteratively reweighted least squares (Huber).

    A weak prior holds it level where points on a line leave its slope undetermined.
    """
    places = np.column_stack([points[:, :2], np.ones(len(points))])
    weight = np.ones(len(points))
    prior = np.diag([0.5, 0.5, 0.0])
    for _ in range(5):
        weighted = places * weight[:, None]
        plane = np.linalg.solve(weighted.T @ places + prior, weighted.T @ points[:, 2])
        residual = np.abs(points[:, 2] - places @ plane)
        scale = 1.5 * np.median(residual) + 1e-6
        weight = np.minimum(1.0, scale / np.maximum(residual, 1e-9))
    return np.asarray(plane, dtype=float)


def project(points: Array, T_level_cam: Array, calibration: CameraCalibration) -> tuple[Array, Array]:
    """Pixels (N, 2), distorted, and depths (N,) of points (N, 3) in the level frame."""
    T = invert(T_level_cam)
    local = points @ T[:3, :3].T + T[:3, 3]
    depth = local[:, 2].copy()
    # Far outside the image, the distortion polynomial folds back into it.
    local[:, 2] = np.maximum(local[:, 2], 0.05)
    limit = (
        1.2 * np.hypot(calibration.width, calibration.height) / (calibration.matrix[0, 0] + calibration.matrix[1, 1])
    )
    depth[np.linalg.norm(local[:, :2], axis=1) > limit * local[:, 2]] = -1.0
    return distort(local[:, :2] / local[:, 2:], calibration), depth


class GroundViewer:
    """Projection of images onto the ground, and its description. All views have one scale, that of the first."""

    def __init__(self, calibration: CameraCalibration, settings: GtsamViSettings) -> None:
        self.calibration = calibration
        self.settings = settings
        self.resolution: float | None = None  # m per pixel of the ground view
        self._focal = float(calibration.matrix[0, 0] + calibration.matrix[1, 1]) / 2
        self._orb = cv2.ORB.create(
            nfeatures=settings.recognition.corners,
            nlevels=2,
            edgeThreshold=18,
            fastThreshold=settings.recognition.fast_threshold,
        )

    def view(
        self, picture: NDArray[np.uint8], place_points: Array, T_level_cam: Array, plane: Array
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
        """Ground view (S, S), mask of the part that the image shows, and the pixels (S, S, 2) it was sampled from.

        place_points (L, 3): the landmarks on whose median the view is centred.
        """
        size = self.settings.recognition.view_px
        if self.resolution is None:
            depth = np.median(np.linalg.norm(place_points - T_level_cam[:3, 3], axis=1))
            self.resolution = float(self.settings.recognition.coarseness * depth / self._focal)
        centre = np.median(place_points[:, :2], axis=0)
        columns, rows = nodes(size, size)
        middle = (size - 1) / 2
        # Seen from above: x (ahead) up in the image, y (left) to the left.
        x, y = centre[0] - (rows - middle) * self.resolution, centre[1] - (columns - middle) * self.resolution
        points = np.column_stack(
            [x.ravel(), y.ravel(), np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ plane]
        )
        pixels, depth = project(points, T_level_cam, self.calibration)
        # Beyond this depth the image is too coarse for a ground view at this scale.
        pixels[(depth <= 0.05) | (depth > 2.5 * self.resolution * self._focal)] = -1e4
        source = upsample(pixels.reshape(*x.shape, 2), size, size)
        tile = warp(picture, source)
        inside = (source[..., 0] >= 0) & (source[..., 0] <= self.calibration.width - 1)
        inside &= (source[..., 1] >= 0) & (source[..., 1] <= self.calibration.height - 1)
        mask = cv2.erode(inside.astype(np.uint8), np.ones((9, 9), dtype=np.uint8), borderValue=0)
        return tile, np.asarray(mask, dtype=np.uint8), source

    def describe(
        self, picture: NDArray[np.uint8], rays: Array, points: Array, T_level_cam: Array, plane: Array
    ) -> tuple[NDArray[np.uint8], Array]:
        """Descriptors (N, 32) and points (N, 3) in the level frame of the corners of the ground view.

        rays (L, 2), points (L, 3): the landmarks of the frame.
        """
        tile, mask, source = self.view(picture, points, T_level_cam, plane)
        corners, found_descriptors = self._orb.detectAndCompute(tile, mask)
        if len(corners) == 0:
            return np.empty((0, 32), dtype=np.uint8), np.empty((0, 3))
        descriptors = np.asarray(found_descriptors, dtype=np.uint8)
        at = np.array([corner.pt for corner in corners]).round().astype(int)
        found = undistort(source[at[:, 1], at[:, 0]].astype(float), self.calibration)
        return descriptors, _lift(found, rays, points, T_level_cam)


def _lift(rays: Array, known_rays: Array, known_points: Array, T_level_cam: Array) -> Array:
    """Points (N, 3) along rays (N, 2): inverse depths of the nearest landmarks, weighted by nearness in the image."""
    T = invert(T_level_cam)
    inverse_depth = 1.0 / np.maximum((known_points @ T[:3, :3].T + T[:3, 3])[:, 2], 0.05)
    n = min(4, len(known_rays))
    distance, nearest = cKDTree(known_rays).query(rays, k=n)
    distance, nearest = np.reshape(distance, (len(rays), n)), np.reshape(nearest, (len(rays), n))
    weight = 1.0 / (distance + 0.02) ** 2
    depth = weight.sum(axis=1) / (weight * inverse_depth[nearest]).sum(axis=1)
    points = homogeneous(rays) * depth[:, None] @ T_level_cam[:3, :3].T + T_level_cam[:3, 3]
    return np.asarray(points, dtype=float)


def nodes(height: int, width: int) -> tuple[Array, Array]:
    """Columns (G, G') and rows (G, G') of the nodes of a map of an image; the last ones may lie beyond its edge."""
    columns, rows = (np.arange(0, size - 1 + NODE_STEP, NODE_STEP, dtype=float) for size in (width, height))
    x, y = np.meshgrid(columns, rows)
    return x, y


def upsample(at_nodes: Array, height: int, width: int) -> NDArray[np.float32]:
    """Map (height, width, 2) from its values (G, G', 2) at the nodes, linear between them.

    `cv2.remap` would do it in steps of 1/32 of their distance.
    """
    enlarged = cv2.resize(at_nodes.astype(np.float32), None, fx=NODE_STEP, fy=NODE_STEP, interpolation=cv2.INTER_LINEAR)
    first = NODE_STEP // 2  # a node becomes the middle of a square of this side
    return np.asarray(enlarged[first : first + height, first : first + width], dtype=np.float32)


def warp(picture: NDArray[np.uint8], source: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Sample an image (H, W) at source pixels (H', W', 2); outside, its edge is continued."""
    # Without an edge there are no corners on it.
    edge = cv2.BORDER_REPLICATE
    seen = cv2.remap(picture, source, None, cv2.INTER_LINEAR, borderMode=edge)  # type: ignore[call-overload]
    return np.asarray(seen, dtype=np.uint8)


class Index:
    """Index of places by the words they share with an image: locality-sensitive hashing (Indyk & Motwani 1998).

    A word is some of a descriptor's bits, so there is no vocabulary to learn or to ship. A place is stored as its
    words, 4 bytes each; a query marks its own words in a table and looks all stored ones up in it.
    """

    def __init__(self, settings: GtsamViSettings) -> None:
        generator = stream(0, b"", "gtsam_vi", "places")
        bits = settings.recognition.word_bits
        self._bits = np.array([generator.permutation(256)[:bits] for _ in range(settings.recognition.words)])
        self._powers = 1 << np.arange(bits)
        self._none = 1 << bits  # stands for a corner that is not there
        self._places_with = np.zeros((len(self._bits), self._none + 1), dtype=np.int32)
        self._words = np.empty((8, len(self._bits), settings.recognition.corners), dtype=np.int32)
        self._rows: list[int] = []  # the place of each row of words
        self.count = 0

    def _words_of(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Words (tables, N) of descriptors (N, 32)."""
        unpacked = np.unpackbits(descriptors, axis=1)
        return np.stack([unpacked[:, bits] @ self._powers for bits in self._bits])

    def add(self, descriptors: NDArray[np.uint8]) -> None:
        """Add the next place; one without descriptors takes a number, but no memory."""
        if len(descriptors):
            row = len(self._rows)
            if row == len(self._words):
                self._words = np.concatenate([self._words, np.empty_like(self._words)])
            words = self._words_of(descriptors)[:, : self._words.shape[2]]
            self._words[row] = self._none
            self._words[row, :, : words.shape[1]] = words
            self._count_words(row, 1)
            self._rows.append(self.count)
        self.count += 1

    @property
    def size(self) -> int:
        """Memory, bytes."""
        return self._places_with.nbytes + self._words.nbytes

    def forget(self, place: int) -> None:
        """Give a place no votes from now on."""
        if place not in self._rows:
            return
        row, last = self._rows.index(place), len(self._rows) - 1
        self._count_words(row, -1)
        self._words[row], self._rows[row] = self._words[last], self._rows[last]
        self._rows.pop()

    def _count_words(self, row: int, by: int) -> None:
        for table, words in zip(self._places_with, self._words[row], strict=True):
            table[np.unique(words)] += by

    def votes(self, descriptors: NDArray[np.uint8]) -> Array:
        """Votes (count,) for each place: its corners that share a word, which count more the rarer the word is."""
        votes = np.zeros(self.count)
        for t, words in enumerate(self._words_of(descriptors)):
            weight = np.zeros(self._none + 1, dtype=np.float32)
            words = words[self._places_with[t, words] > 0]
            weight[words] = np.log((self.count + 1) / self._places_with[t, words])
            votes[self._rows] += weight[self._words[: len(self._rows), t]].sum(axis=1)
        return votes
