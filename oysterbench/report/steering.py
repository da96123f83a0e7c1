"""What the track steering shows besides the tables of every track: confusions over pictures, and dives from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from oysterbench.evaluate.steering import Commands, Labels, PictureScore, RolloutLog
from oysterbench.results.records import ResultRecord


@dataclass(frozen=True)
class PictureRun:
    """A method over the labelled pictures of a sequence; without labels, commands and score where it failed."""

    record: ResultRecord
    labels: Labels | None = None
    commands: Commands | None = None
    score: PictureScore | None = None

    @property
    def result(self) -> PictureScore | None:
        """What there is to draw."""
        return self.score


@dataclass(frozen=True)
class DiveRun:
    """A dive of a pilot over a reef; without a log where it failed."""

    record: ResultRecord
    log: RolloutLog | None = None

    @property
    def result(self) -> RolloutLog | None:
        """What there is to draw."""
        return self.log


@dataclass(frozen=True)
class Figure:
    """A figure of the report: heading, the figure as SVG, and a sentence below it."""

    title: str
    svg: str
    caption: str = ""


SHOWN_FIGURES = 40  # each is some 50 KB


def figures_section(figures: Sequence[Figure]) -> str:
    """Figures, each in a card."""
    parts = []
    for figure in figures[:SHOWN_FIGURES]:
        caption = f'<p class="small">{escape(figure.caption)}</p>' if figure.caption else ""
        parts.append(f'<div class="card"><h3>{escape(figure.title)}</h3>{figure.svg}{caption}</div>')
    if not parts:
        return ""
    left = len(figures) - SHOWN_FIGURES
    more = f'<p class="small">{left} more lie beside this page as PNG.</p>' if left > 0 else ""
    return f'<h2>Figures</h2><div class="stack">{"".join(parts)}</div>{more}'
