"""What moves in a picture: fish, crabs, plants that sway, a tether."""

from oysterbench_baselines.moving.mask import MovingMask, mask_weights

__all__ = ["MovingMask", "mask_weights"]
