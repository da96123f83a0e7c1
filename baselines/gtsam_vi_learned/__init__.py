"""Visual-inertial odometry on GTSAM with a learned front end."""

from oysterbench_baselines.gtsam_vi_learned.method import GtsamViLearned
from oysterbench_baselines.gtsam_vi_learned.settings import GtsamViLearnedSettings

__all__ = ["GtsamViLearned", "GtsamViLearnedSettings"]
