"""Settings of clouds. Units are in the names or the comments; a comment says why the value."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import OysterbenchError


@dataclass(frozen=True)
class CloudSettings:
    """All settings. Raises OysterbenchError where a length is not above 0."""

    voxel_m: float = 0.01  # edge of the cubes that keep one point each: a third of the smallest oyster
    near_m: float = 0.3  # along the optical axis, of what is searched for
    far_m: float = 6.0  # beyond, a quarter of a pixel is half a metre

    # Depth from pictures.
    width_px: int = 320  # pictures are reduced to it: 3 mm on the bottom at 1 m
    window_px: int = 7  # side of the patches that are compared
    plane_px: float = 1.0  # shift of the farthest source from one plane of the sweep to the next
    max_planes: int = 192  # of 0.3 MB each
    noise_grey: float = 1.5  # 1 sigma of the pixels: patches with less texture than that correlate with nothing
    min_correlation: float = 0.7
    min_lead: float = 0.05  # of the best depth's correlation over that of any depth elsewhere
    step_share: float = 0.08  # of the scene's distance, that a camera moves from one view to the next
    every: int = 2  # views, of which one is given depths; those two before and after it are its sources
    max_gap_s: float = 0.3  # between the poses that a view's is taken from
    agreement: float = 0.02  # of the distance, within which the next view must see a point, too
    max_axes_deg: float = 30.0  # between two cameras that make a pair
    max_base_m: float = 1.0
    pair_tolerance_s: float = 0.002  # of the stamps of a pair

    # Depth from echoes.
    echo_share: float = 0.35  # of a beam's strongest echo, at which its leading edge is taken
    min_echo: float = 4.0  # of a beam's median: the strongest echo of a beam that hears something
    colour_every_s: float = 0.5  # frames that colour what was heard

    # Outliers.
    neighbours: int = 8
    max_spread: float = 2.0  # standard deviations of the mean distance to the neighbours

    def __post_init__(self) -> None:
        for name in ("voxel_m", "near_m"):
            if not getattr(self, name) > 0:
                raise OysterbenchError(f"{name}: expected more than 0 m, got {getattr(self, name):g}")
        if not self.far_m > self.near_m:
            raise OysterbenchError(f"far_m: expected more than near_m, {self.near_m:g} m, got {self.far_m:g}")
