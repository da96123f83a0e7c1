"""Maps of oysters: what pictures show, on the ground, each oyster once, per square metre."""

from oysterbench.density.depth import DEPTHS, default_depth
from oysterbench.density.predicted import KINDS, read_seen, true_seen
from oysterbench.density.projection import Seen
from oysterbench.density.settings import MapSettings
from oysterbench.density.survey import OysterMap, build_map

__all__ = [
    "DEPTHS",
    "KINDS",
    "MapSettings",
    "OysterMap",
    "Seen",
    "build_map",
    "default_depth",
    "read_seen",
    "true_seen",
]
