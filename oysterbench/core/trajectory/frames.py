"""Conversion of poses of another frame or in another unit to poses of the body in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from oysterbench.core.geometry import Array, invert, transform
from oysterbench.core.trajectory.poses import Trajectory

ROTATION_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Body x forward, y left, z up; optical x right, y down, z forward (REP 103)."""

METRES = {"m": 1.0, "mm": 1e-3}
"""Length unit -> its length in m."""

T_BODY_OPTICAL = transform(ROTATION_BODY_OPTICAL, np.zeros(3))


def poses_of_body(trajectory: Trajectory, T_body_estimate: Array) -> Trajectory:
    """Poses of the body from poses of a frame fixed to it: T_map_body = T_map_estimate T_body_estimate^-1.

    T_body_estimate (4, 4), m, is kept with the poses, as `with_scale` needs it. The lever arm l = R_map_estimate
    t_estimate_body propagates the attitude error to the position: with rotations d about the world's axes, dp_body =
    dp - [l]x d.
    """
    T_estimate_body = invert(T_body_estimate)
    earlier = trajectory.T_body_estimate
    rotations = scipy.spatial.transform.Rotation.from_quat(trajectory.quaternions)
    levers = rotations.apply(T_estimate_body[:3, 3])
    covariances = trajectory.covariances
    if covariances is not None:
        jacobian = np.tile(np.eye(6), (len(trajectory), 1, 1))
        x, y, z = levers.T
        zero = np.zeros_like(x)
        jacobian[:, :3, 3:] = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).transpose(2, 0, 1)
        covariances = jacobian @ covariances @ jacobian.transpose(0, 2, 1)
    return replace(
        trajectory,
        positions=trajectory.positions + levers,
        quaternions=(rotations * scipy.spatial.transform.Rotation.from_matrix(T_estimate_body[:3, :3])).as_quat(),
        covariances=covariances,
        T_body_estimate=T_body_estimate if earlier is None else T_body_estimate @ earlier,
    )


def poses_of_frame(trajectory: Trajectory, T_body_frame: Array | None) -> Trajectory:
    """Poses of a frame fixed to the body, from those of the body; None: the body's own frame."""
    return trajectory if T_body_frame is None else poses_of_body(trajectory, invert(T_body_frame))


def with_scale(trajectory: Trajectory, scale: float) -> Trajectory:
    """Poses of the body for an estimated path in a unit of `scale` m; the result stays in that unit.

    The lever arm from the estimated frame was applied in metres, which is wrong in a world of another scale.
    """
    T = trajectory.T_body_estimate
    if T is None or scale == 1.0:
        return trajectory
    return poses_of_body(poses_of_frame(trajectory, T), transform(T[:3, :3], T[:3, 3] / scale))


def inverted(trajectory: Trajectory) -> Trajectory:
    """Poses T_world_body from T_body_world, or the other way round: R^T, -R^T t.

    Covariances are left out, with a note: they are about axes that are no longer the world's.
    """
    rotations = scipy.spatial.transform.Rotation.from_quat(trajectory.quaternions).inv()
    notes = trajectory.notes
    if trajectory.covariances is not None:
        notes = (*notes, "the covariances are left out: they are those of inverted poses")
    return replace(
        trajectory,
        positions=-rotations.apply(trajectory.positions),
        quaternions=rotations.as_quat(),
        covariances=None,
        notes=notes,
    )


def scaled(trajectory: Trajectory, factor: float) -> Trajectory:
    """Multiply the positions of a trajectory by a factor, and scale their covariances accordingly."""
    covariances = trajectory.covariances
    if covariances is not None:
        scale = np.array([factor] * 3 + [1.0] * 3)
        covariances = covariances * np.outer(scale, scale)
    return replace(trajectory, positions=trajectory.positions * factor, covariances=covariances)
