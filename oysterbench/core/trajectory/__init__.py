"""Trajectories, and the files they come in: TUM, EuRoC, KITTI, CSV, .npz, MCAP and ROS bags."""

from oysterbench.core.trajectory.options import ReadOptions
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.read import holds_kitti, read_trajectory
from oysterbench.core.trajectory.stamps import ns_to_seconds, seconds_to_ns, too_wide
from oysterbench.core.trajectory.text import read_times
from oysterbench.core.trajectory.write import write_npz, write_tum

__all__ = [
    "ReadOptions",
    "Trajectory",
    "holds_kitti",
    "ns_to_seconds",
    "read_times",
    "read_trajectory",
    "seconds_to_ns",
    "too_wide",
    "write_npz",
    "write_tum",
]
