"""Overlays: images with the outlines of their oysters, for inspection."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.geometry import Array
from oysterbench.counting.measure import OysterRow, PictureCount

LONGEST_PX = 2048
"""Longest side of an overlay: larger images are reduced to it before drawing, so that lines keep their width."""

SHORTEST_PX = 640
"""Smaller images are enlarged to about this, by an integer of at most `MOST_ENLARGED`: lines and text need room."""
MOST_ENLARGED = 8

COLOURS = {"unknown": (240, 228, 66), "live": (86, 180, 233), "dead": (213, 94, 0), "left out": (190, 190, 190)}
"""RGB of outlines: yellow, sky blue, vermilion and grey, distinguishable with all types of colour vision (Okabe & Ito
2008)."""

CASING = (0, 0, 0)
QUADRAT = (255, 255, 255)
WARNING = "unlike the training data"
FONT = cv2.FONT_HERSHEY_SIMPLEX
FIXED = 4  # fractional bits of line coordinates

Pixels = NDArray[np.uint8]


def overlay(
    pixels: Pixels,
    numbers: NDArray[np.uint16] | None,
    rows: list[OysterRow],
    picture: PictureCount,
    region: Array | None,
) -> Pixels:
    """Draw an overlay (h, w, 3) uint8 RGB of an image (H, W, 3): outlines coloured by state, each on a dark casing,
    grey if not counted; region (K, 2) px, of a quadrat, in white; the count and any warning in a strip above."""
    height, width = pixels.shape[:2]
    factor = overlay_factor((height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    kind_of_resampling = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    drawn = np.array(cv2.resize(pixels, size, interpolation=kind_of_resampling), dtype=np.uint8)
    line = max(2, round(math.sqrt(size[0] * size[1]) / 300))
    outlines = {row.number: _outline(row, numbers) for row in rows}
    for casing in (True, False):
        for row in rows:
            kind = row.state if row.counted else "left out"
            colour = CASING if casing else COLOURS[kind]
            _lines(drawn, outlines[row.number], factor, colour, line + line * casing)
        if region is not None and len(region):
            _lines(drawn, [region], factor, CASING if casing else QUADRAT, line + line * casing)
    return _with_strip(drawn, _said(picture), picture.unlike)


def overlay_factor(shape: tuple[int, int]) -> float:
    """Factor by which an image (H, W) is enlarged or reduced."""
    longest = max(shape)
    if longest >= SHORTEST_PX:
        return min(1.0, LONGEST_PX / longest)
    return float(min(MOST_ENLARGED, math.ceil(SHORTEST_PX / longest)))


def jpeg(pixels: Pixels, quality: int = 88, widest: int | None = None) -> bytes:
    """Encode an image (H, W, 3) uint8 RGB as JPEG, reduced to `widest` px if it is wider."""
    height, width = pixels.shape[:2]
    if widest is not None and width > widest:
        size = (widest, max(1, round(height * widest / width)))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OysterbenchError(f"an image of {width} x {height} px could not be encoded as JPEG")
    return data.tobytes()


def _outline(row: OysterRow, numbers: NDArray[np.uint16] | None) -> list[Array]:
    """Polygons (K, 2) px around an oyster, measured from the corner of the first pixel."""
    x, y, w, h = row.box
    if numbers is None:
        return [np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])]
    left, top = int(x), int(y)
    mask = numbers[top : top + int(h), left : left + int(w)] == row.number
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [contour.reshape(-1, 2) + np.array([left + 0.5, top + 0.5]) for contour in found]


def _lines(drawn: Pixels, outlines: list[Array], factor: float, colour: tuple[int, int, int], thickness: int) -> None:
    scaled = [np.round((points * factor - 0.5) * 2**FIXED).astype(np.int32) for points in outlines]
    cv2.polylines(drawn, scaled, True, colour, thickness, cv2.LINE_AA, FIXED)


def _said(picture: PictureCount) -> str:
    text = picture.said
    if picture.live or picture.dead:
        text += f", {picture.live} live, {picture.dead} dead"
    if picture.per_m2 is not None:
        text += f", {picture.per_m2:.1f} per m2"
    if picture.time_s is not None:
        minutes, seconds = divmod(int(picture.time_s), 60)
        text = f"{minutes}:{seconds:02d}  {text}"
    return text


def _with_strip(drawn: Pixels, text: str, unlike: bool) -> Pixels:
    """Add a dark strip with the text above the image, if it is wide enough to be legible; for an image unlike the
    training data, the strip is orange, and so is a frame around the image."""
    height, width = drawn.shape[:2]
    tall = max(22, round(math.sqrt(height * width) / 24))
    ground, ink = ((213, 94, 0), (255, 255, 255)) if unlike else ((20, 32, 43), (255, 255, 255))
    strip = np.full((tall, width, 3), ground, np.uint8)
    text = f"! {text}, {WARNING}" if unlike else text
    (wide, _), _ = cv2.getTextSize(text, FONT, 1.0, 2)
    scale = min(tall / 40, (width - 8) / max(wide, 1))
    if unlike:
        cv2.rectangle(drawn, (0, 0), (width - 1, height - 1), ground, max(1, round(max(height, width) / 160)))
    if scale <= 0.2:  # too small to read
        return drawn
    place = (4 + tall // 6, round(tall / 2 + 11 * scale))
    cv2.putText(strip, text, place, FONT, scale * 0.94, ink, max(1, round(2 * scale)), cv2.LINE_AA)
    return np.concatenate([strip, drawn])
