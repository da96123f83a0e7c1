"""The bare seabed: a fractal relief with ripples on a grid, and a skirt of growing cells far beyond the reef."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from oysterbench.core.geometry import Array
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.mesh import Mesh, build_mesh, round_positions

CELL_M = 0.0125
MAX_CELLS = 2048  # per side of the reef: bounds memory and time
SKIRT_M = 80.0  # far enough for even the clearest water to hide its edge at grazing view
SKIRT_GROWTH = 1.3
SKIRT_FADE_M = 8.0  # relief beyond the reef fades out over this distance, as its cells get too large to represent it
ROUGHNESS = 1.7  # spectral exponent minus 1 (the Hurst exponent if below 1): currents smooth sediment
OUTER_SCALE_M = 3.5  # wavelength beyond which the relief stops growing
RIPPLE_RMS_M = 0.0030
RIPPLE_WAVELENGTH_M = (0.11, 0.22)
RIPPLE_SPREAD_RAD = 0.45
RIPPLE_CREST, RIPPLE_LEAN = 0.30, 0.15  # weights of the second harmonic
RIPPLES = {"sand": 1.0, "mud": 0.1, "gravel": 0.25, "shell": 0.25}  # ripple height relative to sand


@dataclass(frozen=True)
class Terrain:
    """Heights on a tensor grid, z in `map`, m.

    coordinates (N,) float64: grid lines along both x and y, increasing, m. heights (N, N) float32, indexed [y, x].
    rim: number of grid lines on each side that belong to the skirt; the cells within are of equal size.
    """

    coordinates: Array
    heights: NDArray[np.float32]
    rim: int

    def height(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Height (m, float64) at x, y (m), interpolated bilinearly; shaped as the broadcast inputs. Clamped beyond the
        skirt."""
        return sample_grid(self.coordinates, self.heights, x, y)

    def steepest(self) -> float:
        """Largest slope (rise over run) of the triangles in the inner square."""
        step = self.coordinates[self.rim + 1] - self.coordinates[self.rim]
        slope_x, slope_y = (np.abs(np.diff(self.square, axis=axis)).max(initial=0.0) / step for axis in (1, 0))
        return float(np.hypot(slope_x, slope_y))

    def mesh(self) -> Mesh:
        """The whole grid as upward-facing triangles; each cell is split from its low corner to its high one."""
        cells = len(self.coordinates) - 1
        return self._triangles(np.ones((cells, cells), dtype=bool))

    def skirt(self) -> Mesh:
        """Part of `mesh` around the square of equal cells."""
        cells = len(self.coordinates) - 1
        around = np.ones((cells, cells), dtype=bool)
        around[self.rim : cells - self.rim, self.rim : cells - self.rim] = False
        return self._triangles(around)

    @property
    def square(self) -> NDArray[np.float32]:
        """Heights (M, M) at the corners of the equal cells, m."""
        return self.heights[self.rim : len(self.heights) - self.rim, self.rim : len(self.heights) - self.rim]

    def _triangles(self, cells: NDArray[np.bool_]) -> Mesh:
        n = len(self.coordinates)
        rows, columns = np.nonzero(cells)
        corner = rows * n + columns
        faces = np.stack([corner, corner + 1, corner + n + 1, corner, corner + n + 1, corner + n], axis=-1)
        used, faces = np.unique(faces.reshape(-1, 3), return_inverse=True)
        i, j = used // n, used % n
        vertices = np.column_stack([self.coordinates[j], self.coordinates[i], self.heights[i, j].astype(float)])
        return build_mesh(vertices, faces.reshape(-1, 3))


def sample_grid(coordinates: Array, values: NDArray[np.floating], x: ArrayLike, y: ArrayLike) -> Array:
    """Interpolate values (N, N), indexed [y, x], bilinearly on grid lines `coordinates` (N,), clamped outside."""
    lines = len(coordinates)
    steps = np.arange(lines, dtype=float)
    column = np.interp(np.asarray(x, dtype=float), coordinates, steps)
    row = np.interp(np.asarray(y, dtype=float), coordinates, steps)
    i, j = np.minimum(row.astype(int), lines - 2), np.minimum(column.astype(int), lines - 2)
    u, v = column - j, row - i
    corner = i * lines + j
    along, flat = 1 - u, values.ravel()  # flat indexing takes half the time of two indices
    low = flat.take(corner) * along + flat.take(corner + 1) * u
    high = flat.take(corner + lines) * along + flat.take(corner + lines + 1) * u
    return np.asarray(low * (1 - v) + high * v)


