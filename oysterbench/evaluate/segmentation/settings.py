"""Settings of the mask evaluator."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.settings import EvaluatorSettings, edges, share

EVALUATOR = "segmentation 1"
"""Name and version of this evaluator; the version rises whenever a published number may change (docs/versions.md)."""


@dataclass(frozen=True)
class SegmentationSettings(EvaluatorSettings):
    """Settings for scoring masks.

    threshold:      minimum probability at which a pixel counts as oyster
    boundary_share: depth of a border as a share of the image's diagonal (Cheng et al. 2021: 0.02), at least one pixel
    range_m:        edges of the classes of range along the optical axis, if the truth has depth
    height_mm:      edges of the classes of true shell height, if the truth has each oyster's
    area_px:        edges of the classes of an oyster's visible area (COCO's: 32^2 and 96^2)
    """

    error = LabelError

    threshold: float = share(0.5, 1.0)
    boundary_share: float = share(0.02, 0.5)
    range_m: tuple[float, ...] = edges(0.6, 0.9, 1.2)
    height_mm: tuple[float, ...] = edges(60.0, 90.0, 120.0)
    area_px: tuple[float, ...] = edges(32.0**2, 96.0**2)


def class_names(edges: tuple[float, ...], unit: str) -> list[str]:
    """Names of the classes between edges, as used in keys: `below_0.6m`, `0.6to0.9m`, `from_0.9m`."""
    if not edges:
        return [f"any_{unit}"]
    between = [f"{low:g}to{high:g}{unit}" for low, high in pairwise(edges)]
    return [f"below_{edges[0]:g}{unit}", *between, f"from_{edges[-1]:g}{unit}"]
