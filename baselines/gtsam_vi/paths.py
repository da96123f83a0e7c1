"""Paths of base_link from what is known of each frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench_baselines.gtsam_vi.states import Frame, Known


def known_then(frame: Frame) -> Known:
    """What was known of a frame at the frame; before the first start, at that start."""
    return frame.online or frame.known


def known_now(frame: Frame) -> Known:
    """What is known of a frame by now, without an adjustment of the whole path."""
    return frame.known


def path_of(frames: list[Frame], known: Callable[[Frame], Known], T_base_imu: Array) -> Trajectory:
    """T_odom_base at every frame by what is known of it, in the odom that loops had corrected by then."""
    poses, covariances = [], []
    for frame in frames:
        one, turn = known(frame), np.eye(4) if frame.correction is None else frame.correction
        poses.append(turn @ one.pose)
        if one.covariance is not None:
            both = np.kron(np.eye(2), turn[:3, :3])
            covariances.append(both @ one.covariance @ both.T)
    return trajectory_of(frames, poses, covariances, T_base_imu)


def trajectory_of(frames: list[Frame], poses: list[Array], covariances: list[Array], T_base_imu: Array) -> Trajectory:
    """T_odom_base at every frame from T_odom_imu (4, 4); with covariances (6, 6) where every frame has one."""
    stamps = np.array([frame.stamp_ns for frame in frames], dtype=np.int64)
    matrices = np.array(poses).reshape(-1, 4, 4) @ invert(T_base_imu)
    quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat() if len(poses) else np.empty((0, 4))
    spread = np.array(covariances) if len(poses) and len(covariances) == len(poses) else None
    return Trajectory(stamps, matrices[:, :3, 3].copy(), quaternions, spread)
