"""Pictures of a sequence at given moments, as the viewer shows them: fans of sonars in Cartesian, and waterfalls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

WIDTH = 400
QUALITY = 72
BACKGROUND = 24  # grey level outside a fan
EARLY_NS = 20_000_000  # by which jitter makes a sample early at most
WHITE_PERCENTILE = 99.7  # of the amplitudes of a picture: what is shown brightest


@dataclass(frozen=True)
class Panel:
    """A picture that changes: title, size in px, about how many bytes a frame takes, and the JPEG at each moment."""

    title: str
    width: int
    height: int
    frames: Callable[[NDArray[np.int64]], Iterator[bytes]]
    bytes_each: int


@dataclass(frozen=True)
class Fan:
    """Where each pixel of a picture lies in a sonar's (bins, beams): columns and rows (H, W) float32, -1 outside."""

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    centre: tuple[float, float]
    metres_per_px: float
    ranges_m: Array
    azimuths_rad: Array

    @property
    def height(self) -> int:
        """Of the picture, px."""
        return len(self.rows)

    @classmethod
    def of(cls, azimuths_rad: Array, ranges_m: Array) -> Fan:
        """A picture WIDTH px wide that the fan fills, x of the sonar up, y to the left."""
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
        """(H, W, 3) uint8 BGR of amplitudes (bins, beams); `white` is the brightest that is shown."""
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
    """The greatest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(factor * power for factor in (1, 2, 5) if factor * power <= value * 1.0001))


def jpeg(picture: Any) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes()


def latest(read: Callable[..., Iterator[Any]], name: str, times: NDArray[np.int64]) -> Iterator[Any]:
    """The first sample in the interval that begins at each moment, or else the one before; None before all.

    Intervals begin a little earlier, so that a film at the sensor's own rate shows each sample once.
    """
    before = None
    step = max(int(times[1] - times[0]), 1) if len(times) > 1 else 1
    early = min(EARLY_NS, step // 2)
    for time in times:
        before = next(read(name, int(time) - early, int(time) - early + step), before)
        yield before


def white_of(amplitudes: NDArray[np.uint16]) -> float:
    """The amplitude that is shown brightest."""
    return max(float(np.percentile(amplitudes, WHITE_PERCENTILE)), 1.0)


def grey_of(amplitudes: NDArray[np.uint16], white: float) -> NDArray[np.float32]:
    """Amplitudes as brightness from 0 to 1, their root: the eye sees more of the weak ones."""
    return np.clip(np.sqrt(amplitudes / white), 0.0, 1.0).astype(np.float32)


def coloured(grey: NDArray[np.float32]) -> NDArray[Any]:
    """(H, W, 3) uint8 BGR of brightness (H, W) from 0 to 1."""
    return np.asarray(cv2.applyColorMap(np.rint(255 * grey).astype(np.uint8), cv2.COLORMAP_INFERNO))


def blank(width: int, height: int) -> NDArray[np.uint8]:
    """(H, W, 3): what is shown before the first measurement."""
    return np.full((height, width, 3), BACKGROUND, dtype=np.uint8)
