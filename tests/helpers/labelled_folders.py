"""Small labelled data sets, made by hand, in every form that is read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from oysterbench.annotations import LabelledImage
from oysterbench.recipe import OYSTER

HEIGHT, WIDTH = 48, 64


def picture(seed: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Dark ground with some texture, by its seed."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(40, 120, (height // 8, width // 8, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (width, height)) + rng.normal(0, 4, (height, width, 3)), 0, 255).astype(np.uint8)


def oysters(seed: int, height: int = HEIGHT, width: int = WIDTH, count: int = 4) -> np.ndarray:
    """(H, W) uint16 numbers of ellipses that do not touch."""
    rng = np.random.default_rng(1000 + seed)
    numbers = np.zeros((height, width), np.uint16)
    for k in range(count):
        one = np.zeros((height, width), np.uint8)
        centre = (int(rng.integers(8, width - 8)), int(rng.integers(8, height - 8)))
        cv2.ellipse(one, centre, (int(rng.integers(5, 9)), 4), float(rng.uniform(0, 180)), 0, 360, 1, -1)
        if not (cv2.dilate(one, np.ones((5, 5), np.uint8)).astype(bool) & (numbers > 0)).any():
            numbers[one > 0] = k + 1
    return numbers


def image(seed: int, clip: str = "clip", height: int = HEIGHT, width: int = WIDTH, count: int = 4) -> LabelledImage:
    """A picture in which oysters are lighter than the ground."""
    numbers = oysters(seed, height, width, count)
    pixels = picture(seed, height, width)
    pixels[numbers > 0] = np.clip(pixels[numbers > 0].astype(int) + 90, 0, 255)
    classes = np.where(numbers > 0, OYSTER, 0).astype(np.uint8)
    return LabelledImage(f"{clip}-{seed}", clip, pixels, classes, numbers, np.zeros((height, width), bool))


def write_png(path: Path, values: np.ndarray) -> None:
    """RGB or one channel."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), values[..., ::-1] if values.ndim == 3 else values)


def yolo_folder(folder: Path, lines: dict[str, str], manifest: str = "") -> Path:
    """A YOLO data set: name of an image -> text of its label file."""
    for k, (name, text) in enumerate(lines.items()):
        write_png(folder / "images" / f"{name}.png", picture(k))
        (folder / "labels").mkdir(exist_ok=True)
        (folder / "labels" / f"{name}.txt").write_text(text)
    if manifest:
        (folder / "manifest.csv").write_text(manifest)
    return folder
