"""The vehicle's path: the nominal path over the reef, the disturbances, and the exact motion that results."""

from oysterbench.scene.path.build import build_path
from oysterbench.scene.path.motion import Motion, Path, body_rates

__all__ = ["Motion", "Path", "body_rates", "build_path"]
