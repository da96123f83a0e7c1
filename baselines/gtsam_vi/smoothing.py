"""The final smoothing: one adjustment of all keyframes, and the poses of all frames between them."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.bundle import Bundle, adjust
from oysterbench_baselines.gtsam_vi.covariance import about_odom, pose_covariances
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.pieces import Piecewise, adjust_piecewise, parts_of
from oysterbench_baselines.gtsam_vi.states import Frame, Keyframe, State, forward, read_state


@dataclass(frozen=True)
class Smoothed:
    """A smoothed path: the adjusted keyframes, and T_odom_imu (4, 4) of every frame. pieces: of a long path."""

    keyframes: list[Keyframe]
    bundle: Bundle
    poses: list[Array]
    pieces: Piecewise | None

    def covariances(self, lever: Array, model: Model) -> list[Array]:
        """Covariances (6, 6) of the pose of a frame fixed to the IMU at `lever` (3,), at every keyframe. Raises
        RuntimeError where they cannot be computed."""
        if self.pieces is None:
            return pose_covariances(self.bundle, self.keyframes, lever, model)
        times = model.rig.correlation(model.settings.noise.correlation)
        marginals = self.pieces.system(self.bundle.values, times).pose_covariances()
        return about_odom(marginals, self.bundle.values, self.keyframes, lever)


def smooth(model: Model, keyframes: list[Keyframe], frames: list[Frame]) -> Smoothed:
    """Adjust all keyframes at once, those of a long path piece by piece. Raises RuntimeError where they cannot be
    solved for."""
    settings = model.settings
    gate, views = settings.landmarks.max_error_px, settings.landmarks.min_views
    given, gates = [keyframe.estimate for keyframe in keyframes], (3 * gate, gate)
    parts = parts_of(len(keyframes), settings.smoothing.piece_keyframes)
    pieces = None
    if len(parts) == 1 and not any(keyframe.lost for keyframe in keyframes):
        bundle = adjust(model, keyframes, given, gates, views)
    else:
        bundle, pieces = adjust_piecewise(model, keyframes, given, gates, views, parts)
    model.rig.read(bundle.values)
    states = [model.at_stamp(keyframe, read_state(bundle.values, keyframe.index)) for keyframe in keyframes]
    return Smoothed(keyframes, bundle, between(model, keyframes, states, frames), pieces)


def between(model: Model, keyframes: list[Keyframe], states: list[State], frames: list[Frame]) -> list[Array]:
    """T_odom_imu (4, 4) of every frame from the states of the keyframes and the inertial measurements.

    What is missing at the end of an interval is spread evenly over it.
    """
    steps = zip(states, states[1:], keyframes[1:], strict=False)
    residuals = [_residual(model, before, after, keyframe.segment) for before, after, keyframe in steps]
    poses = []
    for frame in frames:
        pose = forward(states[frame.keyframe], frame.since, model.params).matrix
        if frame.keyframe < len(residuals):
            share = frame.since.duration / max(keyframes[frame.keyframe + 1].segment.duration, 1e-9)
            turn, shift = residuals[frame.keyframe]
            pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
            pose[:3, 3] += share * shift
        poses.append(pose)
    return poses


def _residual(model: Model, before: State, after: State, segment: Segment) -> tuple[Array, Array]:
    """Rotation vector (3,) and displacement (3,) m from the state propagated over a segment to the state after it."""
    reached, wanted = forward(before, segment, model.params).matrix, after.matrix
    return Rotation.from_matrix(reached[:3, :3].T @ wanted[:3, :3]).as_rotvec(), wanted[:3, 3] - reached[:3, 3]
