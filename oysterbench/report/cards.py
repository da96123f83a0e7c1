"""What pages are put together from besides tables: plots in cards, with a legend, and pictures with a caption."""

from __future__ import annotations

import base64
from dataclasses import dataclass


@dataclass(frozen=True)
class Card:
    """A plot (an SVG element) in its frame, with a sentence below it."""

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
    """A JPEG with its caption; small: what stands less large in it; about: for those who do not see it."""

    jpeg: bytes
    caption: str
    small: str
    about: str

    @property
    def base64(self) -> str:
        """For an address of data."""
        return base64.b64encode(self.jpeg).decode()
