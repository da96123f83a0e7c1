"""Figures of an evaluation of steering: written as PNG, and passed to the report as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.atomic import write_atomically
from oysterbench.evaluate.steering import RolloutLog
from oysterbench.evaluate.steering.dataset import Whole
from oysterbench.exploration.labelled_views import LabelledViews
from oysterbench.report.cards import Card
from oysterbench.report.confusion import confusion_figure
from oysterbench.report.figures import png_of, svg_of
from oysterbench.report.ladder import ladder_figure
from oysterbench.report.rollout_paths import colours_of, rollouts_figure
from oysterbench.report.steering import PictureRun, RolloutRun
from oysterbench.report.steering_samples import samples_figure, samples_of
from oysterbench.results.records import samples as values_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures = list[tuple[Path, Card]]
"""Figures, each as the file of its PNG and its card."""


def picture_figures(
    dives: Sequence[LabelledViews], runs: Sequence[PictureRun], wholes: Mapping[str, Whole], folder: Path
) -> Figures:
    """Make figures of sample images with the commands, and of each method's confusion matrices over all images."""
    methods = list(dict.fromkeys(run.record.method for run in runs if run.commands is not None))
    task = dives[0].task
    made = [
        _kept(
            folder / f"confusion-{_safe(method)}.png",
            confusion_figure(method, whole.score, task, whole.runs),
            f"Commands of {method} by command of the expert",
        )
        for method, whole in wholes.items()
    ]
    samples = samples_of(dives, runs)
    if samples and methods:
        drawn = samples_figure(samples, task, colours_of(methods))
        made.append(_kept(folder / "images.png", drawn, "Sample images"))
    return made


def rollout_figures(runs: Sequence[RolloutRun], folder: Path) -> Figures:
    """Make figures of the policies over all reefs, then of each reef with its rollouts; empty if all of them failed."""
    policies = list(dict.fromkeys(run.record.method for run in runs))
    reefs = list(dict.fromkeys(run.record.sequence for run in runs))
    colours = colours_of(policies)
    if all(run.log is None for run in runs):
        return []
    of_policies = {policy: [run.record for run in runs if run.record.method == policy] for policy in policies}
    values = {policy: values_of(records, "oysters_per_min") for policy, records in of_policies.items()}
    split = runs[0].record.split
    made = [_kept(folder / "policies.png", ladder_figure(split, values, colours), "Policies over all reefs")]
    for reef in reefs:
        logs: dict[str, RolloutLog] = {
            run.record.method: run.log for run in runs if run.record.sequence == reef and run.log is not None
        }
        if logs:
            made.append(
                _kept(folder / f"rollouts-{reef}.png", rollouts_figure(reef, logs, colours), f"Rollouts over {reef}")
            )
    return made


def _kept(path: Path, figure: Figure, title: str) -> tuple[Path, Card]:
    write_atomically(path, png_of(figure))
    return path, Card(title, svg_of(figure))


def _safe(name: str) -> str:
    return "".join(sign if sign.isalnum() or sign in "_.-" else "_" for sign in name)
