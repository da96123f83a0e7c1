"""The bare seabed: a fractal relief with ripples on a grid, and a skirt of growing cells far past the reef."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from oysterbench.recipe import ReefRecipe
from oysterbench.scene.mesh import Mesh, round_positions

Array = NDArray[np.float64]

CELL_M = 0.02
MAX_CELLS = 1000  # per side of the reef: bounds memory to about 2 million triangles
SKIRT_M = 80.0  # far enough for the clearest water to hide its edge at grazing view
SKIRT_GROWTH = 1.3
SKIRT_FADE_M = 8.0  # relief past the reef dies out over this distance, as its cells get too large to carry it
HURST = 0.85  # rougher than sand flats (about 1), smoother than rock (about 0.5)
OUTER_SCALE_M = 3.0  # wavelength beyond which the relief stops growing
RIPPLE_RMS_M = 0.0035
RIPPLE_WAVELENGTH_M = (0.10, 0.20)
RIPPLE_SPREAD_RAD = 0.45


@dataclass(frozen=True)
class Terrain:
    """Heights on a tensor grid, z in `map`, m.

    coordinates (N,) float64: the grid lines along x and along y, increasing, m. heights (N, N) float32, indexed
    [y, x].
    """

    coordinates: Array
    heights: NDArray[np.float32]

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Bilinear height at x, y in m; same shape as the broadcast inputs, float64, m. Clamped past the skirt."""
        return sample_grid(self.coordinates, self.heights, x, y)

    def steepest(self) -> float:
        """Largest slope between neighbouring grid points, rise over run."""
        slope_y = np.abs(np.diff(self.heights, axis=0)) / np.diff(self.coordinates)[:, None]
        slope_x = np.abs(np.diff(self.heights, axis=1)) / np.diff(self.coordinates)[None, :]
        return float(np.hypot(slope_x.max(), slope_y.max()))

    def mesh(self) -> Mesh:
        """The grid as triangles, facing up."""
        n = len(self.coordinates)
        line = self.coordinates.astype(np.float32)
        x, y = np.meshgrid(line, line)
        vertices = np.stack([x, y, self.heights], axis=-1).reshape(-1, 3)
        corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).astype(np.int32)
        faces = np.empty((n - 1, n - 1, 2, 3), dtype=np.int32)
        faces[..., 0, :] = corner[..., None] + np.array([0, 1, n + 1])
        faces[..., 1, :] = corner[..., None] + np.array([0, n + 1, n])
        slope_y, slope_x = np.gradient(self.heights, self.coordinates, self.coordinates)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return Mesh(vertices, faces.reshape(-1, 3), np.round(normals, 6).astype(np.float32).reshape(-1, 3))


def sample_grid(coordinates: Array, values: NDArray[np.floating], x: ArrayLike, y: ArrayLike) -> Array:
    """Bilinear interpolation of values (N, N), indexed [y, x], on grid lines `coordinates` (N,), clamped outside."""
    last = len(coordinates) - 2
    steps = np.arange(len(coordinates), dtype=float)
    column, row = np.interp(x, coordinates, steps), np.interp(y, coordinates, steps)
    i, j = np.minimum(row.astype(int), last), np.minimum(column.astype(int), last)
    u, v = column - j, row - i
    low = values[i, j] * (1 - u) + values[i, j + 1] * u
    high = values[i + 1, j] * (1 - u) + values[i + 1, j + 1] * u
    return low * (1 - v) + high * v


def build_terrain(reef: ReefRecipe, generator: np.random.Generator) -> Terrain:
    """Seabed of a reef: periodic relief over the square of side size_m, repeated and fading in the skirt."""
    cells = min(int(np.ceil(reef.size_m / CELL_M)), MAX_CELLS)
    relief = _relief(cells, reef.size_m, reef.relief_rms_m, generator)
    coordinates = _grid_lines(cells, reef.size_m)
    past = np.maximum(np.abs(coordinates) - reef.size_m / 2, 0.0)
    fade = np.exp(-((past[:, None] ** 2 + past[None, :] ** 2) / SKIRT_FADE_M**2))
    position = (coordinates / reef.size_m + 0.5) * cells
    nearest = np.round(position).astype(int) % cells
    heights = relief[np.ix_(nearest, nearest)] * fade - reef.depth_m
    return Terrain(coordinates, round_positions(heights))


def _relief(cells: int, size: float, rms: float, generator: np.random.Generator) -> Array:
    """Periodic relief (cells, cells) of the given rms in m, zero mean: a power-law field with patchy ripples.

    Spectral synthesis (Peitgen & Saupe 1988, ch. 2): white noise filtered by (1 + (k L)^2)^(-(H + 1) / 2).
    """
    k_x = fft.rfftfreq(cells, size / cells)[None, :]
    k_y = fft.fftfreq(cells, size / cells)[:, None]
    k = np.hypot(k_x, k_y)
    fractal = _filtered((1 + (k * OUTER_SCALE_M) ** 2) ** (-(HURST + 1) / 2), generator)

    heading = generator.uniform(0, np.pi)
    across = np.abs(k_x * np.cos(heading) + k_y * np.sin(heading)) / np.maximum(k, 1e-12)
    long, short = 1 / RIPPLE_WAVELENGTH_M[1], 1 / RIPPLE_WAVELENGTH_M[0]
    ripples = _filtered((k > long) & (k < short) & (across > np.cos(RIPPLE_SPREAD_RAD)), generator)
    patches = _filtered(np.exp(-((k * 1.5) ** 2)), generator)
    ripple_rms = min(RIPPLE_RMS_M, 0.05 * rms)
    return rms * fractal + ripple_rms * ripples * np.clip(0.6 + patches, 0.0, 2.0)


def _filtered(amplitude: NDArray[np.generic], generator: np.random.Generator) -> Array:
    """White noise through a filter given on the rfft2 grid, scaled to zero mean and unit rms."""
    cells = amplitude.shape[0]
    spectrum = fft.rfft2(generator.standard_normal((cells, cells))) * amplitude
    spectrum[0, 0] = 0.0
    field = fft.irfft2(spectrum, s=(cells, cells))
    return field / max(float(np.sqrt(np.mean(field**2))), 1e-12)


def _grid_lines(cells: int, size: float) -> Array:
    """Grid lines: `cells` equal cells over [-size/2, size/2], then cells growing by SKIRT_GROWTH out to SKIRT_M."""
    cell = size / cells
    inner = -size / 2 + cell * np.arange(cells + 1)
    count = int(np.ceil(np.log(1 + SKIRT_M * (SKIRT_GROWTH - 1) / cell) / np.log(SKIRT_GROWTH)))
    outer = np.cumsum(cell * SKIRT_GROWTH ** np.arange(1, count + 1))
    return np.concatenate([-size / 2 - outer[::-1], inner, size / 2 + outer])
