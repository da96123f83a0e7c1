"""Panels of the viewer: images of a sequence at given times, sonar fans in Cartesian coordinates, and curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

WIDTH = 400
QUALITY = 72
BACKGROUND = 24  # grey level outside a fan
EARLY_NS = 20_000_000  # greatest amount by which jitter makes a sample early
WHITE_PERCENTILE = 99.7  # percentile of an image's amplitudes that is shown brightest


class Frame(NamedTuple):
    """An image as it is shown: JPEG, and the stamp of what it shows, None before the first measurement."""

    data: bytes
    stamp_ns: int | None


@dataclass(frozen=True)
class Panel:
    """An image that changes over time: title, size in px, the frames at given times, and approximate bytes per frame.

    over, meaning: for a ground-truth layer, the title of the panel that it overlays, and what its colours mean.
    """

    title: str
    width: int
    height: int
    frames: Callable[[NDArray[np.int64]], Iterator[Frame]]
    bytes_each: int
    over: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class Fan:
    """Position of each pixel of an image in a sonar's (bins, beams): columns and rows (H, W) float32, -1 outside."""

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    centre: tuple[float, float]
    metres_per_px: float
    ranges_m: Array
    azimuths_rad: Array

    @property
    def height(self) -> int:
        """Height of the image, px."""
        return len(self.rows)

    @classmethod
    def of(cls, azimuths_rad: Array, ranges_m: Array) -> Fan:
        """Fan that fills an image WIDTH px wide, x of the sonar up, y to the left."""
        widest = float(np.abs(azimuths_rad).max())
        reach = float(ranges_m[-1])
        half = reach * (np.sin(widest) if widest < np.pi / 2 else 1.0)
        behind = max(0.0, -reach * np.cos(widest))
        metres = 2.0 * half / (WIDTH - 4)
        height = round((reach + behind) / metres) + 4
        centre = (WIDTH / 2 - 0.5, 2.0 + reach / metres)
        across, along = np.meshgrid(np.arange(WIDTH) - centre[0], centre[1] - np.arange(height))
        distance, azimuth = np.hypot(across, along) * metres, np.arctan2(-across, along)
        order = np.argsort(azimuths_rad)
        beams = np.interp(azimuth, azimuths_rad[order], order.astype(float), left=-1.0, right=-1.0)
        bins = np.interp(distance, ranges_m, np.arange(len(ranges_m), dtype=float), left=-1.0, right=-1.0)
        outside = (beams < 0) | (bins < 0)
        beams[outside] = bins[outside] = -1.0
        return cls(beams.astype(np.float32), bins.astype(np.float32), centre, metres, ranges_m, azimuths_rad)

    def draw(self, amplitudes: NDArray[np.uint16], white: float) -> NDArray[Any]:
        """Draw amplitudes (bins, beams) as (H, W, 3) uint8 BGR; `white` is the amplitude that is shown brightest."""
        picture = coloured(np.asarray(cv2.remap(grey_of(amplitudes, white), self.columns, self.rows, cv2.INTER_LINEAR)))
        picture[self.rows < 0] = BACKGROUND
        self._rings(picture)
        return picture

    def _rings(self, picture: NDArray[Any]) -> None:
        step = _round_step(float(self.ranges_m[-1]) / 4)
        angles = np.linspace(float(self.azimuths_rad.min()), float(self.azimuths_rad.max()), 60)
        for distance in np.arange(step, float(self.ranges_m[-1]), step):
            radius = distance / self.metres_per_px
            arc = np.column_stack([self.centre[0] - radius * np.sin(angles), self.centre[1] - radius * np.cos(angles)])
            cv2.polylines(picture, [np.rint(arc).astype(np.int32)], False, (150, 150, 150), 1, cv2.LINE_AA)
            place = (int(self.centre[0]) + 3, int(self.centre[1] - radius) - 3)
            cv2.putText(
                picture, f"{distance:g} m", place, cv2.FONT_HERSHEY_SIMPLEX, 0.36, (220, 220, 220), 1, cv2.LINE_AA
            )


