"""Plots as inline SVG: paths with equal axes, errors, recall, scatter. Colours come from the page (`core.page.STYLE`).

A zoomable plot states the ranges of its axes in `data-` attributes; the report's script moves curves and ticks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.report.axes import Axis

WIDTH, LEFT, RIGHT, TOP, BOTTOM = 480.0, 56.0, 16.0, 32.0, 46.0
INNER = WIDTH - LEFT - RIGHT
"""Width of the plot area in drawing units; the page scales it to its column, and enlarges the text on a phone."""

MAX_POINTS = 600  # per curve: more would be finer than a pixel
ROOM = 0.8  # how far, in extents of the ground truth, an estimate may stray from it and still be shown whole
CROP = 0.25  # margin, in extents of the ground truth, left around it where an estimate is not shown whole
SHAPES = ((24, 0), (4, 45), (3, 0), (4, 0), (3, 180), (6, 0), (5, 0), (8, 22.5))  # corners, rotation in deg, by style
RECALL_TICKS = (0.1, 0.25, 0.5, 1, 2, 4, 10)  # in multiples of the error that scores half
NEES_TOP = 1e6  # far beyond any that tells how overconfident an estimate is
LOG_RATIO = 25.0  # ratio of the largest errors of two methods above which a linear axis would hide one


@dataclass(frozen=True)
class Curve:
    """One curve of a plot: x and y (N,), NaN at breaks; style 0 is the ground truth, 1, 2, ... are the methods."""

    label: str
    x: Array
    y: Array
    style: int


def map_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str, least_height: float = 110.0) -> str:
    """Plot curves in m with equal axes, marking start and end of the ground truth, which is the first curve.

    The plot shows all of the ground truth, and the estimates if they stay near it (`ROOM`); curves that leave the plot
    are cut and named in a note.
    """
    x_low, x_high = _limits([curve.x for curve in curves])
    y_low, y_high = _limits([curve.y for curve in curves])
    truth_x, truth_y = _limits([curves[0].x]), _limits([curves[0].y])
    length = max(truth_x[1] - truth_x[0], truth_y[1] - truth_y[0], 0.5)
    if _beyond(x_low, x_high, truth_x, ROOM * length) or _beyond(y_low, y_high, truth_y, ROOM * length):
        x_low, x_high = _restrict(x_low, x_high, truth_x, CROP * length)
        y_low, y_high = _restrict(y_low, y_high, truth_y, CROP * length)
    size = max(x_high - x_low, y_high - y_low, 0.1)
    x_low, x_high = x_low - 0.05 * size, x_high + 0.05 * size
    y_low, y_high = y_low - 0.05 * size, y_high + 0.05 * size

    per_metre = INNER / (x_high - x_low)
    height = float(np.clip(per_metre * (y_high - y_low), least_height, 440.0))
    per_metre = min(per_metre, height / (y_high - y_low))
    x_low, x_high = _widen(x_low, x_high, INNER / per_metre)
    y_low, y_high = _widen(y_low, y_high, height / per_metre)
    x_axis = Axis(x_low, x_high, LEFT, LEFT + INNER)
    y_axis = Axis(y_low, y_high, TOP + height, TOP, 44.0)

    note = _note([c.label for c in curves if _leaves(c.x, x_low, x_high) or _leaves(c.y, y_low, y_high)])
    truth = curves[0]
    marks = _mark(truth, 0, "start", x_axis, y_axis) + _mark(truth, -1, "end", x_axis, y_axis)
    return _drawing(curves, x_axis, y_axis, title, x_label, y_label, note, marks, zoom="equal")


def height_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str, span: tuple[float, float]) -> str:
    """Plot curves over time in s within `span`, the vertical axis scaled to the ground truth, the first curve."""
    low, high = _limits([curve.y for curve in curves])
    truth = _limits([curves[0].y])
    length = max(truth[1] - truth[0], 0.5)
    if _beyond(low, high, truth, 2 * ROOM * length):
        low, high = _restrict(low, high, truth, 2 * CROP * length)
    margin = 0.08 * max(high - low, 0.1)
    x_axis = _time_axis(span)
    y_axis = Axis(low - margin, high + margin, TOP + 150.0, TOP, 40.0)
    note = _note([c.label for c in curves if _leaves(c.y, y_axis.low, y_axis.high)])
    thinned = [thin(curve) for curve in curves]
    return _drawing(thinned, x_axis, y_axis, title, x_label, y_label, note, "", zoom="free")


def time_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str, span: tuple[float, float]) -> str:
    """Plot curves over time in s, or distance in m, within `span`, from zero up; logarithmic if they differ greatly."""
    tops = [float(np.max(_known(curve.y))) for curve in curves]
    top, smallest = max([*tops, 1e-9]), min([top for top in tops if top > 0], default=1.0)
    x_axis = _time_axis(span)
    height = 190.0
    if top / smallest > LOG_RATIO:
        lowest = [float(np.percentile(_known(curve.y), 5)) for curve in curves]
        floor = max(min([value for value in lowest if value > 0], default=smallest), top * 1e-6)
        low, high = 10.0 ** math.floor(math.log10(floor)), 10.0 ** math.ceil(math.log10(top))
        y_axis = Axis(low, high, TOP + height, TOP, logarithmic=True)
        y_label += ", logarithmic"
    else:
        y_axis = Axis(0.0, top * 1.08, TOP + height, TOP, 44.0)
    thinned = [thin(curve) for curve in curves]
    return _drawing(thinned, x_axis, y_axis, title, x_label, y_label, "", "", zoom="free")


def signed_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str, span: tuple[float, float]) -> str:
    """Plot curves over time in s within `span`, on a vertical axis symmetric about a zero line.

    A curve more than LOG_RATIO times as large as the smallest is left out, with a note: it would flatten the others.
    """
    tops = {curve.label: float(np.max(np.abs(_known(curve.y)))) for curve in curves}
    smallest = min((top for top in tops.values() if top > 1e-12), default=1.0)
    drawn = [curve for curve in curves if tops[curve.label] <= LOG_RATIO * smallest]
    top = 1.08 * max([tops[curve.label] for curve in drawn if tops[curve.label] > 1e-12], default=1.0)
    x_axis, y_axis = _time_axis(span), Axis(-top, top, TOP + 150.0, TOP, 40.0)
    away = [f"{label} up to {value:.2g}" for label, value in tops.items() if value > LOG_RATIO * smallest]
    note = (
        away[0] if len(away) == 1 and len(away[0]) <= 30 else f"{len(away)} larger values are not drawn" if away else ""
    )
    zero = f'<path class="zero" d="M{LEFT} {TOP + 75.0:.1f}H{LEFT + INNER}"/>'
    return _drawing(drawn, x_axis, y_axis, title, x_label, y_label, note, zero)


def nees_plot(
    curves: Sequence[Curve], title: str, x_label: str, y_label: str, span: tuple[float, float], freedom: int
) -> str:
    """Plot squared normalised errors over time in s on a logarithmic axis, with the band that holds 95 % of the values
    of a consistent estimate. Values above NEES_TOP are drawn at the edge, with a note.

    freedom: degrees of freedom of the chi-square distribution that they then follow.
    """
    low, high = 2.0 * scipy.special.gammaincinv(freedom / 2.0, [0.025, 0.975])
    top = min(max([100.0, *(float(np.max(_known(curve.y))) for curve in curves)]), NEES_TOP)
    x_axis = _time_axis(span)
    y_axis = Axis(0.01, 10.0 ** math.ceil(math.log10(top)), TOP + 190.0, TOP, logarithmic=True)
    y, bottom = float(y_axis.place(high)), float(y_axis.place(low))
    about = f"<title>{low:.2g} to {high:.2g}: 95 % of a consistent estimate's values</title>"
    band = f'<rect class="band" x="{LEFT}" y="{y:.1f}" width="{INNER}" height="{bottom - y:.1f}">{about}</rect>'
    note = _note([curve.label for curve in curves if _leaves(curve.y, 0.0, y_axis.high)])
    drawn = [thin(replace(curve, y=np.minimum(curve.y, y_axis.high))) for curve in curves]
    return _drawing(drawn, x_axis, y_axis, title, x_label, y_label, note, band)


def states_plot(
    curves: Sequence[Curve], title: str, x_label: str, y_label: str, span: tuple[float, float], names: Sequence[str]
) -> str:
    """Plot states over time in s, indices into `names`: a step curve for each, slightly offset from one another."""
    named = tuple((float(k), name) for k, name in enumerate(names))
    y_axis = Axis(-0.5, len(names) - 0.5, TOP + 120.0, TOP, named=named)
    stairs = []
    for k, curve in enumerate(curves):
        changes = np.flatnonzero(np.diff(curve.y)) + 1
        first = np.r_[0, changes]
        x = np.r_[np.repeat(curve.x[first], 2)[1:], curve.x[-1]]
        y = np.repeat(curve.y[first], 2) + 0.08 * (k - (len(curves) - 1) / 2)  # equal states of two are both seen
        stairs.append(Curve(curve.label, x, y, curve.style))
    return _drawing(stairs, _time_axis(span), y_axis, title, x_label, y_label, "", "")


def recall_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str) -> str:
    """Plot recall over error: x in multiples of the error that scores half, drawn at x / (1 + x), y from 0 to 1.

    On this axis, which is finite but has no cut-off, the area under a curve is the score.
    """
    bent = []
    for curve in curves:
        x, y = curve.x / (1 + curve.x), curve.y
        steps_x, steps_y = np.r_[0.0, np.repeat(x, 2), 1.0], np.r_[0.0, 0.0, np.repeat(y, 2)]
        bent.append(Curve(curve.label, steps_x, steps_y[: len(steps_x)], curve.style))
    named = tuple((u / (1 + u), f"{u:g}") for u in RECALL_TICKS)
    x_axis = Axis(0.0, 1.0, LEFT, LEFT + INNER, named=((0.0, "0"), *named, (1.0, "\N{INFINITY}")))
    y_axis = Axis(0.0, 1.0, TOP + 190.0, TOP, 40.0)
    return _drawing(bent, x_axis, y_axis, title, x_label, y_label, "", "")


def share_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str) -> str:
    """Plot shares over shares or thresholds, both from 0 to 1."""
    x_axis = Axis(0.0, 1.0, LEFT, LEFT + INNER)
    y_axis = Axis(0.0, 1.0, TOP + 190.0, TOP, 40.0)
    return _drawing([thin(curve) for curve in curves], x_axis, y_axis, title, x_label, y_label, "", "")


def strength_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str) -> str:
    """Plot shares from 0 to 1 over integer strengths: a line for each method, with a point at each strength."""
    last = max(float(curve.x[-1]) for curve in curves)
    named = tuple((float(k), str(k)) for k in range(int(last) + 1))
    x_axis = Axis(-0.15, last + 0.15, LEFT, LEFT + INNER, named=named)
    y_axis = Axis(0.0, 1.0, TOP + 190.0, TOP, 40.0)
    points = "".join(_points(curve, x_axis, y_axis) for curve in curves)
    return _drawing(curves, x_axis, y_axis, title, x_label, y_label, "", points)


def scatter_plot(curves: Sequence[Curve], title: str, x_label: str, y_label: str, top: float | None = None) -> str:
    """Plot points, one for each sequence and method; the axis goes from zero, or the lowest value below it, to `top`.

    Without `top` it ends above the highest point, and is logarithmic if the values differ greatly.
    """
    x_low, x_high = _limits([curve.x for curve in curves])
    margin = 0.06 * max(x_high - x_low, 1e-9)
    x_axis = Axis(x_low - margin, x_high + margin, LEFT, LEFT + INNER)
    lowest, highest = _limits([curve.y for curve in curves])
    if top is None and 0 < lowest * LOG_RATIO < highest:
        low, high = 10.0 ** math.floor(math.log10(lowest)), 10.0 ** math.ceil(math.log10(highest))
        y_axis = Axis(low, high, TOP + 170.0, TOP, logarithmic=True)
        y_label += ", logarithmic"
    else:
        y_axis = Axis(min(0.0, 1.08 * lowest), top or 1.08 * max(highest, 0.0) or 1.0, TOP + 170.0, TOP, 40.0)
    # Shifted, so that equal values of two methods are both visible.
    points = [_points(curve, x_axis, y_axis, 3.0 * (k - (len(curves) - 1) / 2)) for k, curve in enumerate(curves)]
    empty = [Curve(curve.label, curve.x[:0], curve.y[:0], curve.style) for curve in curves]
    return _drawing(empty, x_axis, y_axis, title, x_label, y_label, "", "".join(points))


def _points(curve: Curve, x_axis: Axis, y_axis: Axis, shift: float = 0.0) -> str:
    """Draw a point at each value, shifted `shift` px to the right."""
    points = []
    for x, y in zip(curve.x, curve.y, strict=True):
        if math.isfinite(x) and math.isfinite(y):
            place = f"translate({float(x_axis.place(x)) + shift:.1f} {float(y_axis.place(y)):.1f})"
            about = f"<title>{escape(curve.label)}: {x:g}, {y:.3g}</title>"
            shape = f'points="{_shape(curve.style)}" transform="{place}"'
            points.append(f'<polygon class="p{curve.style}" {_label(curve)} {shape}>{about}</polygon>')
    return "".join(points)


def _shape(style: int) -> str:
    """Corners of a point marker about the origin: methods are distinguished by shape, not by colour alone."""
    corners, turn = SHAPES[(style - 1) % len(SHAPES)]
    size = 4.2 * (2 * math.pi / (corners * math.sin(2 * math.pi / corners))) ** 0.5  # of equal area
    angles = [math.radians(turn) + 2 * math.pi * k / corners for k in range(corners)]
    return " ".join(f"{size * math.sin(angle):.1f},{-size * math.cos(angle):.1f}" for angle in angles)


def thin(curve: Curve) -> Curve:
    """Thin a curve to about MAX_POINTS points without visible change: each stretch keeps its lowest and its highest."""
    if len(curve.x) <= MAX_POINTS:
        return curve
    keep: set[int] = {0, len(curve.x) - 1}
    for part in np.array_split(np.arange(len(curve.x)), MAX_POINTS // 2):
        values = curve.y[part]
        breaks = part[np.isnan(values)]
        keep.update(int(i) for i in breaks)
        if len(breaks) < len(part):
            keep.update((int(part[np.nanargmin(values)]), int(part[np.nanargmax(values)])))
    index = np.array(sorted(keep))
    return Curve(curve.label, curve.x[index], curve.y[index], curve.style)


def broken(stamps_ns: NDArray[np.int64], x: NDArray[Any], y: NDArray[Any]) -> tuple[Array, Array]:
    """Insert a NaN into x and y wherever the stamps jump by more than 4 median steps and by more than 0.25 s."""
    steps = np.diff(stamps_ns)
    if not len(steps):
        return x, y
    jumps = np.flatnonzero((steps > 4 * np.median(steps)) & (steps > 250_000_000)) + 1
    return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)


def point_swatch(style: int) -> str:
    """A point, for the legend of a scatter plot."""
    point = f'<polygon class="p{style}" points="{_shape(style)}" transform="translate(7 7)"/>'
    return f'<svg class="swatch point" viewBox="0 0 14 14" aria-hidden="true">{point}</svg>'


def swatch(style: int) -> str:
    """A short piece of a curve, for a legend."""
    return f'<svg class="swatch" viewBox="0 0 34 10" aria-hidden="true"><path class="c{style}" d="M1 5H33"/></svg>'


def _known(values: Array) -> Array:
    known = values[np.isfinite(values)]
    return known if len(known) else np.zeros(1)


def _limits(series: Sequence[Array]) -> tuple[float, float]:
    return min(float(_known(v).min()) for v in series), max(float(_known(v).max()) for v in series)


def _beyond(low: float, high: float, truth: tuple[float, float], reach: float) -> bool:
    return low < truth[0] - reach or high > truth[1] + reach


def _restrict(low: float, high: float, truth: tuple[float, float], reach: float) -> tuple[float, float]:
    return max(low, truth[0] - reach), min(high, truth[1] + reach)


def _widen(low: float, high: float, size: float) -> tuple[float, float]:
    extra = max(0.0, size - (high - low)) / 2
    return low - extra, high + extra


def _leaves(values: Array, low: float, high: float) -> bool:
    return bool((_known(values) < low).any() or (_known(values) > high).any())


def _time_axis(span: tuple[float, float]) -> Axis:
    """Axis from start to end, or to the whole second that the end just misses, so that it gets a tick."""
    end = max(span[1], span[0] + 1e-3)
    whole = math.ceil(end)
    return Axis(span[0], whole if whole - end < 0.005 * (end - span[0]) else end, LEFT, LEFT + INNER)


def _note(away: Sequence[str]) -> str:
    """Note on the curves that leave the plot, short enough to fit above it."""
    if len(away) == 1 and len(away[0]) <= 20:
        return f"{away[0]} leaves this plot"
    if not away:
        return ""
    return "1 estimate leaves this plot" if len(away) == 1 else f"{len(away)} estimates leave this plot"


def _mark(truth: Curve, i: int, kind: str, x_axis: Axis, y_axis: Axis) -> str:
    """Draw a mark on the ground truth: an open circle at the start, a square at the end."""
    x, y = float(x_axis.place(truth.x[i])), float(y_axis.place(truth.y[i]))
    if kind == "start":
        return f'<circle class="mark" cx="{x:.1f}" cy="{y:.1f}" r="5"><title>start of the true path</title></circle>'
    corner = f'x="{x - 4.5:.1f}" y="{y - 4.5:.1f}" width="9" height="9"'
    return f'<rect class="mark" {corner}><title>end of the true path</title></rect>'


def _path(curve: Curve, x_axis: Axis, y_axis: Axis) -> str:
    """Data of an SVG path, with gaps where the curve is broken."""
    x, y = x_axis.place(curve.x), y_axis.place(curve.y)
    # Limit the coordinates to well outside the clipped plot: huge ones upset renderers.
    x, y = np.clip(x, -5000, 5000), np.clip(y, -5000, 5000)
    drawn = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    lifted = np.diff(drawn, prepend=-2) > 1
    # One formatting call for all numbers instead of one for each: the site of a board has millions.
    form = "".join(["M%.2f %.2f" if up else "L%.2f %.2f" for up in lifted.tolist()])
    return form % tuple(np.column_stack([x[drawn], y[drawn]]).ravel().tolist())


def _label(curve: Curve) -> str:
    return f'data-label="{escape(curve.label)}"'


def _drawing(
    curves: Sequence[Curve],
    x_axis: Axis,
    y_axis: Axis,
    title: str,
    x_label: str,
    y_label: str,
    note: str,
    marks: str,
    zoom: str = "",
) -> str:
    """Assemble frame, grid, ticks, labels and curves. Zoom "equal" keeps the scales of the axes equal, "free" does
    not."""
    top, bottom = y_axis.end, y_axis.begin
    height = bottom + BOTTOM
    label = f"{title}: {', '.join(curve.label for curve in curves)}. {x_label}, {y_label}." + (
        f" {note}." if note else ""
    )
    axes = ""
    if zoom:
        x_range, y_range = (f"{axis.low:.9g} {axis.high:.9g}" for axis in (x_axis, y_axis))
        box = f"{LEFT:g} {top:g} {INNER:g} {bottom - top:.1f}"
        logarithmic = " data-log" if y_axis.logarithmic else ""
        axes = f' data-zoom="{zoom}" data-x="{x_range}" data-y="{y_range}" data-box="{box}"{logarithmic}'
    parts = [f'<svg class="plot" viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(label)}"{axes}>']
    parts.append('<g class="ticks">')
    for value, text in x_axis.ticks():
        x = float(x_axis.place(value))
        parts.append(f'<path class="grid" d="M{x:.1f} {top}V{bottom:.1f}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 17:.1f}" text-anchor="middle">{text}</text>')
    for value, text in y_axis.ticks():
        y = float(y_axis.place(value))
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{LEFT + INNER}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 7}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
    parts.append("</g>")
    parts.append(f'<rect class="frame" x="{LEFT}" y="{top}" width="{INNER}" height="{bottom - top:.1f}"/>')
    parts.append(f'<text class="axis" x="{LEFT}" y="{top - 11}">{escape(y_label)}</text>')
    right = LEFT + INNER
    parts.append(f'<text class="axis" x="{right}" y="{bottom + 37:.1f}" text-anchor="end">{escape(x_label)}</text>')
    if note:
        parts.append(f'<text class="note" x="{right}" y="{top - 11}" text-anchor="end">{escape(note)}</text>')
    left_top, size = (LEFT, top), (INNER, round(bottom - top, 1))
    place = 'x="{}" y="{}" width="{}" height="{}" viewBox="{} {} {} {}"'.format(*left_top, *size, *left_top, *size)
    # An inner svg clips what leaves it while zooming; without zoom, points on the frame are shown whole.
    cut = "" if zoom else ' overflow="visible"'
    parts.append(f'<svg {place}{cut}><g class="curves">')
    for curve in curves:
        data = _path(curve, x_axis, y_axis)
        name = f"<title>{escape(curve.label)}</title>"
        parts.append(f'<path class="c{curve.style}" {_label(curve)} d="{data}">{name}</path>')
    parts.append(f'</g><g class="marks">{marks}</g></svg></svg>')
    return "".join(parts)
