"""Caustics: the pattern of sunlight that surface waves focus onto the bottom.

Travelling waves (deep water, omega^2 = g k) refract a grid of rays; the rays land on a level plane at the reef's depth,
where their density is the irradiance. As every ray lands somewhere in the tile, its mean is exactly 1. For the small
slopes of the waves that matter, a ray is displaced sideways by depth * (1 - 1 / n) * slope (Airy).
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oysterbench.core.geometry import GRAVITY, Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import LightRecipe
from oysterbench.render.light import build_light
from oysterbench.render.noise import key_of
from oysterbench.render.optics import Caustics
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.water import DEPTHS, IMAGE_CONE_RAD, Water, forward_share

wp.set_module_options(KERNEL_OPTIONS)


PERIOD_M = 4.0  # with which the waves repeat: few images see as far
CELLS = 256  # of the tile, per side: 16 mm each, about the blur of the sun's disc at 2 m
RAYS = 512  # per side
WAVES = 24
SHORTEST_M, LONGEST_M = 0.16, 2.0  # waves of the tile; shorter ones focus above the reef and leave no pattern
SLOPE_SHARE = 0.35  # share of the mean square slope of the sea that is in these waves
SPREAD_RAD = 0.7  # of the waves' directions about the wind's
PATTERN_CONE_RAD = 0.1
"""Sunlight scattered by less than this still draws the pattern (15 cm wide over 1.5 m); scattered by more, it evens it
out. Light scattered beyond IMAGE_CONE_RAD is not part of the patterned beam, so only the range in between counts."""
UNIT = wp.constant(64)  # steps per cell in which a landing place is resolved


class Waves:
    """The water surface over a reef over time: a fixed set of waves, and the tile of light that they produce."""

    def __init__(self, recipe: LightRecipe, water: Water, depth_m: float, appearance: Streams, device: str) -> None:
        self.device = device
        generator = appearance.generator("waves")
        # Mean square slope over wind speed: Cox & Munk, J. Opt. Soc. Am. 44, 1954; equal in every octave.
        square = SLOPE_SHARE * (0.003 + 0.00512 * recipe.wind_m_s)
        lengths = LONGEST_M * (SHORTEST_M / LONGEST_M) ** ((np.arange(WAVES) + generator.random(WAVES)) / WAVES)
        heading = 2 * np.pi * generator.random() + SPREAD_RAD * generator.standard_normal(WAVES)
        self.steps = np.rint(PERIOD_M / lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], 1)).astype(int)
        self.steps[~self.steps.any(axis=1)] = (2, 0)
        # Waves sorted by even and odd numbers of crests along x and y, for `land`.
        kinds = 2 * (self.steps[:, 1] & 1) + (self.steps[:, 0] & 1)
        order = np.argsort(kinds, kind="stable")
        self.steps = self.steps[order]
        firsts = np.searchsorted(kinds[order], np.arange(5)).astype(np.int32)
        numbers = 2 * np.pi / PERIOD_M * np.hypot(*self.steps.T)
        self.rates = np.sqrt(GRAVITY * numbers)
        self.phases = 2 * np.pi * generator.random(WAVES)[order]
        self.along = self.steps / np.hypot(*self.steps.T)[:, None] * np.sqrt(2 * square / WAVES)
        self.push = depth_m * (1 - 1 / 1.34) * CELLS / PERIOD_M  # cells by which a slope of 1 moves a ray
        turn = 2 * np.pi * np.arange(RAYS) / RAYS
        self._cosine, self._sine = (self._floats(f(turn)) for f in (np.cos, np.sin))
        self._steps = wp.array(self.steps.astype(np.int32), dtype=wp.int32, device=device)
        self._firsts = wp.array(firsts, dtype=wp.int32, device=device)
        self._counts = wp.zeros((CELLS, CELLS), dtype=wp.int32, device=device)
        self.light = Caustics()
        self.light.on = int(recipe.wind_m_s > 0)
        self.light.tile = wp.ones((CELLS, CELLS), dtype=wp.float32, device=device)
        self.light.period = PERIOD_M
        self.light.seed = key_of(0, appearance, "layers")
        depths = np.linspace(0.0, float(water.depths[-1]), DEPTHS)
        fade = (forward_share(IMAGE_CONE_RAD) - forward_share(PATTERN_CONE_RAD)) * float(water.scattering[1])
        self.light.fade = self._floats(np.exp(-fade * depths / build_light(recipe).sun_direction[2]))
        self.light.fade_step = float(depths[1])

    def move(self, time_s: float) -> None:
        """Update the tile to a time."""
        if not self.light.on:
            return
        angle = self.phases - self.rates * time_s
        # The slope of wave w at x is along * cos(k x + angle): its coefficients of the cosine and the sine of k x.
        parts = np.concatenate([self.along * np.cos(angle)[:, None], -self.along * np.sin(angle)[:, None]], axis=1)
        moved = wp.array(np.round(parts * self.push, 6).astype(np.float32), dtype=wp.vec4, device=self.device)
        self._counts.zero_()
        wp.launch(
            land,
            (RAYS // 2, RAYS // 2),
            inputs=[self._steps, self._firsts, moved, self._cosine, self._sine],
            outputs=[self._counts],
            device=self.device,
        )
        wp.launch(soften, (CELLS, CELLS), inputs=[self._counts], outputs=[self.light.tile], device=self.device)

    def _floats(self, values: Array) -> wp.array:
        return wp.array(np.round(values, 7).astype(np.float32), dtype=wp.float32, device=self.device)


@wp.func
def pushed(
    steps: wp.array2d(dtype=wp.int32),
    moved: wp.array(dtype=wp.vec4),
    cosine: wp.array(dtype=wp.float32),
    sine: wp.array(dtype=wp.float32),
    first: int,
    end: int,
    i: int,
    j: int,
):
    """Displacement, in cells, of the ray of grid point i, j by the waves from `first` to before `end`."""
    push = wp.vec2(0.0, 0.0)
    for w in range(first, end):
        k = (steps[w, 0] * j + steps[w, 1] * i) & (cosine.shape[0] - 1)
        c = cosine[k]
        s = sine[k]
        wave = moved[w]
        push += wp.vec2(wave[0] * c + wave[2] * s, wave[1] * c + wave[3] * s)
    return push


@wp.kernel
def land(
    steps: wp.array2d(dtype=wp.int32),
    first: wp.array(dtype=wp.int32),
    moved: wp.array(dtype=wp.vec4),
    cosine: wp.array(dtype=wp.float32),
    sine: wp.array(dtype=wp.float32),
    counts: wp.array2d(dtype=wp.int32),
):
    """Distribute the rays of four grid points half a period apart among the cells where they land, in integers.

    Sums of integers agree in any order. Half a period further on, waves with an odd number of crests have changed sign
    and the others have not, so four points share the sums over each kind of waves.
    """
    i, j = wp.tid()
    n = cosine.shape[0]
    even = pushed(steps, moved, cosine, sine, first[0], first[1], i, j)
    odd_x = pushed(steps, moved, cosine, sine, first[1], first[2], i, j)
    odd_y = pushed(steps, moved, cosine, sine, first[2], first[3], i, j)
    odd = pushed(steps, moved, cosine, sine, first[3], first[4], i, j)
    cells = counts.shape[0]
    per_cell = float(n / cells)
    for quarter in range(4):
        sign_x = 1.0 - 2.0 * float(quarter % 2)
        sign_y = 1.0 - 2.0 * float(quarter // 2)
        push = even + odd_x * sign_x + odd_y * sign_y + odd * (sign_x * sign_y)
        across = float(j + (quarter % 2) * (n / 2)) / per_cell
        down = float(i + (quarter // 2) * (n / 2)) / per_cell
        x = int(wp.floor((across + push[0]) * float(UNIT) + 0.5))
        y = int(wp.floor((down + push[1]) * float(UNIT) + 0.5))
        a = x & (UNIT - 1)
        b = y & (UNIT - 1)
        column = (x >> 6) & (cells - 1)
        row = (y >> 6) & (cells - 1)
        right = (column + 1) & (cells - 1)
        below = (row + 1) & (cells - 1)
        wp.atomic_add(counts, row, column, (UNIT - a) * (UNIT - b))
        wp.atomic_add(counts, row, right, a * (UNIT - b))
        wp.atomic_add(counts, below, column, (UNIT - a) * b)
        wp.atomic_add(counts, below, right, a * b)


@wp.kernel
def soften(counts: wp.array2d(dtype=wp.int32), tile: wp.array2d(dtype=wp.float32)):
    """Compute relative irradiance: the counts under a binomial filter of three cells, for the width of the sun."""
    i, j = wp.tid()
    n = counts.shape[0]
    total = wp.int32(0)
    for di in range(-1, 2):
        for dj in range(-1, 2):
            weight = (2 - wp.abs(di)) * (2 - wp.abs(dj))
            total += weight * counts[(i + di + n) & (n - 1), (j + dj + n) & (n - 1)]
    tile[i, j] = float(total) / 262144.0  # 16 weights, 4 rays a cell, 64 * 64 steps
