"""Settings of oyster maps. Units are in the names or the comments; a comment gives the reason for a value."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from oysterbench.core.errors import OysterbenchError


@dataclass(frozen=True)
class MapSettings:
    """Settings of an oyster map. Raises OysterbenchError where one is invalid."""

    cell_m: float = 1.0  # edge of the grid's cells
    raster_m: float = 0.01  # edge of the squares that measure cover, whose border is half a square too far out
    least_cover: float = 0.25  # share of a cell that must be seen for it to have a value

    # Which part of an image is used.
    near_m: float = 0.2  # along the optical axis
    far_m: float = 2.5  # beyond, an 8 cm shell is less than 15 pixels wide, and is seen at a grazing angle
    least_px: int = 16  # of an oyster in an image: smaller ones could not be recognised even by a person
    border_px: int = 1  # margin along the image edge: an oyster that reaches into it counts as cut
    threshold: float = 0.5  # on scores and probabilities

    # Association.
    shell_m: float = 0.006  # 1 sigma between points of one shell in two images: half the point spacing, and rounding
    pose_sigma_m: float | None = None  # 1 sigma of a pose relative to the map; by default from its covariance, or 5 cm
    depth_sigma: float | None = None  # 1 sigma of the depth, relative; by default that of its source (`depth.SIGMA`)
    middle_m: float = 0.012  # 1 sigma of the centre of a shell as an image shows it, as part of it may be hidden
    cut_m: float = 0.03  # the same for a shell cut by the image edge
    size_sigma: float = 0.7  # 1 sigma of the logarithm of its area between images
    gate: float = 11.34  # squared Mahalanobis distance for a match, of centre and size: 98 % of those of one shell
    join_gate: float = 4.0  # the same for joining parts of one shell that were never seen side by side
    exact_m: float = 0.012  # where positions are more certain than this, shells are told apart by their overlap
    least_overlap: float = 0.4  # share of the smaller of two shells, for a match
    join_overlap: float = 0.25  # the same for joining parts of one shell that were never seen side by side
    reach_m: float = 0.3  # between the centres of two views of one shell: larger than any shell

    # Depth from images, or from a plane as the seabed.
    plane_s: float = 2.0  # the plane under an image is fitted to echoes within this time of it
    max_gap_s: float = 0.3  # between the poses that an image's pose is interpolated from

    def __post_init__(self) -> None:
        for name in ("cell_m", "raster_m", "near_m", "shell_m", "reach_m", "plane_s", "max_gap_s", "far_m"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                expected = "a finite number" if value > 0 else "more than 0"
                raise OysterbenchError(f"{name}: expected {expected}, got {value:g}")
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
        """The settings as a dictionary, for a record."""
        return asdict(self)
