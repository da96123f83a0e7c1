"""Some labelled pictures: where the bow would point after the commands, and the value of each pair of commands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.exploration.labelled_views import LabelledViews
from oysterbench.methods.steering import View
from oysterbench.recipe import SteeringRecipe
from oysterbench.report.drawing import INK, SOFT, Drawing
from oysterbench.report.steering import PictureRun

PICTURE, CELL, GAP, MARGIN, TOP, HEAD = 380.0, 33.0, 36.0, 30.0, 112.0, 26.0
SIDE = 44.0  # between a picture and the worths beside it
PER_ROW = 2
SHOWN = 8
RING = "#ffd92f"  # of the expert
PALE, DEEP = (247, 252, 240), (8, 64, 129)
INSET = 0.03  # of a picture: where marks are shown that lie outside


@dataclass(frozen=True)
class Sample:
    """A labelled picture of a sequence: the expert's classes, what all pairs are worth (Y, P), and the classes of each
    method."""

    name: str
    view: View
    ends: Array  # (Y, P, 2) px, where the bow would point; NaN behind the camera
    bow: Array  # (2,) px, where it points
    expert: tuple[int, int]
    worth: Array
    commanded: Mapping[str, tuple[int, int]]


def samples_of(dives: Sequence[LabelledViews], runs: Sequence[PictureRun], count: int = SHOWN) -> list[Sample]:
    """So many pictures, evenly over the sequences and their time."""
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
    """Pixels (Y, P, 2) at which the bow would point after each pair of commands, and (2,) where it points.

    A body at pitch p whose heading turns by a and whose pitch turns by b has its bow at Ry(p)^T Rz(a) Ry(p + b) x of
    where it was.
    """
    task, camera = dive.task, dive.sequence.cameras[dive.camera]
    pitch = view.state.pitch
    level = Rotation.from_euler("y", pitch).inv()
    yaw, dip = np.meshgrid(np.radians(task.yaw_deg), np.radians(task.pitch_deg), indexing="ij")
    limit = math.radians(task.max_pitch_deg)
    angles = np.stack([yaw.ravel(), np.clip(pitch + dip.ravel(), -limit, limit)], axis=-1)
    bows = (level * Rotation.from_euler("ZY", np.concatenate([angles, [[0.0, pitch]]]))).apply([1.0, 0.0, 0.0])
    rays = bows @ np.asarray(camera.T_base_cam)[:3, :3]
    lens = cv2.fisheye if camera.distortion_model == "equidistant" else cv2
    at = np.asarray(
        lens.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0]
    ).reshape(-1, 2)
    at[rays[:, 2] <= 0] = np.nan
    return at[:-1].reshape(*yaw.shape, 2), at[-1]


def samples_figure(samples: Sequence[Sample], task: SteeringRecipe, colours: Mapping[str, str]) -> Drawing:
    """Pictures, at least one, with the worths of all commands beside them."""
    height, width = samples[0].view.pixels.shape[:2]
    tall = PICTURE * height / width
    across = PICTURE + SIDE + CELL * len(task.yaw_deg)
    columns = min(PER_ROW, len(samples))
    rows = math.ceil(len(samples) / columns)
    down = HEAD + max(tall, CELL * len(task.pitch_deg) + 40.0) + GAP
    sheet = Drawing(2 * MARGIN + columns * across + (columns - 1) * GAP, TOP + rows * down, "Labelled pictures")
    sheet.text(MARGIN, 36, "Labelled pictures", 21, bold=True)
    sheet.text(
        MARGIN,
        58,
        "Where the bow points, and would point after the commands; beside it the value of each pair, in oysters",
        13.5,
        fill=SOFT,
    )
    _legend(sheet, colours)
    for k, sample in enumerate(samples):
        left = MARGIN + (k % columns) * (across + GAP)
        top = TOP + (k // columns) * down + HEAD
        _picture(sheet, left, top, tall, sample, colours)
        _worth(sheet, left + PICTURE + SIDE, top, sample, task, colours)
    return sheet


def _legend(sheet: Drawing, colours: Mapping[str, str]) -> None:
    x, y = MARGIN + 8, 84.0
    _plus(sheet, x, y - 4)
    sheet.text(x + 14, y, "bow now", 13)
    x += 90
    _ring(sheet, x, y - 4)
    sheet.text(x + 17, y, "expert", 13)
    x += 82
    for name, colour in colours.items():
        sheet.dot(x, y - 4, 5, colour, "#ffffff")
        sheet.text(x + 12, y, name, 13)
        x += 34 + 7.6 * len(name)


def _plus(sheet: Drawing, x: float, y: float) -> None:
    for colour, thick in ((INK, 4.0), ("#ffffff", 1.8)):
        sheet.line(x - 7, y, x + 7, y, colour, thick)
        sheet.line(x, y - 7, x, y + 7, colour, thick)


def _ring(sheet: Drawing, x: float, y: float) -> None:
    corners = [(x + 9 * math.cos(t), y + 9 * math.sin(t)) for t in np.linspace(0, 2 * math.pi, 24, endpoint=False)]
    sheet.polygon(corners, stroke=INK, thick=4.6)
    sheet.polygon(corners, stroke=RING, thick=2.6)


def _picture(sheet: Drawing, left: float, top: float, tall: float, sample: Sample, colours: Mapping[str, str]) -> None:
    scale = PICTURE / sample.view.pixels.shape[1]
    sheet.text(left, top - 8, f"{sample.name}, {sample.view.time_s:g} s", 13, fill=SOFT)
    sheet.image(left, top, PICTURE, tall, bright(sample.view.pixels))

    def place(pixel: Array) -> tuple[float, float] | None:
        if np.isnan(pixel).any():
            return None
        x, y = np.clip(pixel * scale, INSET * PICTURE, [(1 - INSET) * PICTURE, tall - INSET * PICTURE])
        return left + float(x), top + float(y)

    bow = place(sample.bow)
    if bow is not None:
        _plus(sheet, *bow)
    for name, classes in sample.commanded.items():
        end = place(sample.ends[classes])
        if end is not None:
            if bow is not None:
                sheet.line(*bow, *end, colours[name], 1.6)
            sheet.dot(*end, 5.4, colours[name], "#ffffff")
    end = place(sample.ends[sample.expert])
    if end is not None:
        _ring(sheet, *end)


def bright(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """As a screen shows it best: stretched to the range that all channels have in common; murky water is dark."""
    low, high = np.percentile(pixels, [0.5, 99.5])
    stretched = (pixels.astype(float) - low) * (255.0 / max(high - low, 32.0))
    return np.asarray(np.clip(stretched, 0, 255), dtype=np.uint8)


def _worth(
    sheet: Drawing, left: float, top: float, sample: Sample, task: SteeringRecipe, colours: Mapping[str, str]
) -> None:
    """A cell for each pair: yaw from left to right, pitch from up to down, as they turn the picture."""
    worth = sample.worth
    low, high = float(worth.min()), float(worth.max())
    span = max(high - low, 1e-9)
    for y in range(worth.shape[0]):
        for p in range(worth.shape[1]):
            share = (float(worth[y, p]) - low) / span
            colour = "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(PALE, DEEP, strict=True))
            sheet.rect(left + y * CELL, top + p * CELL, CELL, CELL, colour, "#ffffff", 0.6)
    for k, (name, (y, p)) in enumerate(sample.commanded.items()):
        shift = 5.0 * (k - (len(sample.commanded) - 1) / 2)
        sheet.dot(left + (y + 0.5) * CELL + shift, top + (p + 0.5) * CELL, 4.4, colours[name], "#ffffff")
    _ring(sheet, left + (sample.expert[0] + 0.5) * CELL, top + (sample.expert[1] + 0.5) * CELL)
    bottom = top + worth.shape[1] * CELL
    wide = worth.shape[0] * CELL
    sheet.text(left, bottom + 16, f"{abs(task.yaw_deg[0]):g} deg left", 12, fill=SOFT)
    sheet.text(left + wide, bottom + 16, f"{abs(task.yaw_deg[-1]):g} deg right", 12, "end", fill=SOFT)
    sheet.text(left - 6, top + 12, "up", 12, "end", fill=SOFT)
    sheet.text(left - 2, bottom - 3, "down", 12, "end", fill=SOFT)
    sheet.text(left, bottom + 36, f"value {low:.0f} (pale) to {high:.0f} (dark) oysters", 12.5)
