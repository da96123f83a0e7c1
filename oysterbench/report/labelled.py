"""Scatter plot with names beside the points, as inline SVG in the style of the other plots: no legend, no colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from oysterbench.report.axes import Axis, nice_ticks
from oysterbench.report.plots import BOTTOM, TOP

WIDE, TALL, LEFT, RIGHT = 760.0, 360.0, 56.0, 20.0
LETTER = 6.6  # width of a letter of a label
LINE = 15.0  # height of a label
MOST_LETTERS = 34


@dataclass(frozen=True)
class Point:
    """A labelled point: x must be above 0, y is any number."""

    label: str
    x: float
    y: float


def labelled_plot(points: Sequence[Point], title: str, x_label: str, y_label: str, line: float | None = None) -> str:
    """Plot y over x on a logarithmic x axis, with at least one point; line: an x at which a vertical line is drawn."""
    xs, ys = [point.x for point in points], [point.y for point in points]
    if line is not None:
        xs = [*xs, line]
    x_axis = Axis(min(xs) / 1.4, max(xs) * 1.4, LEFT, WIDE - RIGHT, logarithmic=True)
    low, high = min(0.0, *ys), max(*ys, 0.0) or 1.0
    y_axis = Axis(low - (0.03 if low else 0.0) * (high - low), low + 1.06 * (high - low), TOP + TALL, TOP, 44.0)
    bottom, right = TOP + TALL, WIDE - RIGHT
    label = f"{title}: {', '.join(point.label for point in points)}. {x_label}, {y_label}."
    parts = [
        f'<svg class="plot named" viewBox="0 0 {WIDE:.0f} {bottom + BOTTOM:.0f}" role="img" '
        f'aria-label="{escape(label)}">'
    ]
    for value, text in _ticks(x_axis):
        x = float(x_axis.place(value))
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP}V{bottom:.1f}"/>')
        parts.append(f'<text x="{x:.1f}" y="{bottom + 17:.1f}" text-anchor="middle">{text}</text>')
    for value, text in nice_ticks(y_axis.low, y_axis.high, 6):
        y = float(y_axis.place(value))
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{LEFT - 7}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
    parts.append(f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{right - LEFT}" height="{TALL}"/>')
    if line is not None:
        parts.append(f'<path class="axis-line" d="M{float(x_axis.place(line)):.1f} {TOP}V{bottom:.1f}"/>')
    parts.append(f'<text class="axis" x="{LEFT}" y="{TOP - 11}">{escape(y_label)}</text>')
    parts.append(f'<text class="axis" x="{right}" y="{bottom + 37:.1f}" text-anchor="end">{escape(x_label)}</text>')
    placed = [(point, float(x_axis.place(point.x)), float(y_axis.place(point.y))) for point in points]
    for (point, x, y), (text_x, text_y, anchor) in zip(placed, _labels(placed, right, bottom), strict=True):
        about = f"<title>{escape(point.label)}: {point.x:.3g}, {point.y:.3g}</title>"
        parts.append(f'<circle class="p1" cx="{x:.1f}" cy="{y:.1f}" r="5">{about}</circle>')
        parts.append(
            f'<text class="axis" x="{text_x:.1f}" y="{text_y:.1f}" text-anchor="{anchor}">'
            f"{escape(_short(point.label))}</text>"
        )
    return "".join((*parts, "</svg>"))


def _ticks(axis: Axis) -> list[tuple[float, str]]:
    """Ticks at 1, 2 and 5 times the powers of ten within the range of an axis."""
    first, last = math.floor(math.log10(axis.low)), math.ceil(math.log10(axis.high))
    values = [factor * 10.0**power for power in range(first, last + 1) for factor in (1, 2, 5)]
    return [(value, f"{value:g}") for value in values if axis.low <= value <= axis.high]


def _labels(
    placed: Sequence[tuple[Point, float, float]], right: float, bottom: float
) -> list[tuple[float, float, str]]:
    """Place each label: beside its point if there is room, preferably to the right, or else shifted up or down in steps
    of half a line until it fits."""
    boxes = [(x - 5.0, y - 5.0, x + 5.0, y + 5.0) for _, x, y in placed]
    found = []
    for point, x, y in placed:
        width = LETTER * len(_short(point.label))
        steps = sorted((k * 0.5 for k in range(-40, 41)), key=abs)
        choices = [
            (x + 9.0 if anchor == "start" else x - 9.0, y + 4.5 + step * LINE, anchor)
            for step in steps
            for anchor in ("start", "end")
        ]
        for text_x, text_y, anchor in choices:
            left = text_x if anchor == "start" else text_x - width
            box = (left, text_y - 11.0, left + width, text_y + 3.0)
            inside = box[0] >= LEFT and box[2] <= right and box[1] >= TOP and box[3] <= bottom
            if inside and not any(_meet(box, other) for other in boxes):
                break
        boxes.append(box)
        found.append((text_x, text_y, anchor))
    return found


def _meet(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _short(label: str) -> str:
    return label if len(label) <= MOST_LETTERS else label[: MOST_LETTERS - 1] + "\N{HORIZONTAL ELLIPSIS}"
