"""Confusion matrices of a policy: the expert's classes against the commanded ones, yaw and pitch side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.runs import span_of_runs
from oysterbench.evaluate.steering import PictureScore
from oysterbench.recipe import SteeringRecipe
from oysterbench.report.figures import INK, SOFT, add_note, figure_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@figure_style()
def confusion_figure(method: str, score: PictureScore, task: SteeringRecipe, runs: Sequence[int] = (1,)) -> Figure:
    """Draw a panel for yaw, from left to right as in the image, and one for pitch, from up to down. runs: numbers of
    runs on the sequences, in each of which every image counts."""
    figure = new_figure(f"Confusions of {method}", 13.0, 7.0)
    panels = figure.subplots(1, 2)
    for panel, axis, counts, degrees, ends in (
        (panels[0], "yaw", score.yaw, task.yaw_deg, ("left", "right")),
        (panels[1], "pitch", score.pitch, task.pitch_deg, ("up", "down")),
    ):
        _matrix(panel, counts, degrees, ends)
        accuracy, f1, cost = (score.metrics[f"{axis}_{key}"] for key in ("accuracy", "macro_f1", "cost_deg"))
        found = (
            "" if math.isnan(accuracy) else f": {accuracy:.0%} correct, F1 {f1:.2f}, off by {cost:.1f} deg on average"
        )
        panel.set_title(axis.capitalize() + found)
    label = "share of the expert's images of that class"
    figure.colorbar(panels[0].collections[0], ax=panels, label=label, format="{x:.0%}", shrink=0.8)
    several = max(runs) > 1
    within = f", in each of {span_of_runs(runs)}" if several else ""
    pictures = f"{score.metrics['pictures']:.0f} images{within}, by the expert's command and that of {method}"
    of_all = f", in {span_of_runs(runs)} together" if several else ""
    add_note(figure, pictures, f"Framed: both agree. Right of a row: images of that class{of_all}.")
    return figure


def _matrix(axes: Axes, counts: NDArray[np.int64], degrees: tuple[float, ...], ends: tuple[str, str]) -> None:
    """Draw a matrix with a row for each class of the expert and a column for each commanded class."""
    from matplotlib.patches import Rectangle

    total = counts.sum(axis=1)
    share = counts / np.maximum(total, 1)[:, None]
    axes.pcolormesh(share, cmap="Blues", vmin=0.0, vmax=1.0, edgecolors="#d9dfe5", linewidth=0.8)
    for i, j in zip(*np.nonzero(counts), strict=True):
        colour = INK if share[i, j] < 0.5 else "white"
        axes.text(j + 0.5, i + 0.5, str(counts[i, j]), ha="center", va="center", color=colour)
    for i in range(len(degrees)):
        axes.add_patch(Rectangle((i, i), 1, 1, fill=False, edgecolor=INK, linewidth=1.4, clip_on=False))
    middles, labels = np.arange(len(degrees)) + 0.5, [f"{abs(value):g}" for value in degrees]
    axes.set(aspect="equal", ylim=(len(degrees), 0))
    axes.set_xticks(middles, labels)
    axes.set_yticks(middles, labels)
    axes.set_xlabel(f"{ends[0]}  \N{LEFTWARDS ARROW}  commanded, deg  \N{RIGHTWARDS ARROW}  {ends[1]}")
    axes.set_ylabel(f"{ends[1]}  \N{LEFTWARDS ARROW}  expert, deg  \N{RIGHTWARDS ARROW}  {ends[0]}")
    sums = axes.secondary_yaxis("right")
    sums.set_yticks(middles, [str(n) for n in total])
    sums.tick_params(length=0, colors=SOFT)
