"""U-Nets: where oysters are, and which."""

from oysterbench_baselines.unet.method import UNet, UNetInstances, UNetSmall, UNetSmallInstances

__all__ = ["UNet", "UNetInstances", "UNetSmall", "UNetSmallInstances"]
