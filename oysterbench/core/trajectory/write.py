"""Writing trajectories to files: TUM for general use, .npz where covariances must be kept."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable

import numpy as np

from oysterbench.core.atomic import write_atomically
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.stamps import ns_to_seconds

HEADER = ("# timestamp_s x_m y_m z_m qx qy qz qw",)


def write_tum(path: str | os.PathLike[str], trajectory: Trajectory, header: Iterable[str] = HEADER) -> None:
    """Write `t x y z qx qy qz qw`, seconds with nine decimals, atomically, after the lines of a header, each with #."""
    rows = [*header]
    poses = np.column_stack([trajectory.positions, trajectory.quaternions]).tolist()
    for stamp, pose in zip(trajectory.stamps_ns.tolist(), poses, strict=True):
        rows.append(" ".join([ns_to_seconds(stamp), *(f"{value:.12g}" for value in pose)]))
    write_atomically(path, ("\n".join(rows) + "\n").encode())


def write_npz(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write the arrays `stamps_ns`, `positions`, `quaternions` bit for bit; `covariances`, `T_body_estimate` if any."""
    arrays = {
        "stamps_ns": trajectory.stamps_ns,
        "positions": trajectory.positions,
        "quaternions": trajectory.quaternions,
    }
    if trajectory.covariances is not None:
        arrays["covariances"] = trajectory.covariances
    if trajectory.T_body_estimate is not None:
        arrays["T_body_estimate"] = trajectory.T_body_estimate
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write_atomically(path, buffer.getvalue())
