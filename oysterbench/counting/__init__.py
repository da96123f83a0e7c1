"""Oysters in people's own pictures and videos: counts, cover and sizes, with a method of images."""

from oysterbench.counting.measure import OysterRow, PictureCount
from oysterbench.counting.reading import Sampling
from oysterbench.counting.run import Counted, Counting, Settings
from oysterbench.counting.sources import find_sources
from oysterbench.counting.store import Store
from oysterbench.counting.survey import Survey, survey

__all__ = [
    "Counted",
    "Counting",
    "OysterRow",
    "PictureCount",
    "Sampling",
    "Settings",
    "Store",
    "Survey",
    "find_sources",
    "survey",
]
