"""Policies over all reefs: oysters per minute on each, and the mean with its interval."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from oysterbench.evaluate.statistics import LEVEL, summarise
from oysterbench.report.drawing import INK, SOFT, Drawing
from oysterbench.report.plots import nice_ticks

MARGIN, LEFT, TOP, HEIGHT, FOOT = 30.0, 78.0, 92.0, 320.0, 96.0
STEP, MEANS = 78.0, 170.0


def ladder_figure(
    split: str, values: Mapping[str, Mapping[str, Sequence[float]]], colours: Mapping[str, str]
) -> Drawing:
    """values: policy -> reef -> oysters per minute; at least one of each. A failed rollout is at 0."""
    reefs = list(dict.fromkeys(reef for of in values.values() for reef in of))
    right = LEFT + max(STEP * len(reefs), 520.0)
    sheet = Drawing(right + 60 + MEANS + MARGIN, TOP + HEIGHT + FOOT, f"Oysters per minute on {split}")
    known = [value for of in values.values() for runs in of.values() for value in runs if not math.isnan(value)]
    summaries = {policy: summarise(of) for policy, of in values.items()}
    tops = [s.interval.high for s in summaries.values() if s.interval.known]
    most = 1.08 * max([1.0, *known, *tops])

    def at(value: float) -> float:
        return TOP + HEIGHT - value / most * HEIGHT

    sheet.text(MARGIN, 34, f"Oysters per minute on {split}", 21, bold=True)
    sheet.text(MARGIN, 56, "Live oysters seen in a rollout, each once, by its length", 13.5, fill=SOFT)
    x = MARGIN
    for policy in values:
        sheet.dot(x + 5, 73, 5, colours[policy])
        sheet.text(x + 15, 78, policy, 14, bold=True, fill=colours[policy])
        x += 40 + 8.6 * len(policy)
    for value, label in nice_ticks(0.0, most, 6):
        sheet.line(LEFT, at(value), right, at(value), "#e3e7eb", 1)
        sheet.line(right + 60, at(value), right + 60 + MEANS, at(value), "#e3e7eb", 1)
        sheet.text(LEFT - 10, at(value) + 5, label, 13, "end", fill=SOFT)
    n = len(values)
    for k, reef in enumerate(reefs):
        middle = LEFT + (k + 0.5) * (right - LEFT) / len(reefs)
        sheet.text(middle, TOP + HEIGHT + 24, reef, 13, "middle")
        for i, (policy, of) in enumerate(values.items()):
            x = middle + (i - (n - 1) / 2) * 11
            for value in of.get(reef, ()):
                if not math.isnan(value):
                    sheet.line(x, at(0), x, at(value), colours[policy], 1.2)
                    sheet.dot(x, at(value), 4.6, colours[policy])
    sheet.line(LEFT, at(0), right, at(0), SOFT, 1)
    sheet.line(right + 60, at(0), right + 60 + MEANS, at(0), SOFT, 1)
    sheet.text(right + 60 + MEANS / 2, TOP + HEIGHT + 24, f"mean of {len(reefs)}", 13, "middle", bold=True)
    for i, (policy, summary) in enumerate(summaries.items()):
        if summary.reason:
            continue
        x = right + 60 + (i + 0.5) * MEANS / n
        if summary.interval.known:
            low, high = at(summary.interval.low), at(summary.interval.high)
            sheet.line(x, low, x, high, colours[policy], 3)
            for y in (low, high):
                sheet.line(x - 6, y, x + 6, y, colours[policy], 3)
        sheet.dot(x, at(summary.mean), 6, colours[policy], INK)
        sheet.text(x, at(0) + 46 + 16 * (i % 2), f"{summary.mean:.1f}", 13, "middle", fill=colours[policy])
    reason = next((s.interval.reason for s in summaries.values() if not s.interval.known), "")
    said = reason or f"Bars: {LEVEL:.0%} intervals of the mean, by resampling the reefs."
    sheet.text(LEFT, TOP + HEIGHT + 78, said, 12.5, fill=SOFT)
    return sheet
