"""The plot of IoU against the number of real images: a curve with confidence intervals for each variant."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

from oysterbench_baselines.sim2real.settings import REAL
from oysterbench_baselines.sim2real.table import VariantRow

SIZE = (8.8, 4.2)  # inches
APART = 1.02  # factor in x between the intervals of two variants, which would otherwise hide each other
BEYOND = 0.02  # margin of IoU around all intervals


def plot(rows: Sequence[VariantRow]) -> str:
    """Plot IoU against the number of real images as SVG; empty where no training with real images is finished.

    A curve of real + synthetic images starts with the synthetic images alone, drawn at half the smallest number of real
    images. Methods without training are horizontal lines with their names, where they are within the range of the plot.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    curves = curves_of(rows)
    sizes = sorted({row.images for group in curves.values() for row in group if row.size is not None})
    if not sizes:
        return ""
    none = min(sizes) / 2
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots()
    ends = []
    for k, (variant, group) in enumerate(curves.items()):
        shift = APART ** (k - (len(curves) - 1) / 2)
        places = [(none if row.size is None else row.images) * shift for row in group]
        known = [row.interval if math.isfinite(row.interval.low) else None for row in group]
        below = [row.iou - one.low if one else 0.0 for row, one in zip(group, known, strict=True)]
        above = [one.high - row.iou if one else 0.0 for row, one in zip(group, known, strict=True)]
        axes.errorbar(places, [row.iou for row in group], (below, above), label=variant, marker="o", markersize=3)
        ends += [row.iou + up for row, up in zip(group, above, strict=True)]
        ends += [row.iou - down for row, down in zip(group, below, strict=True)]
    low, high = max(0.0, min(ends) - BEYOND), min(1.0, max(ends) + BEYOND)
    for row in rows:
        if not row.seeds and low <= row.iou <= high:
            axes.axhline(row.iou, color="grey", linestyle=":")
            axes.annotate(row.variant, (1.01, row.iou), xycoords=("axes fraction", "data"), va="center")
    axes.set(ylim=(low, high), ylabel="IoU of oysters on real test clips", xlabel="real training images", xscale="log")
    axes.set_xticks([none, *sizes], labels=["0", *map(str, sizes)])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4)  # within the axes it would hide intervals
    text = io.StringIO()
    with rc_context({"svg.hashsalt": "sim2real", "svg.fonttype": "none"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]


def curves_of(rows: Sequence[VariantRow]) -> dict[str, list[VariantRow]]:
    """Variant -> its rows by the number of real images, starting with that of its synthetic images alone."""
    curves: dict[str, list[VariantRow]] = {}
    for row in sorted(rows, key=lambda row: row.variant != REAL):
        if row.size is not None:
            curves.setdefault(row.variant, []).append(row)
    alone = {f"{REAL} + {row.variant.removesuffix(' only')}": row for row in rows if row.seeds and row.size is None}
    for variant, group in curves.items():
        group.sort(key=lambda row: row.images)
        if variant in alone:
            group.insert(0, alone[variant])
    return curves
