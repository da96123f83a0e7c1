"""Front end: corners tracked from frame to frame and verified against the epipolar geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core import lens
from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.flow import FEWEST_FOR_FLOW, UNKNOWN_FLOW, Flow, fit_flow, homogeneous
from oysterbench_baselines.gtsam_vi.pictures import FixedPattern, even_contrast, without_veil
from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings


@dataclass(frozen=True)
class FeatureTracks:
    """Tracked corners of one frame: ids (N,) int64, pixels (N, 2) as seen, rays (N, 2) undistorted at depth 1.

    rolled (N, 2): displacement of the rays from the stamp of the frame to the readout of their row; None where all rows
    are read at once.
    """

    ids: NDArray[np.int64]
    pixels: Array
    rays: Array
    rolled: Array | None = None

    @property
    def at_stamp(self) -> Array:
        """Rays (N, 2) as they were at the stamp."""
        return self.rays if self.rolled is None else self.rays - self.rolled


NO_TRACKS = FeatureTracks(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2)))
"""Tracks of a frame that is missing."""


@dataclass(frozen=True)
class Observations:
    """Observations of a keyframe: ids (N,) int64, sorted, and rays (N, 2) at depth 1.

    right: rays (N, 2) of a second camera to the same points, NaN where it does not see them; None without one.
    inflation: factor on the sigma of the rays, due to tracks lost since the last keyframe.
    """

    ids: NDArray[np.int64]
    rays: Array
    right: Array | None = None
    inflation: float = 1.0

    def rows(self) -> tuple[NDArray[np.int64], Array, NDArray[np.intp]]:
        """One row per ray: ids (M,), rays (M, 2), and the camera (M,), 0 or 1."""
        if self.right is None:
            return self.ids, self.rays, np.zeros(len(self.ids), dtype=np.intp)
        both = np.isfinite(self.right[:, 0])
        camera = np.repeat([0, 1], [len(self.ids), int(both.sum())])
        return np.concatenate([self.ids, self.ids[both]]), np.concatenate([self.rays, self.right[both]]), camera


def undistort(pixels: Array, calibration: CameraCalibration) -> Array:
    """Normalised coordinates (N, 2) of pixels (N, 2), distortion removed."""
    equidistant = calibration.distortion_model == "equidistant"
    return lens.undistort(pixels, calibration.matrix, calibration.distortion, equidistant)


def distort(rays: Array, calibration: CameraCalibration) -> Array:
    """Pixels (N, 2) of rays (N, 2) at depth 1."""
    if len(rays) == 0:
        return np.empty((0, 2))
    points = homogeneous(rays).reshape(-1, 1, 3)
    matrix, distortion = calibration.matrix, calibration.distortion
    pixels, _ = _lens(calibration).projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
    return np.asarray(pixels.reshape(-1, 2), dtype=float)


def _lens(calibration: CameraCalibration) -> Any:
    """OpenCV module with the functions of a lens: Kannala-Brandt or Brown-Conrady."""
    return cv2.fisheye if calibration.distortion_model == "equidistant" else cv2


def epipolar_inliers(
    before: Array, after: Array, R_after_before: Array, tolerance: float, trials: int, generator: np.random.Generator
) -> NDArray[np.bool_]:
    """Which pairs of rays (N, 2), (N, 2) agree with one translation, for a known rotation between the views.

    RANSAC over the direction of translation: with the rotation known, two pairs determine it, as the direction
    perpendicular to the normals of both epipolar planes. Unlike a five- or eight-point solution, this has no
    degenerate scenes (a flat bottom is one for both) and does not degenerate at rest. The error is the distance
    from the epipolar line in the later view.
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
    # Epipolar line of a pair: the plane of direction and rotated ray, intersected with the image plane. By components,
    # as np.cross takes as long as all the rest of the frame's check.
    (x, y, z), (a, b, c) = directions.T[:, :, None], turned.T
    line_x, line_y, line_z = y * c - z * b, z * a - x * c, x * b - y * a
    distance = np.abs(line_x * after[:, 0] + line_y * after[:, 1] + line_z)  # times the length of the line's normal
    inliers = distance < tolerance * np.maximum(np.sqrt(line_x * line_x + line_y * line_y), 1e-12)
    return np.asarray(inliers[int(np.argmax(inliers.sum(axis=1)))], dtype=bool)


