"""A small U-Net: where oysters are, and which."""

from oysterbench_baselines.unet.method import UNet, UNetInstances

__all__ = ["UNet", "UNetInstances"]
