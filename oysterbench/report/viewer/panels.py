"""Pictures of a sequence at given moments: frames of cameras, fans of sonars in Cartesian, sweeps of scanners."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import Sequence

WIDTH = 400
QUALITY = 72
BACKGROUND = 24  # grey level outside a fan


@dataclass(frozen=True)
class Panel:
    """A picture that changes: title, size in px, about how many bytes a frame takes, and the JPEG at each moment."""

    title: str
    width: int
    height: int
    frames: Callable[[NDArray[np.int64]], Iterator[bytes]]
    bytes_each: int


def pictures(sequence: Sequence) -> list[Panel]:
    """Of every camera, imaging sonar and scanning sonar."""
    panels = []
    for name, camera in sequence.cameras.items():
        width = min(WIDTH, camera.width)
        height = round(camera.height * width / camera.width)
        frames = partial(_camera_frames, sequence, name, (width, height))
        panels.append(Panel(name, width, height, frames, width * height // 4))
    for name, sonar in sequence.sonars.items():
        fan = Fan.of(sonar.azimuths_rad, sonar.ranges_m)
        panels.append(
            Panel(
                f"{name}, to {sonar.ranges_m[-1]:.1f} m",
                WIDTH,
                fan.height,
                partial(_sonar_frames, sequence, name, fan),
                WIDTH * fan.height // 5,
            )
        )
    for name, scanner in sequence.scanners.items():
        title = f"{name}, to {scanner.ranges_m[-1]:.1f} m"
        panels.append(Panel(title, WIDTH, WIDTH, partial(_scanner_frames, sequence, name), WIDTH * WIDTH // 6))
    return panels


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
        """(H, W, 3) uint8 BGR of amplitudes (bins, beams); `white` is the brightest that is told apart."""
        grey = np.clip(np.sqrt(amplitudes / white), 0.0, 1.0).astype(np.float32)
        flat = cv2.remap(grey, self.columns, self.rows, cv2.INTER_LINEAR)
        picture = np.asarray(cv2.applyColorMap(np.rint(255 * np.asarray(flat)).astype(np.uint8), cv2.COLORMAP_INFERNO))
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


def _jpeg(picture: Any) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes()


def _latest(read: Callable[..., Iterator[Any]], name: str, times: NDArray[np.int64]) -> Iterator[Any]:
    """The first sample in the interval that begins at each moment, or else the one before; None before all."""
    before = None
    step = max(int(times[1] - times[0]), 1) if len(times) > 1 else 1
    for time in times:
        before = next(read(name, int(time), int(time) + step), before)
        yield before


def _camera_frames(sequence: Sequence, name: str, size: tuple[int, int], times: NDArray[np.int64]) -> Iterator[bytes]:
    for image in _latest(sequence.images, name, times):
        if image is None:
            yield _jpeg(np.full((size[1], size[0], 3), BACKGROUND, dtype=np.uint8))
        else:
            small = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
            yield _jpeg(cv2.cvtColor(small, cv2.COLOR_RGB2BGR))


def _sonar_frames(sequence: Sequence, name: str, fan: Fan, times: NDArray[np.int64]) -> Iterator[bytes]:
    white = None
    for ping in _latest(sequence.sonar, name, times):
        if ping is None:
            yield _jpeg(np.full((fan.height, WIDTH, 3), BACKGROUND, dtype=np.uint8))
            continue
        if white is None:
            white = max(float(np.percentile(ping.pixels, 99.7)), 1.0)
        yield _jpeg(fan.draw(ping.pixels, white))


def _scanner_frames(sequence: Sequence, name: str, times: NDArray[np.int64]) -> Iterator[bytes]:
    """What the head has heard so far, each angle as it was heard last."""
    ranges = sequence.scanners[name].ranges_m
    angles = np.linspace(-np.pi, np.pi, 361)
    heard = np.zeros((len(ranges), len(angles)), dtype=np.uint16)
    fan = Fan.of(angles, ranges)
    pings = sequence.scans(name)
    ping = next(pings, None)
    half = np.radians(1.0)
    for time in times:
        while ping is not None and ping.stamp_ns <= time:
            off = np.abs((angles - ping.angle + np.pi) % (2 * np.pi) - np.pi)
            heard[:, off <= half] = ping.amplitudes[:, None]
            ping = next(pings, None)
        yield _jpeg(cv2.resize(fan.draw(heard, max(float(np.percentile(heard, 99.7)), 1.0)), (WIDTH, WIDTH)))
