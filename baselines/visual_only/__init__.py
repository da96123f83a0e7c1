"""Plain visual odometry, monocular or stereo: the lower bar."""

from oysterbench_baselines.visual_only.method import VisualOnly
from oysterbench_baselines.visual_only.settings import VisualOnlySettings

__all__ = ["VisualOnly", "VisualOnlySettings"]
