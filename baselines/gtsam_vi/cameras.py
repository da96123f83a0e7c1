"""The camera model: one camera or two on a vehicle, as rays at depth 1 whose errors are counted in pixels."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.gtsam_vi.frontend import homogeneous
from oysterbench_baselines.gtsam_vi.settings import LandmarkSettings, NoiseSettings


class CameraRig:
    """Projection, triangulation and reprojection errors; the front end has dealt with distortion.

    T_imu_cams (C, 4, 4): mounts of the C cameras, T_imu_cam (4, 4) that of the first; focal: px, of the first.
    """

    def __init__(self, cameras: list[CameraCalibration], imu: ImuCalibration) -> None:
        self.calibration = cameras[0]
        self.focal = float(cameras[0].matrix[0, 0] + cameras[0].matrix[1, 1]) / 2
        self.T_imu_cams = np.array([invert(imu.T_base_imu) @ camera.T_base_cam for camera in cameras])
        self.T_imu_cam = self.T_imu_cams[0]
        # Rays at depth 1 are pixels of a camera with unit focal length.
        self._unit_camera = gtsam.Cal3_S2()
        self._mounts = [gtsam.Pose3(T_imu_cam) for T_imu_cam in self.T_imu_cams]

    def pixel_noise(self, settings: NoiseSettings, inflation: float = 1.0) -> gtsam.noiseModel.Base:
        """Of a ray at depth 1, its sigma `inflation` times the usual one."""
        noise = gtsam.noiseModel.Isotropic.Sigma(2, inflation * settings.pixel_sigma_px / self.focal)
        return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(settings.huber), noise)

    def correlation(self, of_one: float) -> float:
        """By how much sigmas of corners are inflated in a reported covariance, `of_one` being that of one camera: a
        second one takes over what the patches of the first have drifted."""
        return of_one * float(np.sqrt(len(self.T_imu_cams))) if of_one > 1.0 else 1.0

    def projection_factor(
        self, keyframe: int, landmark: int, ray: Array, camera: int, noise: gtsam.noiseModel.Base
    ) -> gtsam.NonlinearFactor:
        """A landmark seen along `ray` (2,) at depth 1. Behind the camera it has no gradient, and raises nothing."""
        return gtsam.GenericProjectionFactorCal3_S2(
            ray, noise, X(keyframe), L(landmark), self._unit_camera, False, False, self._mounts[camera]
        )

    def triangulate(
        self,
        track: NDArray[np.int64],
        rays: Array,
        T_odom_imu: Array,
        max_error_px: float,
        settings: LandmarkSettings,
        camera: NDArray[np.intp] | None = None,
    ) -> tuple[NDArray[np.int64], Array]:
        """Ids (L,) and points (L, 3) of the tracks that make good landmarks.

        track (M,), rays (M, 2), T_odom_imu (M, 4, 4) and camera (M,), the first by default: one row a view. The point
        minimises the distances from its rays, weighted by inverse depth; it must have parallax, lie before every view
        and project near every ray.
        """
        order = np.argsort(track, kind="stable")
        T_imu_cams = self.T_imu_cam if camera is None else self.T_imu_cams[camera[order]]
        track, rays, cameras = track[order], rays[order], T_odom_imu[order] @ T_imu_cams
        if len(track) == 0:
            return track, np.empty((0, 3))
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
        angle = np.degrees(np.arccos(np.clip(np.einsum("mi,mi->m", directions, directions[starts][row]), -1, 1)))
        good = np.maximum.reduceat(angle, starts) >= settings.min_ray_angle_deg
        good &= np.minimum.reduceat(depth, starts) > settings.min_depth_m
        good &= np.maximum.reduceat(depth, starts) < settings.max_depth_m
        good &= np.maximum.reduceat(error, starts) < max_error_px
        return ids[good], np.asarray(points[good], dtype=float)

    def errors_px(self, T_odom_imu: Array, points: Array, rays: Array, camera: int | NDArray[np.intp] = 0) -> Array:
        """Reprojection errors (N,) px of points (N, 3) seen along rays (N, 2) from poses (4, 4) or (N, 4, 4) by a
        camera, or one each (N,)."""
        cameras = invert(T_odom_imu @ self.T_imu_cams[camera])
        local = np.einsum("...ij,...j->...i", cameras[..., :3, :3], points) + cameras[..., :3, 3]
        error = np.linalg.norm(local[:, :2] / np.maximum(local[:, 2:], 1e-6) - rays, axis=1) * self.focal
        return np.where(local[:, 2] > 0, error, np.inf)
