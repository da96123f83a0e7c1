"""The trivial rows of the tracks of images: everything is oyster, nothing is, what has the colour of one is."""

from oysterbench_baselines.threshold.method import All, Colour, ColourSettings, Nothing

__all__ = ["All", "Colour", "ColourSettings", "Nothing"]
