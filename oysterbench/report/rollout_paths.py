"""Rollouts over a reef: each policy's path from above with the oysters that it saw, and oysters seen over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from oysterbench.evaluate.steering import RolloutLog
from oysterbench.evaluate.steering.rollouts import episodes, seen_so_far
from oysterbench.report.figures import INK, add_scale_bar, figure_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PER_ROW = 4
GROUND, UNSEEN, CONTACT = "#f3efe6", "#c3bcae", "#d1001f"
AROUND = 1.04
"""Size of a panel relative to the area."""

OWN = {"expert": "#00805d", "lawnmower": "#0067a5", "random": "#a33d86"}
"""Colours of the references, the same in all figures; ..."""
OTHERS = ("#c84c00", "#3f6ad8", "#8a6100", "#444444", "#5b6b00")
"""... and those of methods, in order (after Okabe & Ito 2008, darkened for paper)."""


def colours_of(policies: Sequence[str]) -> dict[str, str]:
    """A colour for each policy."""
    methods = [policy for policy in policies if policy not in OWN]
    return {policy: OWN.get(policy) or OTHERS[methods.index(policy) % len(OTHERS)] for policy in policies}


@figure_style()
def rollouts_figure(reef: str, logs: Mapping[str, RolloutLog], colours: Mapping[str, str]) -> Figure:
    """Draw the rollouts of policies, at least one, over one reef."""
    rows = math.ceil(len(logs) / PER_ROW)
    columns = math.ceil(len(logs) / rows)
    figure = new_figure(f"Rollouts over {reef}", max(4.0 * columns, 9.0), 4.6 * rows + 4.6)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[4.6] * rows + [3.0])
    panels = [figure.add_subplot(grid[divmod(k, columns)]) for k in range(len(logs))]
    for panel, (policy, log) in zip(panels, logs.items(), strict=True):
        _from_above(panel, policy, log, colours[policy])
    first = next(iter(logs.values()))
    add_scale_bar(panels[0], 2 * first.half_m)
    _over_time(figure.add_subplot(grid[rows, :]), logs, colours)
    seconds, side = max(log.step_s * len(log.commands) for log in logs.values()), 2 * first.half_m
    about = (
        f"{seconds:g} s each, from the same place; {len(first.oysters)} live oysters on {side:g} m x {side:g} m within "
        "the fence.\nFrom above; up is +y of the map, right is +x. The frame is the fence."
    )
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower left", ncols=5, title=about, alignment="left")
    for handle in legend.legend_handles[:2]:
        handle.set_sizes([36.0])  # type: ignore[union-attr]
    return figure


def _from_above(axes: Axes, policy: str, log: RolloutLog, colour: str) -> None:
    from matplotlib.patches import Rectangle

    minutes, contacts = log.step_s * len(log.commands) / 60.0, episodes(log.contact)
    about = f"{log.seen.sum()} seen" + (f", {log.seen.sum() / minutes:.0f} per min" if minutes else "")
    about += f"; {log.covered[-1]:.0%} covered; {contacts} contact{'' if contacts == 1 else 's'}"
    axes.set_title(policy, color=colour, pad=22)
    axes.annotate(about, (0, 1), (0, 6), xycoords="axes fraction", textcoords="offset points", size=10)
    for seen, shade, name in ((False, UNSEEN, "not seen"), (True, colour, "seen")):
        x, y, _ = log.oysters[log.found == seen].T
        axes.scatter(x, y, s=9, color=shade, label=name)
    half = log.half_m
    axes.add_patch(Rectangle((-half, -half), 2 * half, 2 * half, fill=False, edgecolor=INK, linewidth=1.2))
    x, y = log.states[:, :2].T
    axes.plot(x, y, color="white", linewidth=4.4)
    axes.plot(x, y, color=INK, linewidth=2)
    axes.plot(x[:1], y[:1], "o", color="white", markeredgecolor=INK, markersize=10, label="begin")
    axes.plot(x[-1:], y[-1:], "s", color=INK, markersize=9, label="end")
    axes.plot(x[log.contact], y[log.contact], "x", color=CONTACT, markersize=10, markeredgewidth=2.2, label="contact")
    reach = AROUND * half
    axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach), facecolor=GROUND, xticks=(), yticks=())
    axes.spines[:].set_visible(False)


def _over_time(axes: Axes, logs: Mapping[str, RolloutLog], colours: Mapping[str, str]) -> None:
    """Draw the curves, with the legend in the order of their final values."""
    for policy, log in sorted(logs.items(), key=lambda item: -item[1].seen.sum()):
        axes.plot(*seen_so_far(log), color=colours[policy], linewidth=2.6, label=policy)
    axes.set(title="Live oysters seen so far", xlabel="time, s", ylim=(0, None))
    axes.margins(x=0)
    axes.grid(axis="y")
    axes.legend(loc="upper left", labelcolor="linecolor")
