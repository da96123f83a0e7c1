"""Things that move by themselves over a reef: fish, crabs, debris, the tether, and plants in the surge."""

from oysterbench.scene.life.life import Life, build_life, moving_classes
from oysterbench.scene.life.sway import Sway, build_sway

__all__ = ["Life", "Sway", "build_life", "build_sway", "moving_classes"]
