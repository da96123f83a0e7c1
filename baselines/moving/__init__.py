"""What moves in a picture: fish, crabs, plants that sway, a tether."""

from oysterbench_baselines.moving.mask import MovingMask, weights_digest

__all__ = ["MovingMask", "weights_digest"]
