"""Monocular visual-inertial odometry on GTSAM."""

from oysterbench_baselines.gtsam_vi.method import GtsamVi
from oysterbench_baselines.gtsam_vi.settings import Settings

__all__ = ["GtsamVi", "Settings"]
