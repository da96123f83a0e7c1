"""Sheets of images: previews of a recipe before it is rendered, and of what each effect does."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import RecipeError
from oysterbench.recipe import CameraRecipe, RigRecipe, SplitRecipe, count, load_split, vary_split, with_rig

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]

PREVIEW_WIDTH = 400  # px: small enough for a sheet in seconds, large enough to judge
PREVIEW_FRAMES = 12
SHEET_COLUMNS = 4
JPEG_QUALITY = 80  # of sheets: no block artefacts to be seen, and seventy panels take about a megabyte
GAP = 6  # px between images
CAPTION = 24  # height, px
PAPER = (24, 26, 28)
INK = (232, 232, 228)


def preview(split: SplitRecipe, sequence: str | None = None, progress: Progress = lambda done, total: None) -> Picture:
    """Render a sheet (H, W, 3) uint8 RGB of small frames, evenly spaced over a sequence (the first by default)."""
    from oysterbench.sensors.camera import render_frame
    from oysterbench.simulation.simulated_sequence import build_sequence

    recipe = split.sequence[0] if sequence is None else split.find_sequence(sequence)
    small = _small(split)
    cameras = small.rig.camera
    if not cameras:
        raise RecipeError(f"split {split.name}: rig {split.rig.name} has no camera to look through")
    each = max(1, PREVIEW_FRAMES // len(cameras))
    simulated = build_sequence(small, recipe.name, b"")
    pictures: list[Picture] = []
    captions: list[str] = []
    for camera in cameras:
        frames = count(recipe.duration_s, camera.rate_hz)
        for index in np.unique(np.linspace(0, frames - 1, each).round().astype(int)):
            progress(len(pictures), each * len(cameras))
            pictures.append(render_frame(simulated, camera, int(index)).colour)
            captions.append(f"{camera.name}  {index / camera.rate_hz:.1f} s")
    progress(len(pictures), len(pictures))
    return sheet(pictures, captions, SHEET_COLUMNS)


def shrink(rig: RigRecipe, width: int) -> RigRecipe:
    """Return the rig with its cameras' images reduced to a width in px; fields of view are kept."""

    def reduce(camera: CameraRecipe) -> CameraRecipe:
        height = max(16, round(camera.height * width / camera.width))
        return dataclasses.replace(camera, width=width, height=height) if width < camera.width else camera

    return dataclasses.replace(rig, camera=tuple(reduce(camera) for camera in rig.camera))


def sheet(pictures: Sequence[Picture], captions: Sequence[str], columns: int) -> Picture:
    """Arrange images (H, W, 3) uint8 RGB in rows, each above its caption; all are brought to the size of the first."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    paper = np.full(
        (rows * (height + CAPTION) + (rows + 1) * GAP, columns * (width + GAP) + GAP, 3), PAPER, dtype=np.uint8
    )
    for k, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        top = GAP + (k // columns) * (height + CAPTION + GAP)
        left = GAP + (k % columns) * (width + GAP)
        paper[top : top + height, left : left + width] = _fit(picture, width, height)
        cv2.putText(paper, caption, (left + 4, top + height + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
    return paper


def _fit(picture: Picture, width: int, height: int) -> Picture:
    """Scale an image to cover width x height px, and crop its middle."""
    h, w = picture.shape[:2]
    scale = max(width / w, height / h)
    grown = cv2.resize(
        picture, (max(width, round(w * scale)), max(height, round(h * scale))), interpolation=cv2.INTER_AREA
    )
    top, left = (grown.shape[0] - height) // 2, (grown.shape[1] - width) // 2
    return np.asarray(grown[top : top + height, left : left + width], dtype=np.uint8)


def write_picture(path: Path, picture: Picture) -> None:
    """Write an (H, W, 3) uint8 RGB image as JPEG or PNG by its suffix, atomically."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    done, data = cv2.imencode(path.suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), quality)
    if not done:
        raise RecipeError(f"{path}: expected a name that ends in .jpg or .png")
    write_atomically(path, data.tobytes())


def real_pictures(folder: Path, n: int) -> Iterator[tuple[str, Picture]]:
    """Yield name and pixels of n images of a folder of real ones (`images/*.jpg`), evenly spaced by name.

    Raises RecipeError where there are none, or where one cannot be read.
    """
    files = sorted((folder / "images").glob("*.jpg")) or sorted(folder.glob("*.jpg"))
    if not files:
        raise RecipeError(f"{folder}: expected a folder with images/*.jpg, found none")
    for index in np.unique(np.linspace(0, len(files) - 1, n).round().astype(int)):
        pixels = cv2.imread(str(files[index]), cv2.IMREAD_COLOR_RGB)
        if pixels is None:
            raise RecipeError(f"{files[index]}: expected an image, could not read one")
        yield files[index].stem, np.asarray(pixels, dtype=np.uint8)


