"""A reef of discs on a level bottom, seen from straight above: every pixel of every layer by a formula."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from oysterbench.core.geometry import transform
from oysterbench.core.measurements import DvlMeasurement, Image, ImuMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence import Sequence
from oysterbench.sequence.types import CameraCalibration, DvlCalibration

WIDTH, HEIGHT, FOCAL = 160, 120, 115.0
BOTTOM, ALTITUDE = -3.0, 1.0
BEGIN = 10**18
DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # x right = -y of the body, y down = -x
CAMERA = CameraCalibration(
    width=WIDTH,
    height=HEIGHT,
    rate_hz=1.0,
    matrix=np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1.0]]),
    distortion=np.zeros(4),
    T_base_cam=transform(DOWN, [0.0, 0.0, 0.0]),
)
SPACING = 0.13  # of the discs


@dataclass(frozen=True)
class Discs:
    """centres (N, 2) m, radii (N,) m, live (N,) bool."""

    centres: np.ndarray
    radii: np.ndarray
    live: np.ndarray


def scattered(low: float, high: float, seed: int = 3) -> Discs:
    """Discs on a shaken lattice between two corners, so that none overlap."""
    generator = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(low, high, SPACING), np.arange(low, high, SPACING))
    centres = np.column_stack([x.ravel(), y.ravel()])
    centres = centres + generator.uniform(-0.025, 0.025, centres.shape)
    keep = generator.random(len(centres)) < 0.6
    n = int(keep.sum())
    return Discs(centres[keep], generator.uniform(0.025, 0.036, n), generator.random(n) < 0.75)


class FlatReef(Sequence):
    """Flown at one height over places (T, 2) m, one picture a second at each, heading along x.

    camera: that takes them; seconds: (T,) s, when it is at the places; repeats: pictures that show the one before.
    """

    metadata = {}  # noqa: RUF012
    imu_calibration = None  # type: ignore[assignment]

    def __init__(
        self,
        places: np.ndarray,
        discs: Discs,
        layers=("depth", "class", "instance"),
        name="flat",
        camera=CAMERA,
        seconds=None,
        repeats=(),
    ) -> None:
        self.name, self.places, self.discs, self.layers = name, np.asarray(places, dtype=float), discs, layers
        self.cameras = {"cam": camera}
        self.seconds = np.arange(float(len(places))) if seconds is None else np.asarray(seconds)
        self.repeats = repeats
        self._known: dict[int, np.ndarray] = {}
        self.stamps = BEGIN + np.rint(self.seconds * 1e9).astype(np.int64)
        directions = np.array([[0.3, 0.0, -1.0], [-0.3, 0.0, -1.0], [0.0, 0.3, -1.0], [0.0, -0.3, -1.0]])
        self.beams = directions / np.linalg.norm(directions, axis=1)[:, None]
        self.dvl_calibration = DvlCalibration(np.eye(4), self.beams, 50.0)

    @property
    def duration_s(self) -> float:
        return float(self.seconds[-1])

    def contents(self):
        topics = ("/truth/odometry", *(f"/cam/{layer}" for layer in ("image", *self.layers)))
        return [(topic, "", len(self.places)) for topic in topics]

    def truth(self) -> Trajectory:
        positions = np.column_stack([self.places, np.full(len(self.places), BOTTOM + ALTITUDE)])
        return Trajectory(self.stamps, positions, np.tile([0.0, 0, 0, 1], (len(positions), 1)))

    def imu(self, start_ns=None, end_ns=None):
        for stamp in self.stamps:
            yield ImuMeasurement(int(stamp), np.zeros(3), np.array([0, 0, 9.81]))

    def dvl(self, start_ns=None, end_ns=None):
        ranges = ALTITUDE / -self.beams[:, 2]
        valid = np.ones(4, dtype=bool)
        for stamp in self.stamps:
            yield DvlMeasurement(
                int(stamp), np.zeros(3), np.eye(3), 0.1, ALTITUDE, self.beams, ranges, np.zeros(4), valid
            )

    def images(self, camera, start_ns=None, end_ns=None):
        for k, stamp in self._between(start_ns, end_ns):
            numbers = self.numbers(k)
            grey = np.where(numbers > 0, 200, 90).astype(np.uint8)
            yield Image(int(stamp), camera, np.repeat(grey[..., None], 3, axis=2))

    def layer(self, camera, layer, start_ns=None, end_ns=None):
        for k, stamp in self._between(start_ns, end_ns):
            numbers = self.numbers(k)
            pixels = {
                "depth": np.full(numbers.shape, ALTITUDE, dtype=np.float32),
                "class": np.where(numbers > 0, 2, 1).astype(np.uint8),
                "instance": numbers.astype(np.uint16),
            }[layer]
            yield Image(int(stamp), camera, pixels)

    def numbers(self, k: int) -> np.ndarray:
        """(H, W) of picture k: the disc at each pixel, from 1; 0 for none."""
        if k in self.repeats:
            return self.numbers(k - 1)
        if k in self._known:
            return self._known[k]
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = np.stack([(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, np.ones(u.shape)], axis=-1)
        ground = ALTITUDE * rays @ DOWN.T
        rows_ns = self.cameras["cam"].rows_taken_ns(int(self.stamps[k]))
        after_s = (rows_ns - self.cameras["cam"].taken_ns(int(self.stamps[k]))) * 1e-9
        places = [np.interp(self.seconds[k] + after_s, self.seconds, axis) for axis in self.places.T]
        x, y = (ground[..., axis] + along[:, None] for axis, along in enumerate(places))
        numbers = np.zeros(u.shape, dtype=int)
        for i in np.flatnonzero(np.abs(self.discs.centres - self.places[k]).max(axis=1) < 0.8):
            centre, radius = self.discs.centres[i], self.discs.radii[i]
            numbers[(x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2] = i + 1
        self._known[k] = numbers
        return numbers

    def oysters(self) -> pd.DataFrame:
        n = len(self.discs.radii)
        heights = 2 * self.discs.radii
        return pd.DataFrame(
            {
                "id": np.arange(1, n + 1),
                "state": np.where(self.discs.live, "live", "box"),
                "height_m": heights,
                "x": self.discs.centres[:, 0] - heights / 2,  # the umbo; the bill lies along x
                "y": self.discs.centres[:, 1],
                "z": np.full(n, BOTTOM),
                **dict.fromkeys(("qx", "qy", "qz"), np.zeros(n)),
                "qw": np.ones(n),
            }
        )

    def _between(self, start_ns, end_ns):
        for k, stamp in enumerate(self.stamps):
            if (start_ns is None or stamp >= start_ns) and (end_ns is None or stamp < end_ns):
                yield k, stamp


def moved(trajectory: Trajectory, by: np.ndarray, rows: slice) -> Trajectory:
    """Some poses elsewhere, by (3,) m."""
    positions = trajectory.positions.copy()
    positions[rows] += by
    return replace(trajectory, positions=positions)


LANE = np.column_stack([np.arange(0.0, 2.4, 0.3), np.zeros(8)])
"""Eight places along x; pictures overlap by two thirds."""
