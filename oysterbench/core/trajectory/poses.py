"""Trajectory: time-stamped poses of the body in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, interpolate_poses, poses_to_matrices


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Poses of the body in time, in a world frame: odom, an estimate's own; map, for ground truth.

    stamps_ns:   (N,) int64, nanoseconds
    positions:   (N, 3) float64, m, in the world frame
    quaternions: (N, 4) float64, x y z w, body to world
    covariances: (N, 6, 6) float64 or None; x y z (m) and rotations about x y z (rad), all about the fixed axes of the
                 world frame, as in geometry_msgs/PoseWithCovariance
    T_body_estimate: (4, 4), takes points of the estimated frame into the body: the poses were converted from that
                 frame, with its lever arm in metres (`poses_of_body`); None: the body's own were estimated
    notes:       decisions made in reading the file, in sentences; a scorer passes them on

    Nothing is checked or sorted here: `read_trajectory` names what is wrong in a file, `evaluate.validate` what is
    wrong with a trajectory.

    Examples
    --------
    >>> stamps_ns = np.array([0, 500_000_000, 1_000_000_000])
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    >>> Trajectory(stamps_ns, np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]), level)
    <Trajectory: 3 poses over 1 s and 2 m>
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions: Array
    covariances: Array | None = None
    notes: tuple[str, ...] = ()
    T_body_estimate: Array | None = None

    def __post_init__(self) -> None:
        for name in ("stamps_ns", "positions", "quaternions"):
            value = getattr(self, name)
            if not hasattr(value, "shape"):
                raise TrajectoryError(
                    f"{name}: expected a NumPy array, got {type(value).__name__}; numpy.array({name}) makes one"
                )
        n = len(self.stamps_ns)
        if self.positions.shape != (n, 3) or self.quaternions.shape != (n, 4):
            raise TrajectoryError(
                f"expected {n} positions (N, 3) and quaternions (N, 4), "
                f"got {self.positions.shape} and {self.quaternions.shape}"
            )
        if self.covariances is not None and self.covariances.shape != (n, 6, 6):
            raise TrajectoryError(f"expected {n} covariances (N, 6, 6), got {self.covariances.shape}")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        span_s = float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9 if len(self) else 0.0
        return f"<Trajectory: {len(self)} poses over {span_s:g} s and {self.path_length:.4g} m>"

    @property
    def path_length(self) -> float:
        """Sum of the distances between consecutive positions, m."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def matrices(self) -> Array:
        """(N, 4, 4) transforms from the body to the world frame."""
        return poses_to_matrices(self.positions, self.quaternions)

    def at(self, stamps_ns: NDArray[np.int64]) -> Trajectory:
        """Interpolated poses (lerp, slerp) at stamps within the time span; covariances are the nearest pose's."""
        stamps_ns = np.asarray(stamps_ns, dtype=np.int64)
        positions, quaternions = interpolate_poses(self.stamps_ns, self.positions, self.quaternions, stamps_ns)
        covariances = None if self.covariances is None else self.covariances[nearest_stamps(self.stamps_ns, stamps_ns)]
        return replace(self, stamps_ns=stamps_ns, positions=positions, quaternions=quaternions, covariances=covariances)

    def select(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Trajectory:
        """The poses at `index`."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[index],
            positions=self.positions[index],
            quaternions=self.quaternions[index],
            covariances=None if self.covariances is None else self.covariances[index],
        )


def nearest_stamps(stamps_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices (M,) of the increasing stamps (N,) that are nearest to the wanted ones (M,)."""
    after = np.clip(np.searchsorted(stamps_ns, wanted_ns), 1, max(len(stamps_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamps_ns) - 1)
    return np.where(wanted_ns - stamps_ns[before] <= stamps_ns[after] - wanted_ns, before, after)
