"""Plots on pages: paths against ground truth, and errors, from the curves stored with records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from markupsafe import Markup

from oysterbench.core.geometry import Array
from oysterbench.report.plots import Curve, height_plot, map_plot, swatch, time_plot

AXES = ("x (east) [m]", "y (north) [m]", "z (up) [m]")
TIME = "time [s]"
MOST_SEQUENCES = 40
"""Maximum number of sequences drawn on one page."""


@dataclass(frozen=True)
class Path:
    """Path on a sequence. t_s: (N,) since the first stamp of the ground truth; truth, path: (N, 3) m, in `map`;
    error_m: (N,). path and error_m are NaN where there is no estimate."""

    t_s: Array
    truth: Array
    path: Array
    error_m: Array
    run: int


@dataclass(frozen=True)
class Card:
    """A plot, as SVG."""

    title: str
    plot: Markup


@dataclass(frozen=True)
class Drawing:
    """All plots of a sequence."""

    title: str
    about: str
    legend: Markup
    cards: tuple[Card, ...]


def drawings(documents: Mapping[str, Mapping[str, Any] | None]) -> list[Drawing]:
    """One drawing for each sequence of the first document; documents: label -> document (`curves.curves_document`).

    What cannot be drawn is left out: the numbers do not depend on it.
    """
    read = {label: paths(document) for label, document in documents.items() if document is not None}
    if not read:
        return []
    aligned = {str(document.get("align", "")) for document in documents.values() if document is not None}
    names = list(next(iter(read.values())))[:MOST_SEQUENCES]
    found = []
    for name in names:
        of_sequence = {label: several[name] for label, several in read.items() if name in several}
        found.append(_drawing(name, of_sequence, ", ".join(sorted(aligned))))
    return found


def paths(document: Mapping[str, Any]) -> dict[str, Path]:
    """Paths of a document by sequence, without malformed ones."""
    found = {}
    sequences = document.get("sequences")
    for name, values in sequences.items() if isinstance(sequences, Mapping) else ():
        try:
            t_s, truth = np.array(values["t_s"], float), np.array(values["truth"], float)
            path = np.array([(np.nan,) * 3 if point is None else point for point in values["path"]], float)
            error_m = np.array([np.nan if error is None else error for error in values["error_m"]], float)
            run = int(values["run"])
        except (KeyError, TypeError, ValueError):
            continue
        n = len(t_s)
        known = n > 1 and np.isfinite(t_s).all() and truth.shape == (n, 3) and np.isfinite(truth).all()
        if known and path.shape == (n, 3) and error_m.shape == (n,) and np.isfinite(error_m).any():
            found[str(name)] = Path(t_s, truth, path, error_m, run)
    return found


def _drawing(name: str, of: Mapping[str, Path], align: str) -> Drawing:
    first = next(iter(of.values()))
    span = (0.0, float(first.t_s[-1]))
    side = 0 if np.ptp(first.truth[:, 0]) >= np.ptp(first.truth[:, 1]) else 1

    def curves(i: int, j: int) -> list[Curve]:
        drawn = [Curve("truth", first.truth[:, i], first.truth[:, j], 0)]
        return drawn + [Curve(label, p.path[:, i], p.path[:, j], k) for k, (label, p) in enumerate(of.items(), 1)]

    heights = [Curve("truth", first.t_s, first.truth[:, 2], 0)]
    heights += [Curve(label, p.t_s, p.path[:, 2], k) for k, (label, p) in enumerate(of.items(), 1)]
    errors = [Curve(label, p.t_s, p.error_m, k) for k, (label, p) in enumerate(of.items(), 1)]
    cards = (
        ("Seen from above", map_plot(curves(0, 1), f"{name} from above", AXES[0], AXES[1], 250.0)),
        ("Position error over time", time_plot(errors, f"{name}, position error", TIME, "error [m]", span)),
        ("Seen from the side", map_plot(curves(side, 2), f"{name} from the side", AXES[side], AXES[2])),
        ("Height over time", height_plot(heights, f"{name}, height", TIME, AXES[2], span)),
    )
    runs = " and ".join(dict.fromkeys(str(p.run + 1) for p in of.values()))
    about = f"Run {runs}, shown where it has an estimate, aligned by {align or 'the evaluator'}, thinned."
    entries = [("truth", 0), *((label, k) for k, label in enumerate(of, 1))]
    # `plots` escapes its arguments; labels of the legend are escaped here.
    return Drawing(name, about, legend(entries), tuple(Card(title, Markup(plot)) for title, plot in cards))


def legend(entries: list[tuple[str, int]], truth: bool = True) -> Markup:
    """Legend of labels and their styles; truth: whether to explain the marks at the ends of the true path."""
    items = "".join(
        f'<li data-label="{escape(label)}">{swatch(style)}<span>{escape(label)}</span></li>' for label, style in entries
    )
    marks = '<li class="small">\N{WHITE CIRCLE} start, \N{WHITE SQUARE} end of the true path</li>' if truth else ""
    return Markup(f'<ul class="legend" aria-label="Legend">{items}{marks}</ul>')
