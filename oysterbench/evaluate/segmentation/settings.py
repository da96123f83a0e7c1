"""The settings of the evaluator of masks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from oysterbench.core.errors import LabelError

EVALUATOR = "segmentation 1"
"""Name and version of this evaluator; the version rises whenever a number may change."""


@dataclass(frozen=True)
class SegmentationSettings:
    """How masks are scored.

    threshold:      a probability from which on a pixel is called oyster
    boundary_share: of the image's diagonal: how deep a border is (Cheng et al. 2021: 0.02), one pixel at least
    range_m:        edges of the classes of range along the optical axis, where the truth has depth
    height_mm:      edges of the classes of true shell height, where the truth knows each oyster
    area_px:        edges of the classes of an oyster's visible area (COCO's: 32^2 and 96^2)
    """

    threshold: float = 0.5
    boundary_share: float = 0.02
    range_m: tuple[float, ...] = (0.6, 0.9, 1.2)
    height_mm: tuple[float, ...] = (60.0, 90.0, 120.0)
    area_px: tuple[float, ...] = (32.0**2, 96.0**2)

    def __post_init__(self) -> None:
        for key, low, high in (("threshold", 0.0, 1.0), ("boundary_share", 0.0, 0.5)):
            value = getattr(self, key)
            if isinstance(value, bool) or not isinstance(value, int | float) or not low < value <= high:
                raise LabelError(
                    f"evaluator setting {key!r}: expected more than {low:g}, up to {high:g}, got {value!r}"
                )
        for key in ("range_m", "height_mm", "area_px"):
            edges = tuple(getattr(self, key))
            if not all(isinstance(e, int | float) and e > 0 for e in edges) or any(a >= b for a, b in pairwise(edges)):
                raise LabelError(f"evaluator setting {key!r}: expected rising numbers above 0, got {edges!r}")
            object.__setattr__(self, key, edges)

    def as_dict(self) -> dict[str, Any]:
        """The settings for JSON."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def class_names(edges: tuple[float, ...], unit: str) -> list[str]:
    """Names of the classes between edges, as they stand in keys: `below_0.6m`, `0.6to0.9m`, `from_0.9m`."""
    if not edges:
        return [f"any_{unit}"]
    between = [f"{low:g}to{high:g}{unit}" for low, high in pairwise(edges)]
    return [f"below_{edges[0]:g}{unit}", *between, f"from_{edges[-1]:g}{unit}"]
