"""Front end: corners, tracked from frame to frame and verified against the epipolar geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings


@dataclass(frozen=True)
class FeatureTracks:
    """Tracked corners of one frame: ids (N,) int64, pixels (N, 2) as seen, rays (N, 2) undistorted at depth 1."""

    ids: NDArray[np.int64]
    pixels: Array
    rays: Array


NO_TRACKS = FeatureTracks(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2)))
"""Those of a frame that is missing."""


@dataclass(frozen=True)
class Observations:
    """What a key frame saw: ids (N,) int64, sorted, and rays (N, 2) at depth 1.

    right: rays (N, 2) of a second camera to the same, NaN where it does not see them; None without one.
    inflation: of the rays' sigma, by tracks that were lost meanwhile.
    """

    ids: NDArray[np.int64]
    rays: Array
    right: Array | None = None
    inflation: float = 1.0

    def rows(self) -> tuple[NDArray[np.int64], Array, NDArray[np.intp]]:
        """A row for each ray: ids (M,), rays (M, 2), and the camera (M,), 0 or 1."""
        if self.right is None:
            return self.ids, self.rays, np.zeros(len(self.ids), dtype=np.intp)
        both = np.isfinite(self.right[:, 0])
        camera = np.repeat([0, 1], [len(self.ids), int(both.sum())])
        return np.concatenate([self.ids, self.ids[both]]), np.concatenate([self.rays, self.right[both]]), camera


def undistort(pixels: Array, calibration: CameraCalibration) -> Array:
    """Normalised coordinates (N, 2) of pixels (N, 2), distortion removed."""
    if len(pixels) == 0:
        return np.empty((0, 2))
    points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    rays = _lens(calibration).undistortPoints(points, calibration.matrix, calibration.distortion)
    return np.asarray(rays.reshape(-1, 2), dtype=float)


def distort(rays: Array, calibration: CameraCalibration) -> Array:
    """Pixels (N, 2) of rays (N, 2) at depth 1."""
    if len(rays) == 0:
        return np.empty((0, 2))
    points = homogeneous(rays).reshape(-1, 1, 3)
    matrix, distortion = calibration.matrix, calibration.distortion
    pixels, _ = _lens(calibration).projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(pixels.reshape(-1, 2), dtype=float)


def _lens(calibration: CameraCalibration) -> Any:
    """OpenCV's functions of a lens: Kannala-Brandt or Brown-Conrady."""
    return cv2.fisheye if calibration.distortion_model == "equidistant" else cv2


def homogeneous(rays: Array) -> Array:
    """(N, 3) directions (x, y, 1) of normalised coordinates (N, 2)."""
    return np.column_stack([rays, np.ones(len(rays))])


