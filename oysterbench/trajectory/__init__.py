"""Trajectories, and the files they come in: TUM, EuRoC, KITTI, CSV, .npz, MCAP and ROS bags."""

from oysterbench.trajectory.poses import Trajectory
from oysterbench.trajectory.text import ns_to_seconds, read_trajectory, seconds_to_ns, write_tum

__all__ = ["Trajectory", "ns_to_seconds", "read_trajectory", "seconds_to_ns", "write_tum"]
