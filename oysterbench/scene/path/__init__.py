"""The vehicle's path: the nominal path over the reef, what pushes it off, and the exact motion that follows."""

from oysterbench.scene.path.build import build_path
from oysterbench.scene.path.motion import Motion, Path, body_rates

__all__ = ["Motion", "Path", "body_rates", "build_path"]
