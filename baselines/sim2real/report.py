"""The table as text and as a page, with the plot of IoU over the number of real images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from oysterbench.evaluate.statistics import Interval
from oysterbench.page import page
from oysterbench.plots import BOTTOM, INNER, LEFT, TOP, WIDTH, Axis, swatch
from oysterbench_baselines.sim2real.table import Row

HEIGHT = 300.0
HEADINGS = ("training", "real images", "seeds", "IoU", "of clips", "AP", "AP50", "count MAE", "gain in IoU")


def lines(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The cells of the table, a tuple for each row, under `HEADINGS`."""
    return [
        (
            row.variant,
            str(row.images) if row.seeds else "",
            str(len(row.seeds)) if row.seeds else "",
            f"{row.iou:.3f}{_bracket(row.interval)}",
            ", ".join(f"{clip} {value:.3f}" for clip, value in row.by_clip.items()),
            f"{row.means['ap_mask']:.3f}",
            f"{row.means['ap50_mask']:.3f}",
            f"{row.means['count_mae']:.1f}",
            "" if row.gain is None else f"{row.gain:+.3f}{_bracket(row.gain_interval, '+')}",
        )
        for row in rows
    ]


def _bracket(interval: Interval | None, sign: str = "") -> str:
    return f" [{interval.low:{sign}.3f}, {interval.high:{sign}.3f}]" if interval is not None and interval.known else ""


def markdown(rows: Sequence[Row]) -> str:
    """For a README."""
    text = ["| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
    return "\n".join(text + ["| " + " | ".join(cells) + " |" for cells in lines(rows)]) + "\n"


def report(rows: Sequence[Row], remarks: Sequence[str]) -> str:
    """An HTML page."""
    head = "".join(f"<th>{escape(word)}</th>" for word in HEADINGS)
    body = "".join(
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell, tag in zip(cells, ("th", *["td"] * 8), strict=True))
        for cells in lines(rows)
    )
    said = "".join(f"<p>{escape(remark)}</p>" for remark in remarks)
    return page(
        "What rendered images are worth",
        f'<h1>What rendered images are worth</h1>{said}<div class="card">{plot(rows)}</div>'
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>',
    )


def plot(rows: Sequence[Row]) -> str:
    """IoU over the number of real images, a curve and intervals for each variant; level lines for those without any."""
    curves: dict[str, list[Row]] = {}
    for row in rows:
        curves.setdefault(row.variant, []).append(row)
    sizes = sorted({row.images for row in rows if row.size is not None})
    if not sizes:
        return "<p>No training with real images is finished yet.</p>"
    low, high = min(sizes) / 1.25, max(sizes) * 1.25
    x_axis = Axis(low, high, LEFT, LEFT + INNER, logarithmic=True, named=tuple((n, str(n)) for n in sizes))
    top = min(1.0, 1.1 * max(row.iou for row in rows))
    y_axis = Axis(0.0, top, TOP + HEIGHT, TOP, 40.0)
    parts = [
        f'<svg class="plot" viewBox="0 0 {WIDTH:.0f} {TOP + HEIGHT + BOTTOM:.0f}" role="img" '
        'aria-label="IoU over the number of real training images">'
    ]
    for value, text in x_axis.ticks():
        x = float(x_axis.place(value))
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{TOP + HEIGHT}"/>')
        parts.append(f'<text x="{x:.1f}" y="{TOP + HEIGHT + 17}" text-anchor="middle">{text}</text>')
    for value, text in y_axis.ticks():
        y = float(y_axis.place(value))
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{LEFT + INNER}"/>')
        parts.append(f'<text x="{LEFT - 7}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
    parts.append(f'<text class="axis" x="{LEFT}" y="{TOP - 11}">IoU of oysters on real test clips</text>')
    right, below = LEFT + INNER, TOP + HEIGHT + 37
    parts.append(f'<text class="axis" x="{right}" y="{below}" text-anchor="end">real training images</text>')
    for style, (variant, group) in enumerate(curves.items(), start=1):
        parts.append(f"<g><title>{escape(variant)}</title>{_curve(group, style, x_axis, y_axis)}</g>")
    legend = "".join(f"<li>{swatch(k)} {escape(variant)}</li>" for k, variant in enumerate(curves, start=1))
    return "".join(parts) + f'</svg><ul class="legend">{legend}</ul>'


def _curve(group: Sequence[Row], style: int, x_axis: Axis, y_axis: Axis) -> str:
    points = sorted((row for row in group if row.size is not None), key=lambda row: row.images)
    if not points:
        y = float(y_axis.place(group[0].iou))
        return f'<path class="c{style}" d="M{LEFT} {y:.1f}H{LEFT + INNER}"/>'
    parts = []
    words = []
    for k, row in enumerate(points):
        x = float(x_axis.place(row.images)) + 2.0 * style - 8.0  # px, so that intervals of several variants are seen
        y = float(y_axis.place(row.iou))
        words.append(f"{'M' if k == 0 else 'L'}{x:.1f} {y:.1f}")
        if math.isfinite(row.interval.low):
            ends = [float(y_axis.place(value)) for value in (row.interval.low, row.interval.high)]
            parts.append(f'<path class="c{style}" d="M{x:.1f} {ends[0]:.1f}V{ends[1]:.1f}"/>')
    return f'<path class="c{style}" d="{"".join(words)}"/>' + "".join(parts)
