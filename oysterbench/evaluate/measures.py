"""The numbers of an evaluation while they are gathered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Score:
    """Values by keys of a track's metrics; NaN where there is none, with the reason in `reasons`."""

    metrics: Mapping[str, float]
    reasons: Mapping[str, str]


@dataclass
class Measures:
    """Values by key, with the reason for each that is NaN, and what should be said about them."""

    values: dict[str, float] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __setitem__(self, key: str, value: float) -> None:
        self.values[key] = value

    def __getitem__(self, key: str) -> float:
        return self.values[key]

    def missing(self, reason: str, *keys: str) -> None:
        """Values that cannot be had."""
        for key in keys:
            self.values[key] = float("nan")
            self.reasons[key] = reason

    def ratio(self, key: str, top: float, bottom: float, reason: str) -> None:
        """top / bottom, or nothing for that reason where there is nothing below."""
        if bottom > 0:
            self.values[key] = top / bottom
        else:
            self.missing(reason, key)
