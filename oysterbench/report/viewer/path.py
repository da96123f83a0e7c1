"""The path from above, the oysters along it, and independently moving objects, in px of the SVG in `view.html`."""

from __future__ import annotations

from collections.abc import Sequence as Several
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.report.viewer.estimates import EstimatedPath
from oysterbench.report.viewer.strips import round_values
from oysterbench.sequence.truth import TRUTH
from oysterbench.sequence.types import Sequence

SIDE = 400


@dataclass(frozen=True)
class PathPlot:
    """The path from above, with markers that the page moves.

    dots, line: oysters and path, as SVG paths; bar_px, bar_m: length of the scale bar; poses: per moment x, y (px) and
    heading (deg); moving: class -> per moment the positions of its moving objects, as an SVG path; estimates: label and
    SVG path of each; north: whether up on the page is known to be north; states: per moment the true speed (m/s),
    depth (m) and heading (deg from north, clockwise), the last two only if `map` is known to be at the surface and
    aligned with north.
    """

    title: str
    dots: str
    line: str
    bar_px: float
    bar_m: float
    poses: list[list[float]]
    moving: dict[str, list[str]]
    estimates: list[tuple[str, str]]
    north: bool
    states: list[list[float | None]]
    side: int = SIDE


@dataclass(frozen=True)
class Window:
    """The square of `map` that is shown: its centre (2,) m, and half its side, m."""

    centre: Array
    half: float

    def place(self, points: Array) -> Array:
        """Convert points (N, 2) from m to px (N, 2)."""
        scale = SIDE / (2 * self.half)
        return np.asarray(SIDE / 2 + (points - self.centre) * [scale, -scale])

    def line(self, points: Array) -> str:
        """Draw a path (N, 2), m, thinned to what is visible, as an SVG path."""
        every = max(len(points) // 1000, 1)
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in self.place(points[::every]))

    def dots(self, points: Array) -> str:
        """Draw the points (N, 2), m, that lie within the window, as an SVG path."""
        near = points[np.all(np.abs(points - self.centre) < self.half, axis=1)]
        return "".join(f"M{x:.0f} {y:.0f}h.1" for x, y in self.place(near))


def path_plot(sequence: Sequence, times: NDArray[np.int64], estimates: Several[EstimatedPath] = ()) -> PathPlot | None:
    """Plot the true path, with the oysters if they are known; None if the sequence has no ground truth."""
    try:
        truth = sequence.truth()
    except SequenceError:
        return None
    xy = truth.positions[:, :2]
    window = _window(xy, [estimate.poses.positions[:, :2] for estimate in estimates])
    dots = window.dots(_oysters(sequence))
    bar = round_values(0.0, window.half, 4)[-1]
    at = truth.at(np.clip(times, truth.stamps_ns[0], truth.stamps_ns[-1]))
    forward = at.matrices[:, :2, 0]
    heading = np.degrees(np.arctan2(-forward[:, 1], forward[:, 0]))  # y of the page points down
    poses = [
        [round(float(x), 1), round(float(y), 1), round(float(angle), 1)]
        for (x, y), angle in zip(window.place(at.positions[:, :2]), heading, strict=True)
    ]
    moving = {name: [window.dots(points) for points in found] for name, found in _moving(sequence, times).items()}
    kinds = "path and oysters" if dots else "path"
    # In a sequence file `map` is east, north, up; other layouts do not say.
    north = TRUTH in (topic for topic, _, _ in sequence.contents())
    title = f"{kinds} from above" + (", east to the right" if north else "; north unknown")
    beside = [(estimate.label, window.line(estimate.poses.positions[:, :2])) for estimate in estimates]
    bar_px = bar * SIDE / (2 * window.half)
    states = _states(truth, at, times, north)
    return PathPlot(title, dots, window.line(xy), bar_px, bar, poses, moving, beside, north, states)


def _window(true: Array, others: list[Array]) -> Window:
    """Choose a window around the true path (N, 2), m, and the others as far as they stay within twice its size."""
    low, high = true.min(axis=0), true.max(axis=0)
    reach = max(float((high - low).max()) / 2, 0.5)
    kept = [np.clip(points, low - reach, high + reach) for points in others]
    found = np.concatenate([true, *kept])
    low, high = found.min(axis=0), found.max(axis=0)
    return Window((low + high) / 2, max(float((high - low).max()) * 0.6, 0.5))


def _states(truth: Trajectory, at: Trajectory, times: NDArray[np.int64], north: bool) -> list[list[float | None]]:
    seconds = 1e-9 * (truth.stamps_ns - truth.stamps_ns[0])
    asked = 1e-9 * (times - truth.stamps_ns[0])
    along = np.linalg.norm(np.gradient(truth.positions, seconds, axis=0), axis=1) if len(truth) > 1 else seconds
    speeds = np.interp(asked, seconds, along)
    headings = np.degrees(np.arctan2(at.matrices[:, 0, 0], at.matrices[:, 1, 0])) % 360
    return [
        [round(float(speed), 2), *((round(float(-z), 2), round(float(heading))) if north else (None, None))]
        for speed, z, heading in zip(speeds, at.positions[:, 2], headings, strict=True)
    ]


def _oysters(sequence: Sequence) -> Array:
    """Positions (N, 2) of the oysters, m; empty if they are not known."""
    try:
        return sequence.oysters()[["x", "y"]].to_numpy(dtype=float)
    except SequenceError:
        return np.zeros((0, 2))


def _moving(sequence: Sequence, times: NDArray[np.int64]) -> dict[str, Array]:
    """Class -> positions (moments, N, 2), m, of its moving objects, interpolated between the stamps of the truth."""
    try:
        who, where = sequence.moving(), sequence.moving_poses()
    except SequenceError:
        return {}
    found = {}
    for name, of in who.groupby("class", sort=False):
        table = where[where["id"].isin(of["id"])].pivot(index="stamp_ns", columns="id", values=["x", "y"])
        if len(table):
            seconds, asked = (1e-9 * (stamps - times[0]) for stamps in (table.index.to_numpy(), times))
            x, y = (np.stack([np.interp(asked, seconds, one) for one in table[axis].to_numpy().T], -1) for axis in "xy")
            found[str(name)] = np.stack([x, y], axis=-1)
    return found