def epipolar_inliers(
    before: Array, after: Array, R_after_before: Array, tolerance: float, trials: int, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Which pairs of rays (N, 2), (N, 2) agree with one translation, for a known rotation between the views.

    RANSAC over the direction of translation: with the rotation known, two pairs determine it, as the direction
    perpendicular to the normals of both epipolar planes. Unlike a five- or eight-point solution this has no
    degenerate scenes (a flat bottom is one for both) and none at rest. The error is the distance from the epipolar
    line in the later view.
    """
    n = len(before)
    if n < 3:
        return np.ones(n, dtype=bool)
    turned = homogeneous(before) @ R_after_before.T
    seen = homogeneous(after)
    normals = np.cross(turned, seen)
    first, second = generator.integers(0, n, size=(2, trials))
    directions = np.cross(normals[first], normals[second])
    lengths = np.linalg.norm(directions, axis=1)
    directions = directions[lengths > 1e-15] / lengths[lengths > 1e-15, None]
    if len(directions) == 0:
        return np.asarray(np.linalg.norm(normals, axis=1) < tolerance, dtype=bool)
    # Epipolar line of a pair: the plane of direction and turned ray, cut with the image plane.
    lines = np.cross(directions[:, None, :], turned[None, :, :])
    scale = np.hypot(lines[..., 0], lines[..., 1])
    distance = np.abs(np.einsum("tni,ni->tn", lines, seen)) / np.maximum(scale, 1e-12)
    inliers = distance < tolerance
    return np.asarray(inliers[int(np.argmax(inliers.sum(axis=1)))], dtype=bool)


def even_contrast(grey: NDArray[np.uint8], settings: FrontEndSettings) -> NDArray[np.uint8]:
    """A grey picture (H, W) without its veil of scattered light, and with the same contrast everywhere.

    The veil is the mean around a pixel, which takes the slower part of caustics and of a lamp's cone with it; what is
    left is divided by its own spread in a wider surrounding, and by no less than the sensor's noise.
    """
    picture = grey.astype(np.float32)
    detail = picture - cv2.blur(picture, (settings.veil_px, settings.veil_px))
    square = cv2.sqrBoxFilter(detail, cv2.CV_32F, (settings.contrast_px, settings.contrast_px))
    spread = np.sqrt(np.maximum(square, 0.0))  # its running sums leave a little less than nothing where all is black
    even = 128 + settings.contrast_grey * detail / (spread + settings.contrast_floor_grey)
    return cv2.convertScaleAbs(np.maximum(even, 0.0)).astype(np.uint8, copy=False)


class FrontEnd:
    """Tracks corners through the frames of one camera."""

    def __init__(self, calibration: CameraCalibration, settings: FrontEndSettings, seed: int = 0) -> None:
        self.calibration = calibration
        self.settings = settings
        self._focal = float(calibration.matrix[0, 0] + calibration.matrix[1, 1]) / 2
        self._generator = stream(seed, b"", "gtsam_vi", "epipolar")
        self.image: NDArray[np.uint8] | None = None  # (H, W), the latest, equalised
        self._next_id = 0
        self._taken: NDArray[np.uint8] | None = None  # the latest, as it was taken
        self._tracks = NO_TRACKS

    def track(self, pixels: NDArray[np.uint8], R_before_now: Array, elapsed_s: float = 0.0) -> FeatureTracks:
        """Corners in the next frame.

        pixels (H, W, 3) RGB or (H, W) grey, uint8. R_before_now (3, 3): rotation of the camera since the last frame,
        elapsed_s ago. After a long gap all corners are new: a patch that has gone far is found where one like it is.
        """
        self._taken = pixels
        if elapsed_s > self.settings.max_gap_s:
            self._tracks = NO_TRACKS
        image = self.equalise(pixels)
        if self.image is not None and len(self._tracks.ids):
            self._tracks = self._follow(self.image, image, R_before_now)
        self.image = image
        self._tracks = self._replenish(image)
        return self._tracks

    def repeats(self, pixels: NDArray[np.uint8]) -> bool:
        """Whether a picture is the last one again, to the bit, which noise lets no camera take twice."""
        return self._taken is not None and np.array_equal(self._taken, pixels)

    def equalise(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A picture (H, W, 3) RGB or (H, W) as corners are looked for in it: (H, W) uint8."""
        grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        return even_contrast(np.asarray(grey, dtype=np.uint8), self.settings)

    def _follow(self, last: NDArray[np.uint8], image: NDArray[np.uint8], R_before_now: Array) -> FeatureTracks:
        """The last frame's tracks in this one: Lucas-Kanade forth and back, then the epipolar check."""
        settings, tracks = self.settings, self._tracks
        turned = homogeneous(tracks.rays) @ R_before_now  # where the rotation alone would take them
        guess = distort(turned[:, :2] / np.maximum(turned[:, 2:], 0.1), self.calibration)
        end, good = follow(last, image, tracks.pixels, guess, settings)
        ids, before, now = tracks.ids[good], tracks.rays[good], end[good]
        rays = undistort(now, self.calibration)
        tolerance = settings.epipolar_error_px / self._focal
        keep = epipolar_inliers(before, rays, R_before_now.T, tolerance, settings.epipolar_trials, self._generator)
        return FeatureTracks(ids[keep], now[keep], rays[keep])

    def _replenish(self, image: NDArray[np.uint8]) -> FeatureTracks:
        """New corners where there are few tracks."""
        settings, tracks = self.settings, self._tracks
        # Looking for corners costs as much as tracking them: only when it pays.
        if settings.max_tracks - len(tracks.ids) < settings.max_tracks // 8:
            return tracks
        pixels = find_corners(image, tracks.pixels, settings)
        ids = np.arange(self._next_id, self._next_id + len(pixels), dtype=np.int64)
        self._next_id += len(pixels)
        return FeatureTracks(
            np.concatenate([tracks.ids, ids]),
            np.concatenate([tracks.pixels, pixels]),
            np.concatenate([tracks.rays, undistort(pixels, self.calibration)]),
        )


def follow(
    before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: Array, guess: Array, settings: FrontEndSettings
) -> tuple[Array, NDArray[np.bool_]]:
    """Where the patches at pixels (N, 2) of one grey image are in another, by Lucas and Kanade, begun at guess (N, 2).

    Gives pixels (N, 2), and of which (N,) the way back leads where it began, all within the image.
    """
    start, begun = pixels.astype(np.float32), guess.astype(np.float32)
    size = (settings.flow_window_px, settings.flow_window_px)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    flow: dict[str, Any] = {"winSize": size, "maxLevel": settings.flow_levels, "criteria": criteria}
    flow["flags"] = cv2.OPTFLOW_USE_INITIAL_FLOW
    end, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start, begun.copy(), **flow)
    # Back from where the forward pass ended, with the prediction's own error as the guess, not the answer.
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(after, before, end, end - (begun - start), **flow)
    height, width = after.shape
    good = (found.ravel() == 1) & (found_back.ravel() == 1)
    good &= np.linalg.norm(back - start, axis=1) < settings.backward_error_px
    good &= (end[:, 0] >= 1) & (end[:, 0] < width - 1) & (end[:, 1] >= 1) & (end[:, 1] < height - 1)
    return end.astype(np.float64), good


