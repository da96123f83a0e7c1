"""The viewer's panels of a camera: its frames, and their ground-truth layers in colour."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.recipe import CLASSES
from oysterbench.sensors.panels import BACKGROUND, WIDTH, Frame, Panel, blank, coloured, jpeg, latest

CLASS_COLOURS = {
    "bottom": (194, 178, 128),
    "oyster": (230, 75, 60),
    "stone": (130, 130, 130),
    "plant": (70, 160, 70),
    "sponge": (240, 130, 200),
    "vehicle": (60, 110, 220),
    "hash": (245, 245, 230),
    "fish": (0, 200, 220),
    "crab": (255, 150, 0),
    "debris": (150, 100, 50),
    "tether": (255, 235, 0),
}
"""RGB of each class; water is background."""

HEADER = 600  # bytes of a JPEG before its pixels
NEAR_M = 1.0  # depth that is shown half as bright as what touches the lens
FULL_FLOW = 0.08  # share of the image's width: flow from which colours are brightest
UNMOVED = 70  # grey level of what stands still
MOVED = (255, 150, 0)

MOST_TALL = 8
"""Greatest height of a panel, in widths: a forged calibration cannot make one taller."""


def camera_panels(sequence: Any, name: str) -> list[Panel]:
    """Panels of a camera: its frames, then its layers in the order of the file."""
    calibration = sequence.cameras[name]
    width = min(WIDTH, calibration.width)
    tall = round(calibration.height * width / calibration.width)
    size = (width, min(max(1, tall), MOST_TALL * width))
    panels = [Panel(name, *size, partial(_frames, sequence, name, size), size[0] * size[1] // 4)]
    for topic, _, count in sequence.contents():
        layer = topic.removeprefix(f"/{name}/")
        if layer in LAYER_PICTURES and layer != topic and count:
            meaning, _ = LAYER_PICTURES[layer]
            each = HEADER + size[0] * size[1] // 8
            panels.append(Panel(layer, *size, partial(_layers, sequence, name, layer, size), each, name, meaning))
    return panels


def layer_picture(layer: str, pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Draw a layer's pixels, as in `Image`, as an image (H, W, 3) uint8 RGB."""
    _, draw = LAYER_PICTURES[layer]
    return np.asarray(draw(pixels), dtype=np.uint8)


def _frames(sequence: Any, name: str, size: tuple[int, int], times: NDArray[np.int64]) -> Iterator[Frame]:
    for image in latest(sequence.images, name, times):
        if image is None:
            yield Frame(jpeg(blank(*size)), None)
        else:
            yield Frame(_shown(image.pixels, size, cv2.INTER_AREA), image.stamp_ns)


def _layers(sequence: Any, name: str, layer: str, size: tuple[int, int], times: NDArray[np.int64]) -> Iterator[Frame]:
    for image in latest(partial(_read_layer, sequence, layer), name, times):
        if image is None:
            yield Frame(jpeg(blank(*size)), None)
        else:
            yield Frame(_shown(layer_picture(layer, image.pixels), size, cv2.INTER_NEAREST), image.stamp_ns)


def _read_layer(sequence: Any, layer: str, name: str, start_ns: int, end_ns: int) -> Iterator[Any]:
    found: Iterator[Any] = sequence.layer(name, layer, start_ns, end_ns)
    return found


def _shown(pixels: NDArray[Any], size: tuple[int, int], how: int) -> bytes:
    return jpeg(cv2.cvtColor(cv2.resize(pixels, size, interpolation=how), cv2.COLOR_RGB2BGR))


def _scaled(shares: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    """RGB of shares (H, W) from 0 to 1; background where they are not known."""
    picture = coloured(np.where(known, np.clip(shares, 0.0, 1.0), 0.0).astype(np.float32))[..., ::-1].copy()
    picture[~known] = BACKGROUND
    return picture


def _depth(depth: NDArray[Any]) -> NDArray[Any]:
    return _scaled(NEAR_M / (NEAR_M + depth), depth > 0)


def _shares(shares: NDArray[Any]) -> NDArray[Any]:
    return _scaled(shares, np.isfinite(shares))


def _classes(classes: NDArray[Any]) -> NDArray[Any]:
    table = np.full((256, 3), BACKGROUND, dtype=np.uint8)
    for number, name in CLASSES.items():
        table[number] = CLASS_COLOURS.get(name, (BACKGROUND,) * 3)
    return np.asarray(table[classes])


def _instances(instances: NDArray[Any]) -> NDArray[Any]:
    """Colour instances by hues in steps of the golden ratio, so that consecutive numbers differ."""
    hue = np.arange(65536) * 0.618034 % 1.0
    table = np.stack([np.floor(180 * hue), np.full(65536, 170), np.full(65536, 235)], axis=-1).astype(np.uint8)
    table = np.asarray(cv2.cvtColor(table[None], cv2.COLOR_HSV2RGB)[0])
    table[0] = BACKGROUND
    return np.asarray(table[instances])


def _normals(normals: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(np.rint(127.5 * (np.nan_to_num(normals) + 1.0)))


def _light(light: NDArray[Any]) -> NDArray[Any]:
    return np.rint(255.0 * np.clip(light / max(float(np.percentile(light, 99.5)), 1e-9), 0.0, 1.0) ** (1 / 2.2))


def _dynamic(dynamic: NDArray[Any]) -> NDArray[Any]:
    return np.where(dynamic[..., None] > 0, np.array(MOVED), UNMOVED)


def _flow(flow: NDArray[Any]) -> NDArray[Any]:
    """Colour flow: direction as hue, from red to the right through yellow downwards (Baker et al. 2011), magnitude as
    brightness."""
    known = np.isfinite(flow).all(axis=-1)
    right, down = np.where(known, flow[..., 0], 0.0), np.where(known, flow[..., 1], 0.0)
    size = np.clip(np.hypot(right, down) / (FULL_FLOW * flow.shape[1]), 0.0, 1.0)
    hue = np.floor(np.arctan2(down, right) / (2 * np.pi) % 1.0 * 180) % 180
    colours = np.stack([hue, np.full_like(hue, 220), np.rint(255 * np.sqrt(size))], axis=-1).astype(np.uint8)
    picture = np.asarray(cv2.cvtColor(colours, cv2.COLOR_HSV2RGB))
    picture[~known] = BACKGROUND
    return picture


LIGHT = "as light, the brightest white"
LAYER_PICTURES: Mapping[str, tuple[str, Callable[[NDArray[Any]], NDArray[Any]]]] = {
    "depth": ("near bright", _depth),
    "class": ("a colour each", _classes),
    "instance": ("a colour each", _instances),
    "normals": ("right red, down green, away blue", _normals),
    "clean": (LIGHT, _light),
    "direct": (LIGHT, _light),
    "forward_scatter": (LIGHT, _light),
    "backscatter": (LIGHT, _light),
    "snow": (LIGHT, _light),
    "visibility": ("share unhidden, from black to yellow", _shares),
    "dynamic": ("orange moves by itself", _dynamic),
    "flow": ("direction as hue, right red, down green; fast bright", _flow),
    "transmittance": ("share of light that arrives, from black to yellow", _shares),
}
"""Layer -> meaning of its colours, and the function that draws it."""
