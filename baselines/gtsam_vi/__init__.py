"""Visual-inertial odometry on GTSAM, with one camera or two."""

from oysterbench_baselines.gtsam_vi.method import GtsamVi, GtsamViStereo
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings

__all__ = ["GtsamVi", "GtsamViSettings", "GtsamViStereo"]
