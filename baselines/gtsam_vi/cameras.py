"""The camera model: one or two cameras on a vehicle, as rays at depth 1 whose errors are expressed in pixels.

The front end converts pixels to rays with the given lens. Where lenses are calibrated online, their current estimates
are applied here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.gtsam_vi.calibration import CLOCK, CameraUncertainty, Optics, lens_key, mount_key
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import distort, undistort
from oysterbench_baselines.gtsam_vi.settings import LandmarkSettings, NoiseSettings

BLOCK = 50_000
"""Maximum number of views triangulated at once: 50 MB of matrices. Larger sets are halved by landmark."""


class CameraRig:
    """Projection, triangulation and reprojection errors.

    T_imu_cams (C, 4, 4): mounts of the C cameras, T_imu_cam (4, 4) that of the first; focal: px, of the first.
    clock_s: delay of the stamps. uncertainty: if given, the cameras are variables of the graph.
    """

    def __init__(
        self, cameras: list[CameraCalibration], imu: ImuCalibration, uncertainty: CameraUncertainty | None = None
    ) -> None:
        self.given, self.uncertainty = cameras, uncertainty
        self.focal = float(cameras[0].matrix[0, 0] + cameras[0].matrix[1, 1]) / 2
        self._given = [Optics.of(camera, invert(imu.T_base_imu)) for camera in cameras]
        # Rays at depth 1 are pixels of a camera with unit focal length.
        self._unit_camera = gtsam.Cal3_S2()
        self._set(self._given, 0.0)

    def _set(self, optics: list[Optics], clock_s: float) -> None:
        self._optics, self.clock_s = optics, clock_s
        self._lenses = [known.seen_by(camera) for known, camera in zip(optics, self.given, strict=True)]
        self.T_imu_cams = np.array([known.mount.matrix() for known in optics])
        self.T_imu_cam = self.T_imu_cams[0]

    # As variables of a graph.

    @property
    def clock_is_free(self) -> bool:
        """Whether the clock is a variable."""
        return self.uncertainty is not None and self.uncertainty.clock_sigma > 0

    def keys(self) -> list[int]:
        """Keys of the camera variables; none if cameras are not calibrated online."""
        if self.uncertainty is None:
            return []
        of_cameras = [key for c in range(len(self.given)) for key in (mount_key(c), lens_key(c))]
        return [*of_cameras, CLOCK] if self.clock_is_free else of_cameras

    def insert(self, values: gtsam.Values) -> None:
        """Insert the current camera estimates into values."""
        if self.uncertainty is None:
            return
        for c, optics in enumerate(self._optics):
            optics.insert(values, c)
        if self.clock_is_free:
            values.insert(CLOCK, np.array([self.clock_s]))

    def read(self, values: gtsam.Values) -> None:
        """Update the camera estimates from values."""
        if self.uncertainty is not None:
            optics = [optics.read(values, c) for c, optics in enumerate(self._optics)]
            self._set(optics, float(values.atVector(CLOCK)[0]) if self.clock_is_free else 0.0)

    def prior(self, settings: NoiseSettings) -> list[gtsam.NonlinearFactor]:
        """Prior factors of the camera variables."""
        return [] if self.uncertainty is None else self.uncertainty.prior(self._given, settings.views_alike)

    def _now(self, rays: Array, camera: int | NDArray[np.intp]) -> Array:
        """Convert rays (N, 2) from the given lens to the current lens estimate."""
        if self._optics is self._given:
            return rays
        found, cameras = np.array(rays, dtype=float), np.broadcast_to(camera, len(rays))
        for c, (given, lens) in enumerate(zip(self.given, self._lenses, strict=True)):
            own = cameras == c
            found[own] = undistort(distort(rays[own], given), lens)
        return found

    def pixel_noise(self, settings: NoiseSettings, inflation: float = 1.0) -> gtsam.noiseModel.Base:
        """Noise model of a landmark view, with `inflation` times the usual sigma."""
        sigma = inflation * settings.pixel_sigma_px / (self.focal if self.uncertainty is None else 1.0)
        noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
        return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(settings.huber), noise)

    def correlation(self, of_one: float) -> float:
        """Factor by which corner sigmas are inflated in a reported covariance, `of_one` being that of one camera: a
        second camera inherits the patch drift of the first."""
        return of_one * float(np.sqrt(len(self.T_imu_cams))) if of_one > 1.0 else 1.0

    def projection_factors(
        self,
        keyframes: Iterable[int],
        landmarks: Iterable[int],
        rays: Array,
        cameras: NDArray[np.intp],
        noises: Iterable[gtsam.noiseModel.Base],
    ) -> Iterator[gtsam.NonlinearFactor]:
        """Yield the factors of landmarks (N,) seen from keyframes (N,) along rays (N, 2) at depth 1 by cameras (N,),
        with noise models (N,).

        Behind the camera they have no gradient, and raise no error.
        """
        views = zip(keyframes, landmarks, cameras.tolist(), noises, strict=True)
        if self.uncertainty is None:
            for (keyframe, landmark, camera, noise), ray in zip(views, rays, strict=True):
                yield gtsam.GenericProjectionFactorCal3_S2(
                    ray, noise, X(keyframe), L(landmark), self._unit_camera, False, False, self._given[camera].mount
                )
            return
        pixels = np.empty((len(rays), 2))
        for c, given in enumerate(self.given):
            pixels[cameras == c] = distort(rays[cameras == c], given)
        for (keyframe, landmark, camera, noise), pixel in zip(views, pixels, strict=True):
            yield self._given[camera].factor(pixel, noise, X(keyframe), L(landmark), camera)

    def triangulate(
        self,
        track: NDArray[np.int64],
        rays: Array,
        T_odom_imu: Array,
        max_error_px: float,
        settings: LandmarkSettings,
        camera: NDArray[np.intp] | None = None,
    ) -> tuple[NDArray[np.int64], Array]:
        """Triangulate tracks; return ids (L,) and points (L, 3) of those that make good landmarks.

        track (M,), rays (M, 2), T_odom_imu (M, 4, 4) and camera (M,), the first by default: one row per view. A
        point minimises the distances from its rays, weighted by inverse depth; it must have parallax, lie in front of
        every view and project close to every ray.
        """
        if len(track) == 0:
            return track, np.empty((0, 3))
        if len(track) > BLOCK and (early := track < np.sort(track)[len(track) // 2]).any():
            halves = [
                self.triangulate(
                    track[own],
                    rays[own],
                    T_odom_imu[own],
                    max_error_px,
                    settings,
                    None if camera is None else camera[own],
                )
                for own in (early, ~early)
            ]
            return np.concatenate([ids for ids, _ in halves]), np.concatenate([points for _, points in halves])
        order = np.argsort(track, kind="stable")
        by = np.zeros(len(track), dtype=np.intp) if camera is None else camera[order]
        track, rays, cameras = track[order], self._now(rays[order], by), T_odom_imu[order] @ self.T_imu_cams[by]
        ids, starts, row = np.unique(track, return_index=True, return_inverse=True)
        directions = homogeneous(rays)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions = np.einsum("mij,mj->mi", cameras[:, :3, :3], directions)
        centres = cameras[:, :3, 3]
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        weight = np.ones(len(track))
        for _ in range(2):
            information = np.add.reduceat(across * weight[:, None, None], starts) + np.eye(3) * 1e-9
            right = np.add.reduceat((across @ centres[:, :, None])[..., 0] * weight[:, None], starts)
            points = np.linalg.solve(information, right[:, :, None])[..., 0]
            weight = 1.0 / np.maximum(np.einsum("mi,mi->m", points[row] - centres, directions), 0.1) ** 2
        local = np.einsum("mji,mj->mi", cameras[:, :3, :3], points[row] - centres)
        depth = local[:, 2]
        error = np.linalg.norm(local[:, :2] / np.maximum(depth, 1e-6)[:, None] - rays, axis=1) * self.focal
        good = _spread_deg(directions, starts, row) >= settings.min_ray_angle_deg
        good &= np.minimum.reduceat(depth, starts) > settings.min_depth_m
        good &= np.maximum.reduceat(depth, starts) < settings.max_depth_m
        good &= np.maximum.reduceat(error, starts) < max_error_px
        return ids[good], np.asarray(points[good], dtype=float)

    def spread_deg(self, track: NDArray[np.int64], rays: Array, R_odom_imu: Array, camera: NDArray[np.intp]) -> Array:
        """Largest angle (L,), degrees, between the first ray of each track and its others, without the camera's own
        rotation. track (M,), rays (M, 2), R_odom_imu (M, 3, 3) and camera (M,): one row per view, by track."""
        directions = homogeneous(self._now(rays, camera))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions = np.einsum("mij,mj->mi", R_odom_imu @ self.T_imu_cams[camera][:, :3, :3], directions)
        _, starts, row = np.unique(track, return_index=True, return_inverse=True)
        return _spread_deg(directions, starts, row)

    def errors_px(self, T_odom_imu: Array, points: Array, rays: Array, camera: int | NDArray[np.intp] = 0) -> Array:
        """Reprojection errors (N,) px of points (N, 3) seen along rays (N, 2) from poses (4, 4) or (N, 4, 4) by one
        camera, or one each (N,); infinite behind the camera."""
        cameras = invert(T_odom_imu @ self.T_imu_cams[camera])
        local = np.einsum("...ij,...j->...i", cameras[..., :3, :3], points) + cameras[..., :3, 3]
        seen = self._now(rays, camera)
        error = np.linalg.norm(local[:, :2] / np.maximum(local[:, 2:], 1e-6) - seen, axis=1) * self.focal
        return np.where(local[:, 2] > 0, error, np.inf)


def _spread_deg(directions: Array, starts: NDArray[np.intp], row: NDArray[np.intp]) -> Array:
    """Largest angle (L,), degrees, between the first direction of each track and its others (M, 3); starts (L,): its
    first row; row (M,): the track of each."""
    cosine = np.einsum("mi,mi->m", directions, directions[starts][row])
    return np.asarray(np.degrees(np.arccos(np.clip(np.minimum.reduceat(cosine, starts), -1, 1))), dtype=float)
