"""Steps of an adjustment along a path whose heading may be far off.

A path that was lost for a minute has drifted by tens of degrees when it is adjusted. A linear step turns its later
part by moving every pose along a tangent, which stretches it: millimetres between keyframes whose distance the inertial
measurements know to tenths, and the adjustment stalls. Here, what a step changes about heading turns all that it is the
heading of: displacement, velocity and landmarks of a keyframe. The rest is applied as it is; to first order, the two
are the same.
"""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array

Steps = Mapping[int, Array]
"""Step of each variable in its tangent, by key."""


def apply_steps(
    values: gtsam.Values, steps: Steps, keyframes: list[int], landmarks: NDArray[np.int64], seen: NDArray[np.intp]
) -> gtsam.Values:
    """Apply steps to values, and return the result.

    keyframes: indices (K,) along the path. landmarks (L,), and the positions `seen` (L,) in `keyframes` of those that
    saw them first.
    """
    moved = gtsam.Values(values)
    poses = [values.atPose3(X(k)) for k in keyframes]
    rotations = np.array([pose.rotation().matrix() for pose in poses])
    positions = np.array([pose.translation() for pose in poses])
    of_poses = np.array([steps[X(k)] for k in keyframes])
    tilts = np.einsum("kij,kj->ki", rotations, of_poses[:, :3])  # GTSAM's tangents are in the axes of the pose itself
    shifts = np.einsum("kij,kj->ki", rotations, of_poses[:, 3:])
    headings = np.zeros_like(tilts)
    headings[:, 2], tilts[:, 2] = tilts[:, 2], 0.0
    turns = Rotation.from_rotvec(headings)

    def turned(vectors: Array, changes: Array, at: slice | NDArray[np.intp]) -> Array:
        """Vectors (N, 3) with their changes, of which the share of the heading is applied as a turn."""
        return turns[at].apply(vectors + changes - np.cross(headings[at], vectors))

    every, between = slice(None), slice(None, -1)
    new_rotations = (turns * Rotation.from_rotvec(tilts) * Rotation.from_matrix(rotations)).as_matrix()
    legs = turned(np.diff(positions, axis=0), np.diff(shifts, axis=0), between)
    new_positions = positions[0] + shifts[0] + np.vstack([np.zeros(3), np.cumsum(legs, axis=0)])
    velocities = np.array([values.atVector(V(k)) for k in keyframes])
    new_velocities = turned(velocities, np.array([steps[V(k)] for k in keyframes]), every)
    for k, rotation, position, velocity in zip(keyframes, new_rotations, new_positions, new_velocities, strict=True):
        moved.update(X(k), gtsam.Pose3(gtsam.Rot3(rotation), position))
        moved.update(V(k), velocity)
        moved.update(B(k), values.atConstantBias(B(k)).retract(steps[B(k)]))
    if len(landmarks):
        points = np.array([values.atPoint3(L(i)) for i in landmarks.tolist()])
        offsets = np.array([steps[L(i)] for i in landmarks.tolist()]) - shifts[seen]
        new_points = new_positions[seen] + turned(points - positions[seen], offsets, seen)
        for i, point in zip(landmarks.tolist(), new_points, strict=True):
            moved.update(L(i), point)
    of_path = {key(k) for k in keyframes for key in (X, V, B)} | {L(i) for i in landmarks.tolist()}
    calibrations, of_calibrations = sorted(steps.keys() - of_path), gtsam.VectorValues()
    for key in calibrations:
        of_calibrations.insert(key, steps[key])
    moved.insert_or_assign(values.extract(calibrations).retract(of_calibrations))
    return moved
