"""Trajectories, and the files they come in: TUM, EuRoC, KITTI, CSV, .npz, MCAP and ROS bags."""

from oysterbench.trajectory.options import ReadOptions
from oysterbench.trajectory.poses import Trajectory
from oysterbench.trajectory.read import read_trajectory
from oysterbench.trajectory.stamps import ns_to_seconds, seconds_to_ns
from oysterbench.trajectory.text import read_times
from oysterbench.trajectory.write import write_npz, write_tum

__all__ = [
    "ReadOptions",
    "Trajectory",
    "ns_to_seconds",
    "read_times",
    "read_trajectory",
    "seconds_to_ns",
    "write_npz",
    "write_tum",
]
