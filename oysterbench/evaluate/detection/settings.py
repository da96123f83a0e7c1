"""The settings of the evaluator of single oysters."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from oysterbench.core.errors import LabelError

EVALUATOR = "detection 1"
"""Name and version of this evaluator; the version rises whenever a number may change."""


@dataclass(frozen=True)
class DetectionSettings:
    """How instances are scored.

    max_detections: of an image that count towards precision and recall, the surest ones
    threshold:      score from which on an instance is counted, and takes part in panoptic quality
    """

    max_detections: int = 300
    threshold: float = 0.5

    def __post_init__(self) -> None:
        if not isinstance(self.max_detections, int) or isinstance(self.max_detections, bool) or self.max_detections < 1:
            raise LabelError(
                f"evaluator setting 'max_detections': expected a whole number from 1, got {self.max_detections!r}"
            )
        if (
            isinstance(self.threshold, bool)
            or not isinstance(self.threshold, int | float)
            or self.threshold != (self.threshold)
        ):
            raise LabelError(f"evaluator setting 'threshold': expected a number, got {self.threshold!r}")

    def as_dict(self) -> dict[str, Any]:
        """The settings for JSON."""
        return asdict(self)