def find_corners(image: NDArray[np.uint8], taken: Array, settings: FrontEndSettings) -> Array:
    """Corners (N, 2) px in a grey image away from those `taken` (M, 2): the best by Shi & Tomasi (1994), spread out.

    Every cell of a grid has the same share of the tracks, so that one bright clump does not get them all: turbid water
    dims the far half of a picture, and it is the far half that tells rotation from translation.
    """
    height, width = image.shape
    spacing, border = round(settings.track_spacing_px), settings.flow_window_px // 2 + 1
    score = cv2.cornerMinEigenVal(image, settings.corner_block_px)
    # A peak is the best within the spacing of it: one dilation does what a sorted search would.
    peaks = score >= cv2.dilate(score, np.ones((2 * spacing + 1, 2 * spacing + 1), dtype=np.uint8))
    peaks &= score > settings.corner_quality * score.max()
    allowed = np.zeros(image.shape, dtype=np.uint8)
    allowed[border : height - border, border : width - border] = 1
    for x, y in taken:
        cv2.circle(allowed, (round(x), round(y)), spacing, 0, -1)
    y, x = np.nonzero(peaks & (allowed > 0))
    best = np.argsort(-score[y, x], kind="stable")
    y, x = y[best], x[best]
    columns, rows = settings.grid
    cell = (y * rows // height) * columns + x * columns // width
    count = np.zeros(rows * columns, dtype=int)
    old = taken.astype(int)
    np.add.at(count, (old[:, 1] * rows // height) * columns + old[:, 0] * columns // width, 1)
    share = int(np.ceil(settings.max_tracks / (rows * columns)))
    chosen = []
    for k, c in enumerate(cell):
        if count[c] < share:
            count[c] += 1
            chosen.append(k)
    # What the poor cells leave over goes to the rich ones, the best corners first.
    left = settings.max_tracks - len(taken) - len(chosen)
    if left > 0:
        chosen += sorted(set(range(len(cell))) - set(chosen))[:left]
    chosen = chosen[: max(0, settings.max_tracks - len(taken))]
    return np.column_stack([x[chosen], y[chosen]]).astype(float)
