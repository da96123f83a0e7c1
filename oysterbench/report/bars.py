"""Histogram as inline SVG, in the style of the other plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from oysterbench.report.axes import Axis, nice_ticks
from oysterbench.report.plots import BOTTOM, INNER, LEFT, TOP, WIDTH

TALL = 190.0
MOST_BARS = 24


def count_bins(values: Sequence[float]) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], list[int]]:
    """Edges (B + 1,) of bins of equal integer width for counts (n,), and the number of counts in each bin."""
    most = int(max(values, default=0))
    rough = (most + 1) / MOST_BARS
    steps = (factor * 10**power for power in range(12) for factor in (1, 2, 5))
    width = next(step for step in steps if step >= rough)
    edges = np.arange(0, math.floor(most / width) * width + 2 * width, width, dtype=np.float64)
    return edges, np.histogram(np.asarray(values, dtype=float), edges)[0].tolist()


def histogram_plot(values: Sequence[float], title: str, x_label: str, y_label: str) -> str:
    """Plot a histogram of the counts (n,) of images."""
    edges, heights = count_bins(values)
    x_axis = Axis(float(edges[0]), float(edges[-1]), LEFT, LEFT + INNER)
    y_axis = Axis(0.0, 1.08 * max(heights), TOP + TALL, TOP, 40.0)
    bottom, right = TOP + TALL, LEFT + INNER
    parts = [
        f'<svg class="plot" viewBox="0 0 {WIDTH:.0f} {bottom + BOTTOM:.0f}" role="img" '
        f'aria-label="{escape(f"{title}. {x_label}, {y_label}.")}">'
    ]
    wide = float(edges[1] - edges[0])
    shown = nice_ticks(0.0, float(edges[-1]) - wide, 6) if edges[-1] > wide else [(0.0, "0")]
    for value, text in shown:
        # Below the middle of a bar for a single count; at the start of one for several.
        x = float(x_axis.place(value + 0.5 if wide == 1 else value))
        if float(value).is_integer():
            parts.append(f'<text x="{x:.1f}" y="{bottom + 17:.1f}" text-anchor="middle">{text}</text>')
    for value, text in y_axis.ticks():
        if float(value).is_integer():  # there are no fractions of images
            text, y = f"{value:.0f}", float(y_axis.place(value))
            parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
            parts.append(f'<text x="{LEFT - 7}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
    for low, high, height in zip(edges[:-1], edges[1:], heights, strict=True):
        left, end = float(x_axis.place(low)) + 1, float(x_axis.place(high)) - 1
        top = float(y_axis.place(height))
        if height:
            parts.append(
                f'<rect class="bar" x="{left:.1f}" y="{top:.1f}" width="{end - left:.1f}" '
                f'height="{bottom - top:.1f}"><title>{_span(low, high)}: {height}</title></rect>'
            )
    parts.append(f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{INNER}" height="{TALL:.1f}"/>')
    parts.append(f'<text class="axis" x="{LEFT}" y="{TOP - 11}">{escape(y_label)}</text>')
    parts.append(
        f'<text class="axis" x="{right}" y="{bottom + 37:.1f}" text-anchor="end">{escape(x_label)}</text></svg>'
    )
    return "".join(parts)


def _span(low: float, high: float) -> str:
    """Text for the counts from one edge up to the next."""
    return f"{low:.0f}" if high - low == 1 else f"{low:.0f} to {high - 1:.0f}"
