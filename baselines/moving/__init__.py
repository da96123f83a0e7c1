"""Detection of what moves in an image: fish, crabs, swaying plants, a tether."""

from oysterbench_baselines.moving.mask import MovingMask, mask_weights

__all__ = ["MovingMask", "mask_weights"]
