"""Policies over all reefs: oysters per minute on each, and the mean with its interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from oysterbench.evaluate.statistics import LEVEL, summarise
from oysterbench.report.figures import INK, add_note, figure_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 0.14
"""Distance between policies on a reef, relative to the distance between reefs."""


@figure_style()
def ladder_figure(
    split: str, values: Mapping[str, Mapping[str, Sequence[float]]], colours: Mapping[str, str]
) -> Figure:
    """Draw the figure. values: policy -> reef -> oysters per minute; at least one of each. A failed rollout is at 0."""
    reefs = list(dict.fromkeys(reef for of in values.values() for reef in of))
    summaries = {policy: summarise(of) for policy, of in values.items()}
    wide, narrow = max(1.0 * len(reefs), 7.0), max(0.6 * len(values), 2.4)
    figure = new_figure(f"Oysters per minute on {split}", wide + narrow, 6.0)
    single, mean = figure.subplots(1, 2, sharey=True, width_ratios=(wide, narrow))
    for i, (policy, of) in enumerate(values.items()):
        shift = STEP * (i - (len(values) - 1) / 2)
        points = [(k + shift, value) for k, reef in enumerate(reefs) for value in of.get(reef, ())]
        x, y = zip(*points, strict=True) if points else ((), ())
        single.vlines(x, 0, y, color=colours[policy], linewidth=1.2)
        single.plot(x, y, "o", color=colours[policy], label=policy)
        summary = summaries[policy]
        if not summary.reason:
            low, high = summary.interval.low, summary.interval.high
            bar = [[summary.mean - low], [high - summary.mean]] if summary.interval.known else None
            look = {"color": colours[policy], "linewidth": 3, "capsize": 5, "capthick": 3}
            mean.errorbar(i, summary.mean, bar, fmt="o", markersize=9, markeredgecolor=INK, **look)
    single.set_xticks(range(len(reefs)), reefs)
    single.set(xlim=(-0.5, len(reefs) - 0.5), ylim=(0, None))
    single.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=6, labelcolor="linecolor")
    mean.set_title(f"mean of {len(reefs)}", loc="center")
    mean.set_xlim(-0.5, len(values) - 0.5)
    mean.set_xticks(range(len(values)), ["" if s.reason else f"{s.mean:.1f}" for s in summaries.values()])
    for label, policy in zip(mean.get_xticklabels(), values, strict=True):
        label.set_color(colours[policy])
    for axes in (single, mean):
        axes.grid(axis="y")
        axes.spines["left"].set_visible(False)
        axes.tick_params(length=0)
    reason = next((s.interval.reason for s in summaries.values() if not s.interval.known), "")
    intervals = reason or f"Bars: {LEVEL:.0%} intervals of the mean, by resampling the reefs."
    add_note(figure, "Live oysters seen in a rollout, each counted once, per minute.", intervals)
    return figure
