"""Settings of the evaluator of single oysters."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.settings import EvaluatorSettings, is_number, setting, whole

EVALUATOR = "detection 2"
"""Name and version of this evaluator; the version rises whenever a published number may change (docs/versions.md)."""


@dataclass(frozen=True)
class DetectionSettings(EvaluatorSettings):
    """Settings for scoring instances.

    max_detections: how many detections of an image count towards precision and recall, the most confident ones
    threshold:      minimum score at which an instance is counted and enters panoptic quality
    """

    error = LabelError

    max_detections: int = whole(300, 1)
    threshold: float = setting(0.5, "a number", is_number)
