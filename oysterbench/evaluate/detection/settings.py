"""The settings of the evaluator of single oysters."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.settings import EvaluatorSettings, is_number, setting, whole

EVALUATOR = "detection 1"
"""Name and version of this evaluator; the version rises whenever a number may change."""


@dataclass(frozen=True)
class DetectionSettings(EvaluatorSettings):
    """How instances are scored.

    max_detections: of an image that count towards precision and recall, the surest ones
    threshold:      score from which on an instance is counted, and takes part in panoptic quality
    """

    error = LabelError

    max_detections: int = whole(300, 1)
    threshold: float = setting(0.5, "a number", is_number)
