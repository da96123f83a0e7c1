"""Building blocks of pages besides tables: plots in cards, with a legend, and images with a caption."""

from __future__ import annotations

import base64
from dataclasses import dataclass


@dataclass(frozen=True)
class Card:
    """A framed plot (an SVG element), with a sentence below it."""

    title: str
    svg: str
    caption: str = ""


@dataclass(frozen=True)
class PlotGroup:
    """Plots side by side below a heading. legend: labels and styles; points: whether they are drawn as points."""

    heading: str
    legend: tuple[tuple[str, int], ...]
    cards: tuple[Card, ...]
    points: bool = False


@dataclass(frozen=True)
class Picture:
    """A JPEG with its caption; small: the part of the caption in small type; about: alternative text."""

    jpeg: bytes
    caption: str
    small: str
    about: str

    @property
    def base64(self) -> str:
        """The JPEG in base64, for a data URL."""
        return base64.b64encode(self.jpeg).decode()
