"""Outputs of a training to inspect: its losses as a table and a plot, and samples beside real images."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oysterbench.annotations import LabelledImage
from oysterbench.core.atomic import write_atomically
from oysterbench.simulation.gallery import sheet
from oysterbench_baselines.cut.colour import lab
from oysterbench_baselines.cut.pictures import Picture
from oysterbench_baselines.cut.training import TERMS, curves
from oysterbench_baselines.learning.checkpoint import Checkpoint

OUTLINE = (255, 230, 0)
SMOOTH = 50
"""Number of steps averaged for each point of a curve: single crops differ more than a training changes."""


def write_curves(checkpoint: Checkpoint, folder: Path) -> None:
    """Write losses.csv, the terms of each step, and losses.png, their running means."""
    values = curves(checkpoint)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("step", *TERMS))
    rows.writerows((k + 1, *(f"{value:.6g}" for value in row)) for k, row in enumerate(values))
    write_atomically(folder / "losses.csv", text.getvalue().encode())
    write_atomically(folder / "losses.png", plot(values))


def plot(values: np.ndarray) -> bytes:
    """Plot losses (steps, TERMS) as PNG: running means of each term divided by its own maximum, which the legend
    states."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots()
    window = max(1, min(SMOOTH, len(values)))
    for k, term in enumerate(TERMS):
        if len(values) > 1 and values[:, k].any():
            mean = np.convolve(values[:, k], np.full(window, 1 / window), "valid")
            axes.plot(np.arange(window, len(values) + 1), mean / mean.max(), label=f"{term} / {mean.max():.3g}")
    axes.set(xlabel="step", ylim=(0, 1.05))
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100, metadata={"Software": None})
    return data.getvalue()


def sample_sheet(images: Sequence[LabelledImage], translations: Sequence[Picture], real: Sequence[Picture]) -> Picture:
    """Sheet with a row for each image: as rendered, translated, translated with the outlines of its mask, and the real
    image whose colours are nearest to those of the translation."""
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
    """Mean and standard deviation (6,) of L, a and b."""
    values = lab(picture).reshape(-1, 3)
    return np.concatenate([values.mean(axis=0), values.std(axis=0)])


def outlined(picture: Picture, image: LabelledImage) -> Picture:
    """Draw the outlines of the image's oysters on a copy of a picture."""
    drawn = np.ascontiguousarray(picture.copy())
    numbers = np.where(image.oysters, image.instances, 0)
    for number in np.unique(numbers)[1:]:
        lines, _ = cv2.findContours((numbers == number).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, lines, -1, OUTLINE, 1)
    return drawn
