"""All that is known of a set of pictures: totals, means with intervals, warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oysterbench.counting.accuracy import Accuracy
from oysterbench.counting.doubts import doubts
from oysterbench.counting.intervals import BLOCK_S, Ratio, block_labels, likeness, ratio_of
from oysterbench.counting.least import EVERY_SIZE, Least
from oysterbench.counting.measure import PictureCount
from oysterbench.hub.model import Figure
from oysterbench.results.records import plain

PARTS = "connected parts of a mask, not separate oysters"
"""What is counted where a method gives only masks."""


@dataclass(frozen=True)
class Measure:
    """A mean over pictures. value and interval of `ratio` are in the unit."""

    key: str
    heading: str
    unit: str
    digits: int
    about: str
    ratio: Ratio


@dataclass(frozen=True)
class Survey:
    """title: what was counted; method: its name; measures: those of which something is known; neighbours: pictures that
    are a block, where that was given; alike: correlation of neighbouring blocks, NaN where they do not look alike;
    accuracy, figures: how far the method counts off on pictures that somebody labelled, where that is known; doubts: in
    all counts, a sentence each; at_least: size of what counts, in words, empty for any."""

    title: str
    method: str
    pictures: tuple[PictureCount, ...]
    failures: Mapping[str, str]
    measures: tuple[Measure, ...]
    neighbours: int | None
    alike: float
    accuracy: Accuracy | None = None
    figures: tuple[Figure, ...] = ()
    doubts: tuple[str, ...] = ()
    at_least: str = ""

    @property
    def unlike(self) -> list[PictureCount]:
        """Pictures that are warned of, the most unlike first."""
        return sorted((one for one in self.pictures if one.unlike), key=lambda one: -(one.novelty or 0.0))

    @property
    def novelty_known(self) -> bool:
        """Whether the method says of any picture how unlike it is."""
        return any(one.novelty is not None for one in self.pictures)

    @property
    def oysters(self) -> int:
        """Counted in all pictures, each picture anew."""
        return sum(one.oysters for one in self.pictures)

    @property
    def small(self) -> int:
        """Not counted, since they are too small."""
        return sum(one.small for one in self.pictures)

    @property
    def parts(self) -> bool:
        """Whether what is counted are connected parts of masks, and not separate oysters."""
        return any(one.parts for one in self.pictures)

    @property
    def area_m2(self) -> float:
        """Of what is counted, over all pictures; 0 without a scale."""
        return math.fsum(one.area_m2 or 0.0 for one in self.pictures)

    @property
    def block(self) -> str:
        """What was resampled, in words."""
        if self.neighbours is not None and self.neighbours > 1:
            return f"blocks of {self.neighbours} neighbours"
        if any(one.video for one in self.pictures) and self.neighbours is None:
            return f"blocks of {BLOCK_S:g} s" + ("" if all(one.video for one in self.pictures) else ", and images")
        return "images"

    def as_plain(self) -> dict[str, Any]:
        """For JSON; null where there is no number."""
        measures = {
            one.key: {
                "value": one.ratio.value,
                "unit": one.unit,
                "low": one.ratio.interval.low,
                "high": one.ratio.interval.high,
                "reason": one.ratio.interval.reason,
                "blocks": one.ratio.blocks,
            }
            for one in self.measures
        }
        accuracy = self.accuracy
        made: dict[str, Any] = plain(
            {
                "counted": self.title,
                "method": self.method,
                "pictures": len(self.pictures),
                "failures": dict(self.failures),
                "oysters": self.oysters,
                "counted_as": PARTS if self.parts else "separate oysters",
                "at_least": self.at_least or None,
                "too_small": self.small,
                "live": sum(one.live for one in self.pictures),
                "dead": sum(one.dead for one in self.pictures),
                "area_m2": self.area_m2 or None,
                "measures": measures,
                "resampled": self.block,
                "neighbours_alike": self.alike,
                "novelty_known": self.novelty_known,
                "unlike": [one.name for one in self.unlike],
                "warnings": list(self.doubts),
                "count_error_on_labelled_percent": None if accuracy is None else accuracy.percent,
            }
        )
        return made


def survey(
    title: str,
    method: str,
    pictures: Sequence[PictureCount],
    failures: Mapping[str, str],
    neighbours: int | None = None,
    accuracy: Accuracy | None = None,
    figures: Sequence[Figure] = (),
    scale: str = "",
    least: Least = EVERY_SIZE,
    copies: Sequence[tuple[str, str]] = (),
    quadrat_m2: float = math.nan,
) -> Survey:
    """Of pictures in the order of their names, and frames in that of their times. scale: its kind, empty for none;
    least: what they were counted with; copies, quadrat_m2: see `doubts`."""
    labels = block_labels(pictures, neighbours)
    noun = "image" if len(labels) == len(np.unique(labels)) else "block"

    def measure(
        key: str,
        heading: str,
        unit: str,
        digits: int,
        above: Callable[[PictureCount], float | None],
        below: Callable[[PictureCount], float] = lambda one: 1.0,
        about: str = "",
    ) -> Measure:
        return Measure(key, heading, unit, digits, about, ratio_of(pictures, labels, above, below, noun))

    measures = [
        measure("oysters", "Oysters per image", "", 1, lambda one: one.oysters, about="that count in an image"),
        measure("cover", "Cover", "%", 1, _percent_covered, about="share of an image, or quadrat, that is oyster"),
        measure(
            "live",
            "Alive",
            "%",
            1,
            lambda one: 100.0 * one.live,
            lambda one: one.live + one.dead,
            "of the oysters of which the method tells live from dead",
        ),
        measure(
            "per_m2",
            "Oysters per m\N{SUPERSCRIPT TWO}",
            "",
            1,
            lambda one: None if one.area_m2 is None else one.weighed,
            lambda one: one.area_m2 or 0.0,
            "all oysters over all ground; those "
            + ("whose centre is in a quadrat" if scale == "quadrat" else "that the edge of an image cuts count a half"),
        ),
        measure(
            "length_mm",
            "Length",
            "mm",
            0,
            lambda one: None if one.length_mm is None else one.length_mm * one.measured,
            lambda one: one.measured,
            "of the oysters that no edge of an image cuts: longer side of the smallest rectangle around each",
        ),
    ]
    known = tuple(one for one in measures if not math.isnan(one.ratio.value))
    alike = likeness([one.oysters for one in pictures], labels)
    length_mm = next((one.ratio.value for one in known if one.key == "length_mm"), math.nan)
    return Survey(
        title,
        method,
        tuple(pictures),
        dict(failures),
        known,
        neighbours,
        alike,
        accuracy,
        tuple(figures),
        tuple(doubts(method, pictures, length_mm, scale, copies, quadrat_m2)),
        least.described(any(one.parts for one in pictures), bool(scale)),
    )


def _percent_covered(one: PictureCount) -> float | None:
    return None if one.cover is None else 100.0 * one.cover