@dataclass(frozen=True)
class Translation:
    """Translation of a camera between two frames, (3,) m in its axes at the first; sigma: m, 1 sigma per axis."""

    vector: Array
    sigma: float


def agree_with(
    moved: Translation, before: Array, after: Array, R_after_before: Array, tolerance: float, sigmas: float
) -> NDArray[np.bool_]:
    """Which pairs of rays (N, 2), (N, 2) agree with a known translation: all of them where its direction is not known.

    What drifts with the water moves as one and may be most of what is visible: a consensus among tracks takes it for
    the bottom. It cannot imitate the motion of the vehicle, except along the line of travel. A static point moves along
    its epipolar line, away from where the camera is heading, by an amount that depends on its depth; across that line,
    by no more than the uncertainty of the direction allows.
    """
    length = float(np.linalg.norm(moved.vector))
    if length < sigmas * moved.sigma:
        return np.ones(len(before), dtype=bool)
    turned = homogeneous(before) @ R_after_before.T
    still = turned[:, :2] / np.maximum(turned[:, 2:], 0.1)
    flow = after - still
    towards = R_after_before @ moved.vector / length
    # For a point (x, y, 1) z, a translation t gives the flow (t_z (x, y) - (t_x, t_y)) / z.
    along = towards[2] * still - towards[:2]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    forth = np.einsum("ni,ni->n", flow, along)
    across = np.abs(along[:, 0] * flow[:, 1] - along[:, 1] * flow[:, 0])
    allowed = tolerance + sigmas * moved.sigma / length * np.linalg.norm(flow, axis=1)
    return np.asarray((across < allowed) & (forth > -allowed), dtype=bool)


