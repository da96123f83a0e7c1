"""U-Nets for the segmentation and the detection of oysters."""

from oysterbench_baselines.unet.method import UNet, UNetInstances, UNetSmall, UNetSmallInstances

__all__ = ["UNet", "UNetInstances", "UNetSmall", "UNetSmallInstances"]
