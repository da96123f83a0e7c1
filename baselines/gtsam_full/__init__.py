"""Visual-inertial odometry on GTSAM with DVL, depth and compass, which carries on where there is nothing to see."""

from oysterbench_baselines.gtsam_full.method import GtsamFull
from oysterbench_baselines.gtsam_full.settings import GtsamFullSettings

__all__ = ["GtsamFull", "GtsamFullSettings"]