def _round_step(value: float) -> float:
    """Largest number of the form 1, 2 or 5 times a power of ten that does not exceed a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(factor * power for factor in (1, 2, 5) if factor * power <= value * 1.0001))


def jpeg(picture: Any) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes()


def latest(read: Callable[..., Iterator[Any]], name: str, times: NDArray[np.int64]) -> Iterator[Any]:
    """Yield, for each time, the first sample in the interval that starts then, or else the previous one; None at first.

    Intervals start a little early, so that a video at the sensor's own rate shows each sample once.
    """
    before = None
    step = max(int(times[1] - times[0]), 1) if len(times) > 1 else 1
    early = min(EARLY_NS, step // 2)
    for time in times:
        before = next(read(name, int(time) - early, int(time) - early + step), before)
        yield before


def white_of(amplitudes: NDArray[np.uint16]) -> float:
    """Amplitude that is shown brightest."""
    return max(float(np.percentile(amplitudes, WHITE_PERCENTILE)), 1.0)


def grey_of(amplitudes: NDArray[np.uint16], white: float) -> NDArray[np.float32]:
    """Brightness from 0 to 1 of amplitudes: their square root, which makes weak ones easier to see."""
    return np.clip(np.sqrt(amplitudes / white), 0.0, 1.0).astype(np.float32)


def coloured(grey: NDArray[np.float32]) -> NDArray[Any]:
    """Colour brightness (H, W) from 0 to 1 as (H, W, 3) uint8 BGR."""
    return np.asarray(cv2.applyColorMap(np.rint(255 * grey).astype(np.uint8), cv2.COLORMAP_INFERNO))


def blank(width: int, height: int) -> NDArray[np.uint8]:
    """Image (H, W, 3) that is shown before the first measurement."""
    return np.full((height, width, 3), BACKGROUND, dtype=np.uint8)


def padded(picture: NDArray[Any], aspect: float) -> NDArray[Any]:
    """Pad an image (H, W, 3) with background above and below, or on both sides, until its width is `aspect` times its
    height."""
    height, width = picture.shape[:2]
    down, across = max(0, round(width / aspect) - height), max(0, round(height * aspect) - width)
    edges = (down // 2, down - down // 2, across // 2, across - across // 2)
    return np.asarray(cv2.copyMakeBorder(picture, *edges, cv2.BORDER_CONSTANT, value=(BACKGROUND,) * 3))


AXES_COLOURS = ((240, 180, 90), (80, 148, 255), (159, 207, 46))  # BGR of x, y, z
GREY = (120, 120, 120)
MARK = (60, 90, 230)


def curves(
    title: str,
    seconds: Array,
    values: Array,
    beside_seconds: Array,
    beside: Array,
    spans: Sequence[tuple[float, float]],
) -> NDArray[Any]:
    """Plot (H, W, 3) uint8 BGR of values (N, up to 3) over seconds (N,), on top of others in grey, with time spans
    marked at the bottom. Curves are broken where values are not finite; the axis spans `values`."""
    picture = np.full((WIDTH * 3 // 4, WIDTH, 3), BACKGROUND, dtype=np.uint8)
    left, right, top, bottom = 44, WIDTH - 10, 34, len(picture) - 32
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.05 * (high - low) or 0.5
    low, high = low - margin, high + margin
    last = float(seconds[-1])

    def write(text: str, x: float, y: float, colour: tuple[int, int, int] = (220, 220, 220)) -> None:
        cv2.putText(picture, text, (int(x), int(y)), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)

    def line(times: Array, heights: Array, colour: tuple[int, int, int]) -> None:
        x = left + times / last * (right - left)
        y = bottom - (heights - low) / (high - low) * (bottom - top)
        known = np.isfinite(y)
        for run in np.split(np.arange(len(x)), np.flatnonzero(~known)):
            run = run[known[run]]
            points = np.column_stack([x[run], np.clip(y[run], top, bottom)])
            cv2.polylines(picture, [np.rint(points).astype(np.int32)], False, colour, 1, cv2.LINE_AA)

    step = _round_step((high - low) / 3)
    for value in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step:
        y = bottom - (value - low) / (high - low) * (bottom - top)
        cv2.line(picture, (left, int(y)), (right, int(y)), (50, 50, 50), 1)
        write(f"{value + 0.0:g}", 4, y + 4)
    for value in np.arange(0.0, last, _round_step(last / 3)):
        write(f"{value:g} s", left + value / last * (right - left), len(picture) - 6)
    for k in range(values.shape[1]):
        line(beside_seconds, beside[:, k], GREY)
    for k in range(values.shape[1]):
        line(seconds, values[:, k], AXES_COLOURS[k])
    for begin, end in spans:
        ends = [int(left + np.clip(at / last, 0.0, 1.0) * (right - left)) for at in (begin, end)]
        cv2.rectangle(picture, (ends[0], bottom + 4), (max(ends[1], ends[0] + 1), bottom + 10), MARK, -1)
    write(title.replace("\u00b2", "2").replace("\u00b5", "u"), left, 20)
    for k in range(values.shape[1] if values.shape[1] > 1 else 0):
        write("xyz"[k], right - 90 + 12 * k, 20, AXES_COLOURS[k])
    write("without", right - 48, 20, GREY)
    return picture