class FrontEnd:
    """Tracker of corners through the frames of one camera.

    moving: function that masks what moves, (H, W) bool, in an image (H, W, 3); corners are neither started nor kept
    there.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        settings: FrontEndSettings,
        seed: int = 0,
        moving: Callable[[NDArray[np.uint8]], NDArray[np.bool_]] | None = None,
    ) -> None:
        self.calibration = calibration
        self.settings = settings
        self._focal = float(calibration.matrix[0, 0] + calibration.matrix[1, 1]) / 2
        self._generator = stream(seed, b"", "gtsam_vi", "epipolar")
        self.image: NDArray[np.uint8] | None = None  # (H, W), the latest, equalised
        self._next_id = 0
        self._taken: NDArray[np.uint8] | None = None  # the latest, as taken
        self._pattern = FixedPattern(settings)
        self._tracks = NO_TRACKS
        self._flow = UNKNOWN_FLOW
        self._find_moving = moving
        self._moving: NDArray[np.bool_] | None = None  # (H, W), of the latest image

    def track(
        self,
        pixels: NDArray[np.uint8],
        R_before_now: Array,
        elapsed_s: float = 0.0,
        moved: Translation | None = None,
    ) -> FeatureTracks:
        """Track corners into the next frame.

        pixels (H, W, 3) RGB or (H, W) grey, uint8. R_before_now (3, 3): rotation of the camera since the last frame,
        elapsed_s ago; moved: its translation, where it is known. After a long gap all corners are new: a patch that has
        moved far would be found wherever a similar one is.
        """
        self._taken = pixels
        if elapsed_s > self.settings.max_gap_s:
            self._tracks = NO_TRACKS
        self._moving = None if self._find_moving is None else self._find_moving(pixels)
        detail = self._without_veil(pixels)
        image = even_contrast(self._pattern.taken_from(detail), self.settings)
        before = self._tracks
        if self.image is not None and len(self._tracks.ids):
            self._tracks = self._follow(self.image, image, R_before_now, elapsed_s, moved)
        else:
            self._flow = UNKNOWN_FLOW
        self.image = image
        self._pattern.add(detail, self._moved_px(before, R_before_now))
        kept, self._tracks = self._tracks, self._replenish(image)
        if not self.settings.rolling_shutter or not self.calibration.readout_s or elapsed_s <= 0:
            return self._tracks
        return replace(self._tracks, rolled=self._rolled(before, kept, elapsed_s))

    # What another front end may override.

    def find(
        self, before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: Array, guess: Array, levels: int
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Track pixels (N, 2) from the last equalised image (H, W) into the current one; see `follow`."""
        return follow(before, after, pixels, guess, replace(self.settings, flow_levels=levels))

    def corners(self, image: NDArray[np.uint8], taken: Array) -> Array:
        """Pixels (N, 2) at which to start tracks in an equalised image (H, W); see `find_corners`."""
        return find_corners(image, taken, self.settings)

    def _rolled(self, before: FeatureTracks, kept: FeatureTracks, elapsed_s: float) -> Array:
        """`FeatureTracks.rolled` (N, 2) of the latest tracks, by the flow (a, b, c) (x, y, 1) fitted to those kept for
        elapsed_s: tracks that have just started share this flow, and the noise of single tracks averages out in it."""
        tracks, height = self._tracks, self.calibration.height
        if len(kept.ids) < FEWEST_FOR_FLOW:
            return np.zeros((len(tracks.ids), 2))
        _, then, now = np.intersect1d(before.ids, kept.ids, assume_unique=True, return_indices=True)
        fit = fit_flow(kept.rays[now], (kept.rays[now] - before.rays[then]) / elapsed_s)
        late = (tracks.pixels[:, 1:] / (height - 1) - 0.5) * self.calibration.readout_s
        return np.asarray(late * (homogeneous(tracks.rays) @ fit), dtype=float)

    def repeats(self, pixels: NDArray[np.uint8]) -> bool:
        """Whether an image equals the last one bit for bit, which noise makes impossible for two exposures."""
        return self._taken is not None and np.array_equal(self._taken, pixels)

    def equalise(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Prepare an image (H, W, 3) RGB or (H, W) of another camera as for corner detection: (H, W) uint8."""
        return even_contrast(self._without_veil(pixels), self.settings)

    def _without_veil(self, pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
        grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        return without_veil(np.asarray(grey, dtype=np.uint8), self.settings)

    def _moved_px(self, before: FeatureTracks, R_before_now: Array) -> float:
        """Motion of the image, px: by the tracks or, if there are hardly any, by the gyroscope."""
        _, then, now = np.intersect1d(before.ids, self._tracks.ids, assume_unique=True, return_indices=True)
        if len(now) >= FEWEST_FOR_FLOW:
            return float(np.median(np.linalg.norm(self._tracks.pixels[now] - before.pixels[then], axis=1)))
        return self._focal * float(np.arccos(np.clip((np.trace(R_before_now) - 1) / 2, -1.0, 1.0)))

    def _follow(
        self,
        last: NDArray[np.uint8],
        image: NDArray[np.uint8],
        R_before_now: Array,
        elapsed_s: float,
        moved: Translation | None,
    ) -> FeatureTracks:
        """Track the last frame's corners into this one: Lucas-Kanade there and back, then the epipolar check."""
        settings, tracks = self.settings, self._tracks
        turned = homogeneous(tracks.rays) @ R_before_now  # where the rotation alone would take them
        still = distort(turned[:, :2] / np.maximum(turned[:, 2:], 0.1), self.calibration)
        guess, levels = still + self._flow.after(tracks.rays, elapsed_s), settings.flow_levels
        if self._flow.kept >= settings.steady_share and self._flow.error_px <= settings.steady_error_px:
            levels = min(settings.steady_levels, settings.flow_levels)
        end, good = self.find(last, image, tracks.pixels, guess, levels)
        if levels < settings.flow_levels and good.mean() < settings.steady_share / 2:  # a jerk, or the lamps went out
            end, good = self.find(last, image, tracks.pixels, still, settings.flow_levels)
        reached, kept = end[good], float(good.mean())
        self._flow = Flow.of(tracks.rays[good], reached - still[good], reached - guess[good], kept, elapsed_s)
        good[good] = self._rests(end[good])
        ids, before, now = tracks.ids[good], tracks.rays[good], end[good]
        rays = undistort(now, self.calibration)
        tolerance = settings.epipolar_error_px / self._focal
        if moved is not None:
            known = agree_with(moved, before, rays, R_before_now.T, tolerance, settings.motion_sigmas)
            ids, before, now, rays = ids[known], before[known], now[known], rays[known]
        keep = epipolar_inliers(before, rays, R_before_now.T, tolerance, settings.epipolar_trials, self._generator)
        return FeatureTracks(ids[keep], now[keep], rays[keep])

    def _replenish(self, image: NDArray[np.uint8]) -> FeatureTracks:
        """Add new corners if there are few tracks."""
        settings, tracks = self.settings, self._tracks
        # Detecting corners costs as much as tracking them: do so only when it pays.
        if settings.max_tracks - len(tracks.ids) < settings.max_tracks // 8:
            return tracks
        pixels = self.corners(image, tracks.pixels)
        pixels = pixels[self._rests(pixels)]
        ids = np.arange(self._next_id, self._next_id + len(pixels), dtype=np.int64)
        self._next_id += len(pixels)
        return FeatureTracks(
            np.concatenate([tracks.ids, ids]),
            np.concatenate([tracks.pixels, pixels]),
            np.concatenate([tracks.rays, undistort(pixels, self.calibration)]),
        )

    def _rests(self, pixels: Array) -> NDArray[np.bool_]:
        """Which of the pixels (N, 2) lie on nothing that moves."""
        if self._moving is None:
            return np.ones(len(pixels), dtype=bool)
        height, width = self._moving.shape
        x, y = np.clip(np.round(pixels).astype(int).T, 0, [[width - 1], [height - 1]])
        return np.asarray(~self._moving[y, x])


def follow(
    before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: Array, guess: Array, settings: FrontEndSettings
) -> tuple[Array, NDArray[np.bool_]]:
    """Track the patches at pixels (N, 2) of one image (H, W) or (H, W, C) into another by Lucas-Kanade, starting at
    guess (N, 2).

    Returns pixels (N, 2), and which of them (N,) track back to where they started and lie within the image.
    """
    start, begun = pixels.astype(np.float32), guess.astype(np.float32)
    size = (settings.flow_window_px, settings.flow_window_px)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    flow: dict[str, Any] = {"winSize": size, "maxLevel": settings.flow_levels, "criteria": criteria}
    flow["flags"] = cv2.OPTFLOW_USE_INITIAL_FLOW
    end, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start, begun.copy(), **flow)
    # Back from where the forward pass ended, guessed with the prediction's own error rather than with the answer.
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(after, before, end, end - (begun - start), **flow)
    height, width = after.shape[:2]
    good = (found.ravel() == 1) & (found_back.ravel() == 1)
    good &= np.linalg.norm(back - start, axis=1) < settings.backward_error_px
    good &= (end[:, 0] >= 1) & (end[:, 0] < width - 1) & (end[:, 1] >= 1) & (end[:, 1] < height - 1)
    return end.astype(np.float64), good