def panels(table: Path, progress: Progress = lambda done, total: None) -> tuple[list[Picture], list[str]]:
    """Render the images that a gallery file describes; also return their captions.

    A gallery file names a `split`, and has [[panel]] tables with a `caption`, a time `at_s`, and `set`, the keys of the
    split that are replaced (see `recipe.vary_split`). Optional: another `rig`, one `camera` of it, a ground-truth
    `layer`, or four frames `every_s` s apart. Or another `sensor` of the rig: a sonar's fan, or curves of the strip
    whose title starts with `strip`, next to those without the changes of `set.rig`.
    """
    split, rows = _read_gallery(table)
    from oysterbench.simulation.panel import camera_picture, sensor_picture

    pictures: list[Picture] = []
    for k, row in enumerate(rows):
        progress(k, len(rows))
        varied = _small(vary_panel(split, row, table))
        if "sensor" in row:
            calm = {**row, "set": {key: value for key, value in row["set"].items() if key != "rig"}}
            beside = _small(vary_panel(split, calm, table))
            pictures.append(sensor_picture(varied, beside, row["sensor"], row["at_s"], row.get("strip", "")))
        else:
            camera = row.get("camera", varied.rig.camera[0].name)
            pictures.append(camera_picture(varied, camera, row["at_s"], row.get("every_s"), row.get("layer")))
    progress(len(rows), len(rows))
    return pictures, [row["caption"] for row in rows]


def _small(split: SplitRecipe) -> SplitRecipe:
    return dataclasses.replace(split, rig=shrink(split.rig, PREVIEW_WIDTH))


def vary_panel(split: SplitRecipe, row: dict[str, Any], table: Path) -> SplitRecipe:
    """Split that a panel shows, with the panel's changes. Raises RecipeError for a camera that its rig lacks."""
    where = f"{table}: panel {row['caption']!r}"
    carried = with_rig(split, row["rig"], where) if "rig" in row else split
    cameras = [camera.name for camera in carried.rig.camera]
    if row.get("camera", cameras[0]) not in cameras:
        raise RecipeError(f"{where}: key 'camera': expected one of {', '.join(cameras)}, got {row['camera']!r}")
    return vary_split(carried, row["set"], where)


def _read_gallery(path: Path) -> tuple[SplitRecipe, list[dict[str, Any]]]:
    """Read the split and the panels of a gallery file. Raises RecipeError, which says what is wrong in it."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecipeError(f"{path}: no such gallery file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RecipeError(f"{path}: not valid TOML: {error}") from None
    rows = content.get("panel")
    if not isinstance(content.get("split"), str) or not isinstance(rows, list) or not rows:
        raise RecipeError(f"{path}: expected `split = NAME` and at least one [[panel]]")
    for number, row in enumerate(rows, start=1):
        for key, kind, wanted in (("caption", str, "text"), ("at_s", int | float, "seconds"), ("set", dict, "a table")):
            if not isinstance(row.get(key), kind):
                raise RecipeError(f"{path}: panel {number}: key {key!r}: expected {wanted}, got {row.get(key)!r}")
    return load_split(content["split"]), rows


def gallery(real: Path | None = None, progress: Progress = lambda done, total: None) -> Picture:
    """Render the sheet of every effect of a recipe; or, given a folder of real images, close-ups next to those."""
    folder = Path(str(resources.files("oysterbench_datasets") / "gallery"))
    if real is None:
        return sheet(*panels(folder / "reef.toml", progress), SHEET_COLUMNS)
    compared = list(real_pictures(real, 2 * SHEET_COLUMNS))  # first: a bad folder is refused before rendering starts
    pictures, captions = panels(folder / "beside-real.toml", progress)
    both: list[Picture] = []
    names: list[str] = []
    for start in range(0, len(pictures), SHEET_COLUMNS):
        row = slice(start, start + SHEET_COLUMNS)
        both += [*pictures[row], *(picture for _, picture in compared[row])]
        names += [*captions[row], *(f"real: {name}" for name, _ in compared[row])]
    return sheet(both, names, SHEET_COLUMNS)
