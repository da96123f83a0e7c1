"""Maps of a sequence along any of its trajectories: coloured point clouds, and oysters on the ground, each once."""

from oysterbench.mapping.build import SOURCES, build_cloud
from oysterbench.mapping.cloud import PointCloud
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.depth import DEPTHS, default_depth
from oysterbench.mapping.predicted import check_seen, read_seen, true_seen
from oysterbench.mapping.projection import Seen
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.survey import OysterMap, build_map

__all__ = [
    "DEPTHS",
    "SOURCES",
    "CloudSettings",
    "MapSettings",
    "OysterMap",
    "PointCloud",
    "Seen",
    "build_cloud",
    "build_map",
    "check_seen",
    "default_depth",
    "read_seen",
    "true_seen",
]
