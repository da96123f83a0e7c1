"""The preview frame of each data set on its pages: `datasets/frames/frames.toml` says which frame it is, and the images
are stored beside that file."""

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
"""Width of the images: that of a card on a screen of 1280 px, and a little more for finer screens."""
MOST_BYTES = 60_000
QUALITIES = (82, 75, 68, 60, 50, 40)
"""WebP qualities to try: the first that gives at most MOST_BYTES is used."""


@dataclass(frozen=True)
class FrameChoice:
    """A frame of a split: that of the rig's first camera nearest to `at_s` seconds after the start of the sequence."""

    split: str
    sequence: str
    at_s: float


def folder() -> Traversable:
    """Folder of the choices and images."""
    return resources.files("oysterbench_datasets") / "frames"


def choices() -> dict[str, FrameChoice]:
    """Split -> choice of its frame."""
    found = tomllib.loads((folder() / "frames.toml").read_text(encoding="utf-8"))
    return {split: FrameChoice(split, row["sequence"], float(row["at_s"])) for split, row in found.items()}


@lru_cache(maxsize=1)
def pictures() -> dict[str, bytes]:
    """Split -> its frame as WebP, for the splits whose frame was rendered."""
    files = {split: folder() / f"{split}{SUFFIX}" for split in choices()}
    return {split: file.read_bytes() for split, file in files.items() if file.is_file()}


def file_name(split: str) -> str:
    """File name of a split's image on the site; empty where there is none."""
    return f"{PREFIX}{split}{SUFFIX}" if split in pictures() else ""


def split_of(file: str) -> str:
    """Split that an image file of the site belongs to."""
    return file.removeprefix(PREFIX).removesuffix(SUFFIX)


def render_picture(choice: FrameChoice) -> bytes:
    """Render the frame from the recipe as WebP, at most WIDTH_PX wide, of MOST_BYTES where a quality reaches that.

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
    """Encode an image (H, W, 3) uint8 RGB as WebP, at most WIDTH_PX wide, of at most MOST_BYTES if any of QUALITIES
    reaches that, or else at the lowest."""
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