def build_terrain(reef: ReefRecipe, generator: np.random.Generator) -> Terrain:
    """Build the seabed of a reef: periodic relief over the square of side size_m, repeated and fading in the skirt."""
    cells = min(int(np.ceil(reef.size_m / CELL_M)), MAX_CELLS)
    relief = _relief(cells, reef.size_m, reef.relief_rms_m, reef.bottom, generator)
    coordinates, rim = _grid_lines(cells, reef.size_m)
    past = np.maximum(np.abs(coordinates) - reef.size_m / 2, 0.0)
    fade = np.exp(-((past[:, None] ** 2 + past[None, :] ** 2) / SKIRT_FADE_M**2))
    position = (coordinates / reef.size_m + 0.5) * cells
    low = np.floor(position + 1e-6).astype(int)
    share = np.clip(position - low, 0.0, 1.0)
    rows = relief[low % cells] * (1 - share[:, None]) + relief[(low + 1) % cells] * share[:, None]
    heights = (rows[:, low % cells] * (1 - share) + rows[:, (low + 1) % cells] * share) * fade - reef.depth_m
    # Indexing by columns leaves a column-major array; sampling ravels row-major and would copy it each time.
    return Terrain(round_positions(coordinates).astype(float), np.ascontiguousarray(round_positions(heights)), rim)


def _relief(cells: int, size: float, rms: float, bottom: str, generator: np.random.Generator) -> Array:
    """Periodic relief (cells, cells) of the given rms in m, zero mean: a power-law field with patchy ripples.

    Spectral synthesis (Peitgen & Saupe 1988, ch. 2): white noise filtered by (1 + (k L)^2)^(-(H + 1) / 2).
    """
    k_x = fft.rfftfreq(cells, size / cells)[None, :]
    k_y = fft.fftfreq(cells, size / cells)[:, None]
    k = np.hypot(k_x, k_y)
    fractal = _filtered((1 + (k * OUTER_SCALE_M) ** 2) ** (-(ROUGHNESS + 1) / 2), generator)

    patches = _filtered(np.exp(-((k * 1.5) ** 2)), generator)
    ripples = _ripples(k_x, k_y, generator) * np.clip(0.7 + 0.8 * patches, 0.0, 1.7)
    ripple_rms = min(RIPPLE_RMS_M, 0.05 * rms)
    return rms * fractal + RIPPLES[bottom] * ripple_rms * ripples


def _ripples(k_x: Array, k_y: Array, generator: np.random.Generator) -> Array:
    """Current ripples of about unit rms: crests that wander, fork and end, and are sharper than the troughs.

    The phase of narrow-band complex noise counts the crests (phasor noise, Tricard et al. 2019); where its amplitude
    vanishes, the phase has a defect and a crest ends.
    """
    cells = k_y.shape[0]
    whole = fft.fftfreq(cells, 1 / (cells * k_x[0, 1]))[None, :]
    heading = generator.uniform(0, 2 * np.pi)
    k = np.hypot(whole, k_y)
    along = (whole * np.cos(heading) + k_y * np.sin(heading)) / np.maximum(k, 1e-12)
    long, short = 1 / RIPPLE_WAVELENGTH_M[1], 1 / RIPPLE_WAVELENGTH_M[0]
    band = (k > long) & (k < short) & (along > np.cos(RIPPLE_SPREAD_RAD))
    noise = generator.standard_normal((2, cells, cells))
    field = fft.ifft2(band * (noise[0] + 1j * noise[1]))
    size = np.abs(field)
    mean = max(float(size.mean()), 1e-30)
    # Cosine plus a second harmonic: trochoidal, leaning downstream.
    cosine, sine = field.real / np.maximum(size, 1e-30), field.imag / np.maximum(size, 1e-30)
    profile = cosine + RIPPLE_CREST * (2 * cosine**2 - 1) + RIPPLE_LEAN * 2 * sine * cosine
    ripples = profile * np.minimum(size / mean, 1.2)
    return ripples / max(float(np.sqrt(np.mean(ripples**2))), 1e-12)


def _filtered(amplitude: Array, generator: np.random.Generator) -> Array:
    """White noise passed through a filter on the rfft2 grid, with zero mean and unit rms."""
    cells = amplitude.shape[0]
    spectrum = fft.rfft2(generator.standard_normal((cells, cells))) * amplitude
    spectrum[0, 0] = 0.0
    field = fft.irfft2(spectrum, s=(cells, cells))
    return field / max(float(np.sqrt(np.mean(field**2))), 1e-12)


def _grid_lines(cells: int, size: float) -> tuple[Array, int]:
    """Lines of `cells` equal cells over [-size/2, size/2] and of cells growing out to SKIRT_M, m; number of lines in
    the skirt on each side."""
    cell = size / cells
    inner = -size / 2 + cell * np.arange(cells + 1)
    count = int(np.ceil(np.log(1 + SKIRT_M * (SKIRT_GROWTH - 1) / cell) / np.log(SKIRT_GROWTH)))
    outer = np.cumsum(cell * SKIRT_GROWTH ** np.arange(1, count + 1))
    return np.concatenate([-size / 2 - outer[::-1], inner, size / 2 + outer]), count
