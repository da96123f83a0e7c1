"""The chart: what the latest fans show of the ground, on cells that do not move, each fan where it was registered.

A fan is registered against the chart instead of the fan before it: speckle averages out, and the error of one
registration is not passed on from ping to ping. Older fans are forgotten, since relief shifts what they showed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.sonar.fan import Grid, View, sample
from oysterbench_baselines.common.aiding.sonar.settings import ChartSettings, FanSettings

STEP_CELLS = 16  # by which it is moved at a time
STEPS_PER_DB = 8  # in which echoes are stored: a byte holds 32 dB
UNKNOWN = 255


class Chart:
    """Cells of side `cell_m`, in a level frame that drifts as odometry does.

    values (n, n): mean of what fans showed, float32; fans (n, n): how many of them count; both with x along the rows.
    """

    def __init__(self, settings: ChartSettings) -> None:
        self.settings = settings
        shape = settings.cells, settings.cells
        self.values, self.fans = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._origin = np.zeros(2, dtype=np.int64)  # of the first cell, in cells

    def points(self, cells: NDArray[np.int64]) -> Array:
        """Centres (N, 2) m of cells (N,), which are given by their index in `values.ravel()`."""
        n = self.settings.cells
        return np.asarray((np.column_stack([cells // n, cells % n]) + self._origin) * self.settings.cell_m)

    def add(self, picture: NDArray[np.float32], place: Array, view: View, grid: Grid, of: FanSettings) -> None:
        """Add a fan's image (bins, beams), with the sonar at `place` (3,): x, y, heading."""
        self._move(place[:2] + 0.5 * of.reach_m * np.array([np.cos(place[2]), np.sin(place[2])]))
        cells = np.arange(self.values.size)
        shown, seen = sample(picture, self.points(cells), place, view, grid, of)
        there, shown = cells[seen], shown[seen]
        values, fans = self.values.ravel(), self.fans.ravel()
        values[there] += (shown - values[there]) / (fans[there] + 1)
        fans[there] = np.minimum(fans[there] + 1, self.settings.memory)

    def _move(self, middle: Array) -> None:
        """Centre the chart on `middle` (2,) m, by whole cells, so that nothing is interpolated."""
        n = self.settings.cells
        wanted = np.round(middle / self.settings.cell_m).astype(np.int64) - n // 2
        shift = wanted - self._origin if self.fans.any() else np.full(2, n)
        if np.abs(shift).max() < STEP_CELLS:
            return
        shift = np.clip(shift, -n, n)
        (to_x, from_x), (to_y, from_y) = (
            (slice(max(-s, 0), n - max(s, 0)), slice(max(s, 0), n + min(s, 0))) for s in shift
        )
        for kept in (self.values, self.fans):
            moved = np.zeros_like(kept)
            moved[to_x, to_y] = kept[from_x, from_y]
            kept[:] = moved
        self._origin = wanted

    def packed(self) -> PackedChart:
        """Copy of its present content, of a seventh of the size."""
        return PackedChart(
            self.settings, np.where(self.fans > 0, packed(self.values), UNKNOWN).astype(np.uint8), self._origin.copy()
        )


@dataclass(frozen=True)
class PackedChart:
    """A compressed chart. shown (n, n): its values, see `packed`; origin (2,): of its first cell, in cells."""

    settings: ChartSettings
    shown: NDArray[np.uint8]
    origin: NDArray[np.int64]

    def chart(self) -> Chart:
        """Restore the chart; how many fans a cell counts is lost."""
        chart, known = Chart(self.settings), self.shown != UNKNOWN
        chart.values = np.where(known, unpacked(self.shown), np.float32(0))
        chart.fans, chart._origin = known.astype(np.float32), self.origin
        return chart


def packed(echoes: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Quantise echoes over their surroundings, dB, to `STEPS_PER_DB` steps per dB."""
    return np.asarray(np.clip(np.rint(echoes * STEPS_PER_DB), 0, UNKNOWN - 1), dtype=np.uint8)


def unpacked(steps: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Echoes in dB, from `packed` ones."""
    return np.asarray(steps, dtype=np.float32) / np.float32(STEPS_PER_DB)
