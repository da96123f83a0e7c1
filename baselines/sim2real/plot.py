"""The plot: IoU over the number of real images, a curve with intervals for each variant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from oysterbench.report.plots import BOTTOM, TOP, Axis, swatch
from oysterbench_baselines.sim2real.settings import REAL
from oysterbench_baselines.sim2real.table import Row

WIDTH, HEIGHT, LEFT, RIGHT = 880.0, 340.0, 56.0, 110.0
"""Units of the drawing, and of what surrounds its axes; on the right there is room for names of level lines."""
STYLES = 8  # that the page has
APART = 5.0  # units between the intervals of two variants, which would hide each other


def plot(rows: Sequence[Row]) -> str:
    """IoU over the number of real images, as SVG and a legend.

    A curve of real + synthetic images begins, without any real ones, at the synthetic images alone. What nothing was
    learnt for is a level line with its name, where it is high enough to be seen.
    """
    curves = curves_of(rows)
    sizes = sorted({row.images for group in curves.values() for row in group if row.size is not None})
    if not sizes:
        return "<p>No training with real images is finished yet.</p>"
    x_axis = _numbers(sizes)
    trained = [row for group in curves.values() for row in group]
    ends = [
        value for row in trained for value in (row.iou, row.interval.low, row.interval.high) if math.isfinite(value)
    ]
    low, high = max(0.0, min(ends) - 0.02), min(1.0, max(ends) + 0.02)
    y_axis = Axis(low, high, TOP + HEIGHT, TOP, 40.0)
    parts = [_frame(x_axis, y_axis)]
    for row in rows:
        if not row.seeds and low <= row.iou <= high:
            y = float(y_axis.place(row.iou))
            parts.append(f'<path class="frame" stroke-dasharray="2 4" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
            parts.append(f'<text x="{WIDTH - RIGHT + 6}" y="{y + 4.5:.1f}">{escape(row.variant)}</text>')
    for k, (variant, group) in enumerate(curves.items()):
        shift = APART * (k - (len(curves) - 1) / 2)
        parts.append(f"<g><title>{escape(variant)}</title>{_curve(group, style_of(k), shift, x_axis, y_axis)}</g>")
    legend = "".join(f"<li>{swatch(style_of(k))} {escape(variant)}</li>" for k, variant in enumerate(curves))
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH:.0f} {TOP + HEIGHT + BOTTOM:.0f}" role="img" '
        f'aria-label="IoU over the number of real training images">{"".join(parts)}</svg>'
        f'<ul class="legend">{legend}</ul>'
    )


def curves_of(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Variant -> its rows by the number of real images; without any, that of its synthetic images alone."""
    curves: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.variant != REAL):
        if row.size is not None:
            curves.setdefault(row.variant, []).append(row)
    alone = {f"{REAL} + {row.variant.removesuffix(' only')}": row for row in rows if row.seeds and row.size is None}
    for variant, group in curves.items():
        group.sort(key=lambda row: row.images)
        if variant in alone:
            group.insert(0, alone[variant])
    return curves


def style_of(number: int) -> int:
    """Style on the page of the curve of a number, from 0."""
    return 1 + number % STYLES


def _numbers(sizes: Sequence[int]) -> Axis:
    """The axis of the numbers of real images; 0 lies where half the least number would."""
    named = ((min(sizes) / 2, "0"), *((float(n), str(n)) for n in sizes))
    return Axis(min(sizes) / 2.3, max(sizes) * 1.15, LEFT, WIDTH - RIGHT, logarithmic=True, named=named)


def _frame(x_axis: Axis, y_axis: Axis) -> str:
    right, below = WIDTH - RIGHT, TOP + HEIGHT
    parts = []
    for value, text in x_axis.ticks():
        x = float(x_axis.place(value))
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{below}"/>')
        parts.append(f'<text x="{x:.1f}" y="{below + 17}" text-anchor="middle">{text}</text>')
    for value, text in y_axis.ticks():
        y = float(y_axis.place(value))
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 7}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
    parts.append(f'<text class="axis" x="{LEFT}" y="{TOP - 11}">IoU of oysters on real test clips</text>')
    parts.append(f'<text class="axis" x="{right}" y="{below + 37}" text-anchor="end">real training images</text>')
    return "".join(parts)


def _curve(group: Sequence[Row], style: int, shift: float, x_axis: Axis, y_axis: Axis) -> str:
    words, parts = [], []
    for k, row in enumerate(group):
        x = float(x_axis.place(row.images if row.size is not None else x_axis.named[0][0])) + shift
        y = float(y_axis.place(row.iou))
        words.append(f"{'M' if k == 0 else 'L'}{x:.1f} {y:.1f}")
        if math.isfinite(row.interval.low):
            ends = [float(y_axis.place(value)) for value in (row.interval.low, row.interval.high)]
            parts.append(f'<path class="c{style}" stroke-opacity="0.5" d="M{x:.1f} {ends[0]:.1f}V{ends[1]:.1f}"/>')
    return f'<path class="c{style}" d="{"".join(words)}"/>' + "".join(parts)
