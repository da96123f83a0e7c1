"""Containers for the values of an evaluation, finished or still being collected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Score:
    """Values by metric key of a track; NaN where a metric has no value, with the reason in `reasons`."""

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]


@dataclass
class Measures:
    """Values by key, the reason for each value that is NaN, and notes for the reader."""

    values: dict[str, float] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __setitem__(self, key: str, value: float) -> None:
        self.values[key] = value

    def __getitem__(self, key: str) -> float:
        return self.values[key]

    def missing(self, reason: str, *keys: str) -> None:
        """Set values that cannot be computed to NaN, and record the reason."""
        for key in keys:
            self.values[key] = float("nan")
            self.reasons[key] = reason

    def ratio(self, key: str, top: float, bottom: float, reason: str) -> None:
        """Set a value to top / bottom, or to NaN with the given reason unless bottom is positive."""
        if bottom > 0:
            self.values[key] = top / bottom
        else:
            self.missing(reason, key)
