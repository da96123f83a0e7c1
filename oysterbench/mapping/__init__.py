"""Coloured point clouds of what a sequence shows, along any trajectory of it."""

from oysterbench.mapping.build import SOURCES, build_cloud
from oysterbench.mapping.cloud import PointCloud
from oysterbench.mapping.settings import CloudSettings

__all__ = ["SOURCES", "CloudSettings", "PointCloud", "build_cloud"]
