"""A frame of each data set, as its pages show it: which one is said in `datasets/frames/frames.toml`, and the pictures
lie beside that."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable

import cv2
import numpy as np

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import load_split

PREFIX, SUFFIX = "frame-", ".webp"
WIDTH_PX = 560
"""Of the pictures: what a card is wide on a screen of 1280 px, and a little more for finer ones."""
MOST_BYTES = 60_000
QUALITIES = (82, 75, 68, 60, 50, 40)
"""Of WebP: the first that gives at most MOST_BYTES."""


@dataclass(frozen=True)
class FrameChoice:
    """A frame of a split: that of the rig's first camera nearest to a time since the sequence began."""

    split: str
    sequence: str
    at_s: float


def folder() -> Traversable:
    """Where choices and pictures lie."""
    return resources.files("oysterbench_datasets") / "frames"


def choices() -> dict[str, FrameChoice]:
    """Split -> its frame."""
    found = tomllib.loads((folder() / "frames.toml").read_text(encoding="utf-8"))
    return {split: FrameChoice(split, row["sequence"], float(row["at_s"])) for split, row in found.items()}


@lru_cache(maxsize=1)
def pictures() -> dict[str, bytes]:
    """Split -> its frame, WebP, of those that have been made."""
    files = {split: folder() / f"{split}{SUFFIX}" for split in choices()}
    return {split: file.read_bytes() for split, file in files.items() if file.is_file()}


def file_name(split: str) -> str:
    """Of a split's picture among the site's files; empty where there is none."""
    return f"{PREFIX}{split}{SUFFIX}" if split in pictures() else ""


def split_of(file: str) -> str:
    """Whose picture a file of the site is."""
    return file.removeprefix(PREFIX).removesuffix(SUFFIX)


def render_picture(choice: FrameChoice) -> bytes:
    """The frame, rendered from the recipe: WebP, WIDTH_PX wide at most, of MOST_BYTES at most.

    Raises RecipeError where the recipe has no such sequence, no camera, or the time is beyond its end.
    """
    from oysterbench.sensors.camera import render_frame
    from oysterbench.simulation.simulated_sequence import build_sequence

    split = load_split(choice.split)
    sequence = split.find_sequence(choice.sequence)
    if not split.rig.camera or not 0 <= choice.at_s < sequence.duration_s:
        raise RecipeError(
            f"{choice.split}, {choice.sequence} at {choice.at_s:g} s: expected a rig with a camera, and a time before "
            f"{sequence.duration_s:g} s"
        )
    camera = split.rig.camera[0]
    simulated = build_sequence(split, sequence.name, b"")
    colour = render_frame(simulated, camera, round(choice.at_s * camera.rate_hz)).colour
    return small_webp(colour)


def small_webp(colour: np.ndarray) -> bytes:
    """A picture (H, W, 3) uint8 RGB as WebP, WIDTH_PX wide at most, of MOST_BYTES at most."""
    height, width = colour.shape[:2]
    if width > WIDTH_PX:
        size = (WIDTH_PX, round(height * WIDTH_PX / width))
        colour = np.asarray(cv2.resize(colour, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    bgr = cv2.cvtColor(colour, cv2.COLOR_RGB2BGR)
    for quality in QUALITIES:
        data = cv2.imencode(SUFFIX, bgr, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
        if len(data) <= MOST_BYTES:
            break
    return data
