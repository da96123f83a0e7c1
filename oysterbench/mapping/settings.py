"""Settings of maps of oysters. Units are in the names or the comments; a comment says why the value."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from oysterbench.core.errors import OysterbenchError

THRESHOLD_PER_M2, TARGET_PER_M2 = 15.0, 50.0
"""Live oysters per square metre of a restored reef, at least and as aimed at (Oyster Metrics Workgroup, 2011)."""

CLASSES = ("below threshold", "threshold", "target")
"""Classes of restoration: fewer than 15 live oysters per square metre, 15 to 50, and 50 or more."""


@dataclass(frozen=True)
class MapSettings:
    """All settings. Raises OysterbenchError where one makes no sense."""

    cell_m: float = 1.0  # edge of the grid's cells
    raster_m: float = 0.01  # edge of the squares by which cover is measured: its edge is half of one too far out
    least_cover: float = 0.25  # of a cell, below which it has no number

    # What of a picture is used.
    near_m: float = 0.2  # along the optical axis
    far_m: float = 2.5  # beyond, a shell of 8 cm has fewer than 15 pixels across, and is seen at a grazing angle
    least_px: int = 16  # of an oyster in a picture: of less, not even a person could say what it is
    border_px: int = 1  # along the picture's edge: an oyster that has one of these is cut by it
    threshold: float = 0.5  # of scores and probabilities

    # Association.
    shell_m: float = 0.006  # 1 sigma between points of one shell in two pictures: half of their distance, and rounding
    pose_sigma_m: float | None = None  # 1 sigma of a pose against the map; by default of its covariance, or 5 cm
    depth_sigma: float | None = None  # 1 sigma of the depth, of the distance; by default as it is made (`depth.SIGMA`)
    middle_m: float = 0.012  # 1 sigma of the middle of what a picture shows of a shell: something hides a part of it
    cut_m: float = 0.03  # the same of a shell that the picture's edge cuts
    size_sigma: float = 0.7  # 1 sigma of the logarithm of its area, as different pictures show it
    gate: float = 11.34  # squared Mahalanobis distance of what may be one: 99 % of three dimensions
    join_gate: float = 4.0  # the same for parts of one shell that were never seen side by side
    exact_m: float = 0.012  # of places surer than this, shells are distinguished by how far they overlap
    least_overlap: float = 0.4  # of the lesser of two shells, for them to be one
    join_overlap: float = 0.25  # the same of parts of one shell that were never seen side by side
    reach_m: float = 0.3  # between the middles of two views of one shell: more than any shell

    # Depth from pictures, the seabed as a plane.
    plane_s: float = 2.0  # echoes within so many seconds make the plane under a picture
    max_gap_s: float = 0.3  # between the poses that a picture's is taken from

    def __post_init__(self) -> None:
        for name in ("cell_m", "raster_m", "near_m", "shell_m", "reach_m", "plane_s"):
            if not getattr(self, name) > 0:
                raise OysterbenchError(f"{name}: expected more than 0, got {getattr(self, name):g}")
        for name in ("pose_sigma_m", "depth_sigma"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise OysterbenchError(f"{name}: expected 0 or more, got {value:g}")
        for name in ("least_cover", "least_overlap", "join_overlap", "threshold"):
            if not 0 < getattr(self, name) < 1:
                raise OysterbenchError(f"{name}: expected more than 0 and less than 1, got {getattr(self, name):g}")
        if not self.cell_m >= 5 * self.raster_m:
            raise OysterbenchError(f"cell_m: expected at least {5 * self.raster_m:g} m, got {self.cell_m:g} m")
        if not self.far_m > self.near_m:
            raise OysterbenchError(f"far_m: expected more than near_m, {self.near_m:g} m, got {self.far_m:g} m")

    def as_dict(self) -> dict[str, Any]:
        """For a record."""
        return asdict(self)
