"""Settings of point clouds. Units are in the names or the comments; a comment gives the reason for a value."""

from __future__ import annotations

import math
from dataclasses import dataclass

from oysterbench.core.errors import OysterbenchError


@dataclass(frozen=True)
class CloudSettings:
    """Settings of a point cloud. Raises OysterbenchError where a length is not above 0, or not finite."""

    voxel_m: float = 0.01  # edge of the voxels, with one point each: a third of the smallest oyster
    near_m: float = 0.3  # along the optical axis, start of the search range
    far_m: float = 6.0  # beyond, a quarter of a pixel is half a metre

    # Depth from images.
    width_px: int = 320  # images are reduced to this width: 3 mm on the bottom at 1 m
    window_px: int = 7  # side of the patches that are correlated
    plane_px: float = 1.0  # shift of the farthest source from one plane of the sweep to the next
    max_planes: int = 192  # of 0.3 MB each
    noise_grey: float = 1.5  # 1 sigma of the pixels: patches with less texture than this correlate with nothing
    min_correlation: float = 0.7
    min_lead: float = 0.05  # of the best depth's correlation over that of any depth outside its peak
    step_share: float = 0.08  # distance that the camera moves between views, as a share of the scene's distance
    every: int = 2  # every n-th view gets depths; the views two before and two after it are its sources
    max_gap_s: float = 0.3  # between the poses that a view's pose is interpolated from
    agreement: float = 0.02  # relative distance within which an adjacent view must see the same point
    max_axes_deg: float = 30.0  # between the optical axes of a pair
    max_base_m: float = 1.0
    pair_tolerance_s: float = 0.002  # between the stamps of a pair

    # Depth from echoes.
    echo_far_m: float = math.inf  # ranges beyond are left out; by default, sensors give their own limit
    echo_share: float = 0.35  # level of the leading edge, as a share of the beam's strongest echo
    min_echo: float = 4.0  # strongest echo of a beam with a detection, as a multiple of the beam's median
    colour_every_s: float = 0.5  # interval of the frames that colour the echoes

    # Outliers.
    neighbours: int = 8
    max_spread: float = 2.0  # standard deviations of the mean distance to the neighbours

    def __post_init__(self) -> None:
        for name, unit in (("voxel_m", "m"), ("near_m", "m"), ("far_m", "m"), ("max_gap_s", "s")):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                expected = "a finite number" if value > 0 else f"more than 0 {unit}"
                raise OysterbenchError(f"{name}: expected {expected}, got {value:g}")
        if not self.echo_far_m > 0:
            raise OysterbenchError(f"echo_far_m: expected more than 0 m, got {self.echo_far_m:g}")
        if not self.far_m > self.near_m:
            raise OysterbenchError(f"far_m: expected more than near_m, {self.near_m:g} m, got {self.far_m:g}")
