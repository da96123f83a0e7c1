"""Confusion matrices of a policy: the expert's classes against the commanded ones, both axes side by side."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.steering import PictureScore
from oysterbench.recipe import SteeringRecipe
from oysterbench.report.drawing import INK, SOFT, Drawing

CELL, MARGIN, LEFT, TOP, GAP, FOOT = 52.0, 26.0, 100.0, 124.0, 60.0, 96.0
PALE, DEEP = (247, 251, 255), (8, 69, 148)
"""Ends of a scale of blues: no picture of the row, all of them."""


def confusion_figure(method: str, score: PictureScore, task: SteeringRecipe) -> Drawing:
    """A panel for yaw, from left to right as in the picture, and one for pitch, from up to down."""
    sizes = [CELL * len(degrees) for degrees in (task.yaw_deg, task.pitch_deg)]
    width = LEFT + sizes[0] + GAP + LEFT + sizes[1] + 60.0 + MARGIN
    sheet = Drawing(width, TOP + max(sizes) + FOOT, f"Confusions of {method}")
    pictures = score.metrics["pictures"]
    sheet.text(MARGIN, 34, f"{method} against the expert", 21, bold=True)
    sheet.text(
        MARGIN, 56, f"{pictures:.0f} pictures: how many, by what the expert commands and what it does", 13.5, fill=SOFT
    )
    second = LEFT + sizes[0] + GAP + LEFT
    for axis, counts, degrees, names, left in (
        ("yaw", score.yaw, task.yaw_deg, ("left", "right"), LEFT),
        ("pitch", score.pitch, task.pitch_deg, ("up", "down"), second),
    ):
        _panel(sheet, left, counts, degrees, names)
        said = {key: score.metrics[f"{axis}_{key}"] for key in ("accuracy", "macro_f1", "cost_deg")}
        known = not math.isnan(said["accuracy"])
        line = f"{said['accuracy']:.0%} right, F1 {said['macro_f1']:.2f}, off by {said['cost_deg']:.1f} deg on average"
        sheet.text(left, TOP - 40, f"{axis.capitalize()}{': ' + line if known else ''}", 13.5, bold=True)
    _legend(sheet, LEFT, TOP + max(sizes) + FOOT - 18)
    return sheet


def _panel(
    sheet: Drawing, left: float, counts: NDArray[np.int64], degrees: tuple[float, ...], names: tuple[str, str]
) -> None:
    """One matrix: a row for each class of the expert, a column for each that was commanded."""
    size = len(degrees) * CELL
    total = counts.sum(axis=1)
    for i in range(len(degrees)):
        for j in range(len(degrees)):
            n = int(counts[i, j])
            share = n / total[i] if total[i] else 0.0
            x, y = left + j * CELL, TOP + i * CELL
            sheet.rect(x, y, CELL, CELL, _colour(share), "#d9dfe5", 0.8)
            if n:
                sheet.text(x + CELL / 2, y + CELL / 2 + 5, str(n), 14, "middle", fill=INK if share < 0.5 else "#ffffff")
        x, y = left + i * CELL, TOP + i * CELL
        sheet.rect(x + 1, y + 1, CELL - 2, CELL - 2, stroke=INK, thick=1.4)
        label = f"{abs(degrees[i]):g}"
        sheet.text(left + (i + 0.5) * CELL, TOP + size + 19, label, 13, "middle")
        sheet.text(left - 10, TOP + (i + 0.5) * CELL + 5, label, 13, "end")
        sheet.text(left + size + 10, TOP + (i + 0.5) * CELL + 5, f"{int(total[i])}", 12.5, fill=SOFT)
    sheet.text(left + size + 10, TOP - 8, "pictures", 12, fill=SOFT)
    sheet.text(left, TOP + size + 37, f"{names[0]}", 13, fill=SOFT)
    sheet.text(left + size / 2, TOP + size + 37, "commanded, deg", 13, "middle")
    sheet.text(left + size, TOP + size + 37, f"{names[1]}", 13, "end", fill=SOFT)
    sheet.text(left - 60, TOP + 12, names[0], 13, "middle", fill=SOFT)
    sheet.text(left - 60, TOP + size / 2 - 4, "expert,", 13, "middle")
    sheet.text(left - 60, TOP + size / 2 + 13, "deg", 13, "middle")
    sheet.text(left - 60, TOP + size - 4, names[1], 13, "middle", fill=SOFT)


def _colour(share: float) -> str:
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(PALE, DEEP, strict=True))


def _legend(sheet: Drawing, x: float, y: float) -> None:
    steps = 24
    for k in range(steps):
        sheet.rect(x + 8 * k, y - 12, 8.5, 14, _colour(k / (steps - 1)))
    sheet.text(x + 8 * steps + 10, y, "share of the expert's pictures of that class, 0 to 100 %", 13)
    sheet.rect(x + 8 * steps + 390, y - 12, 14, 14, stroke=INK, thick=1.4)
    sheet.text(x + 8 * steps + 412, y, "both the same", 13)
