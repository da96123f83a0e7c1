"""The trivial methods of the image tracks: everything is oyster, nothing is, whatever differs in colour is."""

from oysterbench_baselines.threshold.method import All, Colour, ColourSettings, Nothing

__all__ = ["All", "Colour", "ColourSettings", "Nothing"]
