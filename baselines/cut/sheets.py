"""What a training leaves to look at: its losses as a table and a plot, and samples beside real pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oysterbench.annotations import LabelledImage
from oysterbench.core.files import write_atomically
from oysterbench.report.plots import nice_ticks
from oysterbench.simulation.gallery import sheet, write_picture
from oysterbench_baselines.cut.colour import lab
from oysterbench_baselines.cut.pictures import Picture
from oysterbench_baselines.cut.training import TERMS, curves
from oysterbench_baselines.learning.checkpoint import Checkpoint

OUTLINE = (255, 230, 0)
INKS = ((31, 119, 180), (214, 39, 40), (44, 160, 44), (148, 103, 189))
"""Of the curves, in the order of `TERMS`."""
SMOOTH = 50
"""Steps that a point of a curve is the mean of: single crops differ more than a training changes."""
WIDTH, HEIGHT, MARGIN = 900, 420, 60
"""px of the plot."""


def write_curves(checkpoint: Checkpoint, folder: Path) -> None:
    """losses.csv, the terms of each step, and losses.png, their running means."""
    values = curves(checkpoint)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("step", *TERMS))
    rows.writerows((k + 1, *(f"{value:.6g}" for value in row)) for k, row in enumerate(values))
    write_atomically(folder / "losses.csv", text.getvalue().encode())
    write_picture(folder / "losses.png", plot(values))


def plot(values: np.ndarray) -> Picture:
    """(H, W, 3) uint8 of losses (steps, TERMS): each term over its own greatest value, which is said."""
    paper = np.full((HEIGHT, WIDTH, 3), 255, dtype=np.uint8)
    right, bottom = WIDTH - 20, HEIGHT - MARGIN
    cv2.rectangle(paper, (MARGIN, 20), (right, bottom), (190, 190, 190), 1)
    window = max(1, min(SMOOTH, len(values)))
    steps = np.arange(window, len(values) + 1)
    for k, term in enumerate(TERMS):
        if len(values) < 2 or not values[:, k].any():
            continue
        sums = np.cumsum(np.concatenate([[0.0], values[:, k]]))
        mean = (sums[window:] - sums[:-window]) / window
        top = float(mean.max())
        x = MARGIN + (right - MARGIN) * steps / len(values)
        y = bottom - (bottom - 30) * mean / top
        points = np.column_stack([x, y]).round().astype(np.int32)
        cv2.polylines(paper, [points], False, INKS[k], 2, cv2.LINE_AA)
        _write(paper, f"{term} / {top:.3g}", (MARGIN + 10 + 200 * k, HEIGHT - 12), INKS[k])
    for place, label in nice_ticks(0, max(1, len(values)), 6):
        _write(
            paper, label, (int(MARGIN + (right - MARGIN) * place / max(1, len(values))) - 12, bottom + 20), (60, 60, 60)
        )
    return paper


def _write(paper: Picture, text: str, place: tuple[int, int], ink: tuple[int, int, int]) -> None:
    cv2.putText(paper, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, 1, cv2.LINE_AA)


def sample_sheet(images: Sequence[LabelledImage], translations: Sequence[Picture], real: Sequence[Picture]) -> Picture:
    """A row for each image: as rendered, translated, translated with the outlines of its mask, and the real picture
    whose colours are nearest to those of the translation."""
    marks = [colour_mark(picture) for picture in real]
    pictures: list[Picture] = []
    captions: list[str] = []
    for image, translation in zip(images, translations, strict=True):
        mark = colour_mark(translation)
        nearest = int(np.argmin([np.abs(other - mark).sum() for other in marks]))
        pictures += [image.pixels, translation, outlined(translation, image), real[nearest]]
        captions += [image.name[-40:], "translated", "its mask", "nearest real"]
    return sheet(pictures, captions, 4)


def colour_mark(picture: Picture) -> np.ndarray:
    """(6,) mean and standard deviation of L, a and b."""
    values = lab(picture).reshape(-1, 3)
    return np.concatenate([values.mean(axis=0), values.std(axis=0)])


def outlined(picture: Picture, image: LabelledImage) -> Picture:
    """A picture with the outlines of the image's oysters."""
    drawn = np.ascontiguousarray(picture.copy())
    numbers = np.where(image.oysters, image.instances, 0)
    for number in np.unique(numbers)[1:]:
        lines, _ = cv2.findContours((numbers == number).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, lines, -1, OUTLINE, 1)
    return drawn