def find_corners(image: NDArray[np.uint8], taken: Array, settings: FrontEndSettings) -> Array:
    """Corners (N, 2) px in a grey image away from those `taken` (M, 2): the best by Shi & Tomasi (1994), spread out.

    Every cell of a grid has the same share of the tracks, so that one bright clump does not get them all: turbid water
    dims the far half of an image, and it is the far half that tells rotation from translation.
    """
    score = np.asarray(cv2.cornerMinEigenVal(image, settings.corner_block_px), dtype=np.float32)
    return spread_out(score, taken, settings)


def spread_out(score: NDArray[np.float32], taken: Array, settings: FrontEndSettings) -> Array:
    """Choose corners as `find_corners` does, by a score (H, W) that is higher where a track had better start."""
    height, width = score.shape
    spacing, border = round(settings.track_spacing_px), settings.flow_window_px // 2 + 1
    # A peak is the best corner within the track spacing: one dilation does what a sorted search would.
    peaks = score >= cv2.dilate(score, np.ones((2 * spacing + 1, 2 * spacing + 1), dtype=np.uint8))
    peaks &= score > settings.corner_quality * score.max()
    allowed = np.zeros(score.shape, dtype=np.uint8)
    allowed[border : height - border, border : width - border] = 1
    for x, y in taken:
        cv2.circle(allowed, (round(x), round(y)), spacing, 0, -1)
    y, x = np.divmod(np.flatnonzero(peaks & (allowed > 0)), width)  # np.nonzero takes ten times as long
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
