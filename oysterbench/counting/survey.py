"""Results over a set of images: totals, means with intervals, warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oysterbench.counting.accuracy import Accuracy
from oysterbench.counting.doubts import doubts
from oysterbench.counting.intervals import (
    BLOCK_S,
    OF_COUNTS,
    OF_PERCENT,
    Exact,
    Ratio,
    block_labels,
    likeness,
    ratio_of,
)
from oysterbench.counting.least import EVERY_SIZE, Least
from oysterbench.counting.measure import PictureCount
from oysterbench.hub.model import Figure
from oysterbench.results.records import plain

PARTS = "connected parts of a mask, not separate oysters"
"""Description of what is counted if a method gives only masks."""

WHOLE_IMAGES = (
    "the check counts whole images, this count only quadrats: oysters outside the quadrats that are not labelled count "
    "as too many in the error on labelled images"
)
"""Warning about an error that was measured over other oysters than those counted."""


@dataclass(frozen=True)
class Measure:
    """A mean over images. Value and interval of `ratio` are in `unit`."""

    key: str
    heading: str
    unit: str
    digits: int
    about: str
    ratio: Ratio


@dataclass(frozen=True)
class Survey:
    """Results of a survey. title: what was counted; method: its name; measures: those with a value; neighbours: number
    of images in a block, if given; alike: correlation of neighbouring blocks, NaN if they are not correlated; accuracy,
    figures: counting error of the method on labelled images, if known; doubts: warnings about all counts, a sentence
    each; at_least: minimum size of what counts, in words, empty for none."""

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
        """Images unlike the training data, the most unlike first."""
        return sorted((one for one in self.pictures if one.unlike), key=lambda one: -(one.novelty or 0.0))

    @property
    def novelty_known(self) -> bool:
        """Whether the method gives a novelty for any image."""
        return any(one.novelty is not None for one in self.pictures)

    @property
    def oysters(self) -> int:
        """Number of oysters over all images, each image counted separately."""
        return sum(one.oysters for one in self.pictures)

    @property
    def small(self) -> int:
        """Number of oysters that are not counted, since they are too small."""
        return sum(one.small for one in self.pictures)

    @property
    def parts(self) -> bool:
        """Whether connected parts of masks are counted, and not separate oysters."""
        return any(one.parts for one in self.pictures)

    @property
    def tells_state(self) -> bool:
        """Whether the method tells live from dead for any oyster."""
        return any(one.live or one.dead for one in self.pictures)

    @property
    def area_m2(self) -> float:
        """Area of the counted regions over all images, m^2; 0 without a scale."""
        return math.fsum(one.area_m2 or 0.0 for one in self.pictures)

    @property
    def block(self) -> str:
        """Description of what was resampled, in words."""
        if self.neighbours is not None and self.neighbours > 1:
            return f"blocks of {self.neighbours} neighbours"
        if any(one.video for one in self.pictures) and self.neighbours is None:
            return f"blocks of {BLOCK_S:g} s" + ("" if all(one.video for one in self.pictures) else ", and images")
        return "images"

    def as_plain(self) -> dict[str, Any]:
        """Return the survey as a JSON-compatible dict; null where there is no number."""
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
                "images": len(self.pictures),
                "failures": dict(self.failures),
                "oysters": self.oysters,
                "counted_as": PARTS if self.parts else "separate oysters",
                "at_least": self.at_least or None,
                "too_small": self.small,
                "live": sum(one.live for one in self.pictures) if self.tells_state else None,
                "dead": sum(one.dead for one in self.pictures) if self.tells_state else None,
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
    rendered: bool = False,
) -> Survey:
    """Summarise counts of images, in the order of their names, and frames, in that of their times. scale: its kind,
    empty for none; least: minimum size that was used; copies, quadrat_m2, rendered: see `doubts`, to which the last
    goes unless `accuracy` tells of such images."""
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
        exact: Exact | None = None,
    ) -> Measure:
        return Measure(key, heading, unit, digits, about, ratio_of(pictures, labels, above, below, noun, exact))

    measures = [
        measure(
            "oysters",
            "Oysters per image",
            "",
            1,
            lambda one: one.oysters,
            about="oysters counted in an image",
            exact=OF_COUNTS,
        ),
        measure("cover", "Cover", "%", 1, _percent_covered, about="share of an image, or quadrat, that is oyster"),
        measure(
            "live",
            "Alive",
            "%",
            1,
            lambda one: 100.0 * one.live,
            lambda one: one.live + one.dead,
            "of the oysters of which the method tells live from dead",
            exact=OF_PERCENT,
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
            exact=OF_COUNTS,
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
    unchecked = rendered and not (accuracy is not None and accuracy.tells)
    warnings = list(doubts(method, pictures, length_mm, scale, copies, quadrat_m2, unchecked))
    if accuracy is not None and scale == "quadrat":
        warnings.append(WHOLE_IMAGES)
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
        tuple(warnings),
        least.described(any(one.parts for one in pictures), bool(scale)),
    )


def _percent_covered(one: PictureCount) -> float | None:
    return None if one.cover is None else 100.0 * one.cover
