"""Sample labelled images, with where the bow would point after each command and the value of each command pair."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.exploration.labelled_views import LabelledViews
from oysterbench.methods.steering import View
from oysterbench.recipe import SteeringRecipe
from oysterbench.report.figures import INK, SOFT, figure_style, new_figure
from oysterbench.report.steering import PictureRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PER_ROW = 2
SHOWN = 8
RING = "#ffd92f"  # colour of the ring around the expert's command
INSET = 0.03  # share of the image width: marks outside the image are shown at this distance from its edge


@dataclass(frozen=True)
class Sample:
    """A labelled image of a sequence: the expert's classes, the action values (Y, P) of all command pairs, in oysters,
    and the classes that each method commanded."""

    name: str
    view: View
    ends: Array  # (Y, P, 2) px, where the bow would point after each pair; NaN behind the camera
    bow: Array  # (2,) px, where the bow points now
    expert: tuple[int, int]
    action_values: Array
    commanded: Mapping[str, tuple[int, int]]


def samples_of(dives: Sequence[LabelledViews], runs: Sequence[PictureRun], count: int = SHOWN) -> list[Sample]:
    """Choose `count` images, evenly over the sequences and over time."""
    found = []
    for i, dive in enumerate(dives):
        share = count // len(dives) + (i < count % len(dives))
        wanted = {int(k) for k in np.linspace(0, len(dive.table) - 1, share + 2)[1:-1]} if len(dive.table) else set()
        commands = {
            run.record.method: run.commands.classes
            for run in runs
            if run.record.sequence == dive.name and run.commands is not None
        }
        for k, view in enumerate(dive.views()):
            if k in wanted:
                yaw, pitch = (int(c) for c in dive.labels.classes[k])
                found.append(
                    Sample(
                        dive.name,
                        view,
                        *bow_pixels(dive, view),
                        (yaw, pitch),
                        dive.labels.action_values[k],
                        {name: (int(classes[k, 0]), int(classes[k, 1])) for name, classes in commands.items()},
                    )
                )
    return found


def bow_pixels(dive: LabelledViews, view: View) -> tuple[Array, Array]:
    """Compute the pixels (Y, P, 2) at which the bow would point after each pair of commands, and the one (2,) where it
    points now.

    If a body at pitch p turns its heading by a and its pitch by b, its bow direction is Ry(p)^T Rz(a) Ry(p + b) x in
    its previous body frame.
    """
    task, camera = dive.task, dive.sequence.cameras[dive.camera]
    pitch = view.state.pitch
    from_euler = scipy.spatial.transform.Rotation.from_euler
    yaw, dip = np.meshgrid(np.radians(task.yaw_deg), np.radians(task.pitch_deg), indexing="ij")
    limit = math.radians(task.max_pitch_deg)
    angles = np.stack([yaw.ravel(), np.clip(pitch + dip.ravel(), -limit, limit)], axis=-1)
    turns = from_euler("ZY", np.concatenate([angles, [[0.0, pitch]]]))
    bows = (from_euler("y", pitch).inv() * turns).apply([1.0, 0.0, 0.0])
    rays = bows @ np.asarray(camera.T_base_cam)[:3, :3]
    lens = cv2.fisheye if camera.distortion_model == "equidistant" else cv2
    at = np.asarray(
        lens.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0]
    ).reshape(-1, 2)
    at[rays[:, 2] <= 0] = np.nan
    return at[:-1].reshape(*yaw.shape, 2), at[-1]


@figure_style()
def samples_figure(samples: Sequence[Sample], task: SteeringRecipe, colours: Mapping[str, str]) -> Figure:
    """Draw images, at least one, with the values of all command pairs beside them."""
    columns = min(PER_ROW, len(samples))
    rows = math.ceil(len(samples) / columns)
    figure = new_figure("Labelled images", 8.0 * columns, 4.0 * rows + 1.4)
    panels = figure.subplots(rows, 2 * columns, width_ratios=[4, 3] * columns, squeeze=False).ravel()
    for k, sample in enumerate(samples):
        _picture(panels[2 * k], sample, colours)
        _action_values(panels[2 * k + 1], sample, task, colours)
    for panel in panels[2 * len(samples) :]:
        panel.set_axis_off()
    about = "Where the bow points now and after the commands;\nbeside it the value of each pair, in oysters."
    for method, colour in colours.items():
        panels[0].plot([], [], "o", color=colour, label=method)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=4 * columns, title=about, alignment="left")
    return figure


def _picture(axes: Axes, sample: Sample, colours: Mapping[str, str]) -> None:
    from matplotlib.patheffects import withStroke

    height, width = sample.view.pixels.shape[:2]
    axes.imshow(bright(sample.view.pixels))
    axes.set_title(f"{sample.name}, {sample.view.time_s:g} s", color=SOFT, weight="normal")
    axes.set_axis_off()
    margin = INSET * width
    ends, bow = (np.clip(at, margin, (width - margin, height - margin)) for at in (sample.ends, sample.bow))
    ink = [withStroke(linewidth=4.0, foreground=INK)]
    axes.plot(*bow[:, None], "+", color="white", markersize=14, markeredgewidth=1.8, path_effects=ink, label="bow now")
    for method, classes in sample.commanded.items():
        axes.plot(*np.stack([bow, ends[classes]], axis=-1), color=colours[method], linewidth=1.6)
        axes.plot(*ends[classes][:, None], "o", color=colours[method], markersize=10, markeredgecolor="white")
    _ring(axes, *ends[sample.expert])


def _ring(axes: Axes, x: float, y: float) -> None:
    """Draw a ring around the expert's command."""
    from matplotlib.patheffects import withStroke

    look: dict[str, Any] = {
        "clip_on": False,
        "markersize": 16,
        "markeredgewidth": 2.6,
        "markeredgecolor": RING,
        "fillstyle": "none",
    }
    axes.plot([x], [y], "o", path_effects=[withStroke(linewidth=4.6, foreground=INK)], label="expert", **look)


def bright(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretch an image to the full range, all channels alike, for display: images of murky water are dark."""
    low, high = np.percentile(pixels, [0.5, 99.5])
    stretched = (pixels.astype(float) - low) * (255.0 / max(high - low, 32.0))
    return np.asarray(np.clip(stretched, 0, 255), dtype=np.uint8)


def _action_values(axes: Axes, sample: Sample, task: SteeringRecipe, colours: Mapping[str, str]) -> None:
    """Draw a cell for each command pair: yaw from left to right, pitch from up to down, as they turn the view."""
    values = sample.action_values
    axes.pcolormesh(values.T, cmap="GnBu", edgecolors="white", linewidth=0.6)
    for k, (method, (yaw, pitch)) in enumerate(sample.commanded.items()):
        shift = 0.15 * (k - (len(sample.commanded) - 1) / 2)
        axes.plot(yaw + 0.5 + shift, pitch + 0.5, "o", color=colours[method], markersize=9, markeredgecolor="white")
    _ring(axes, sample.expert[0] + 0.5, sample.expert[1] + 0.5)
    axes.set(aspect="equal", ylim=(values.shape[1], 0))
    axes.set_xticks(
        [0.5, values.shape[0] - 0.5], [f"{abs(task.yaw_deg[0]):g} deg left", f"{abs(task.yaw_deg[-1]):g} deg right"]
    )
    axes.set_yticks([0.5, values.shape[1] - 0.5], ["up", "down"])
    axes.set_xlabel(f"value {values.min():.0f} (pale) to {values.max():.0f} (dark) oysters")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
