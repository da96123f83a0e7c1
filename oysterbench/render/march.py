"""Ray marching through varying turbidity along the rays of a coarse grid, as for the lamps' beams (Wronski 2014).

The daylight that a view ray gathers is, with a the amounts (own particles, silt) and G their glow,

    sum over segments of  (G0 + a G) E T ds  +  sky T,        T = T0 exp(-k A), A the sum of a ds

where E is the daylight left by uniform water and the particles above, T0 the share of light scattered there that
uniform water leaves, and the sky is met at the surface. Divided by the same sum without particles, this gives a factor
on the veil of uniform water, which is tabulated; it is exactly 1 where there are no particles.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.special import erfc

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe
from oysterbench.render.admixture import Admixture, admixtures
from oysterbench.render.caustics import PATTERN_CONE_RAD
from oysterbench.render.lamps import lamp_spread
from oysterbench.render.noise import key_of
from oysterbench.render.optics import Optics, lamp_irradiance
from oysterbench.render.radiance import Daylight
from oysterbench.render.tables import look_up, look_up_pair
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.turbidity import Turbidity, amounts, decay, decays, dimmed, mean_decays, silt_at
from oysterbench.render.view import CameraView, ray_start, ray_through
from oysterbench.render.water import IMAGE_CONE_RAD, Water, forward_share
from oysterbench.scene.plumes import SPREADS, Plumes, Puffs

wp.set_module_options(KERNEL_OPTIONS)

CELL_PIXELS = 16  # cell width of the grid of rays
NODES = 48  # of range
SHORTEST_M, LONGEST_M = 2.0, 16.0  # bounds of the range of the march
OPAQUE = 5.0  # optical depth of uniform water beyond which the field has no visible effect
GRID_M, LEAST_SPREAD = 0.1, 0.75  # cell size of the silt grid, and the narrowest spread of a puff in it, in cells
SILT_REACH_M, SILT_REACH = 8.0, 0.7  # extent of silt around the camera: maximum, and share of the range of the march
DARKEST = wp.constant(wp.vec3(1.0e-9, 1.0e-9, 1.0e-9))  # added to the veil, so that ratios are defined
LAMP_STEPS = wp.constant(6)  # from a lamp to the point that it lights
FAINT = wp.constant(1.0e-9)  # light of a lamp outside its cone, so that a mean over lamps is defined everywhere
LEAST_WEIGHT = wp.constant(1.0e-5)  # smallest weight with which a puff enters a column of the grid
DRIFT_SHARE = 1.0  # share of the current with which patches drift


class TurbidityField:
    """Turbidity field of a sequence for one camera. Without layer, patches and plumes it does nothing."""

    def __init__(
        self,
        recipe: SequenceRecipe,
        water: Water,
        daylight: Daylight,
        plumes: Plumes | None,
        appearance: Streams,
        shape: tuple[int, int],
        device: str,
    ) -> None:
        self.device = device
        self.plumes = plumes
        self._site = recipe.site
        layer, patches = recipe.water.layer, recipe.water.patches
        self.even = layer.factor == 1.0 and patches.contrast == 0.0
        field = self.field = Turbidity()
        if self.even and plumes is None:
            return
        depth = recipe.reef.depth_m
        field.bottom, field.excess, field.fade = -depth, layer.factor - 1.0, 1.0 / layer.thickness_m
        field.contrast, field.frequency = patches.contrast, 1.0 / patches.size_m
        field.blurring = round(forward_share(IMAGE_CONE_RAD) - forward_share(PATTERN_CONE_RAD), 7)
        field.seed = key_of(int(appearance.generator("patches").integers(0, 2**31)), appearance, "patches")
        ambient, own, silt = admixtures(recipe.water, water, daylight, depth)
        self._admix("own", own)
        self._admix("silt", silt)
        field.even_glow, field.even_left = self._table(ambient.glow), self._table(ambient.left)
        field.sky = self._table(ambient.sky)
        image = lamp_spread(water)
        field.even_image = wp.vec3(*np.round(image, 7).tolist())
        field.reach = float(np.clip(OPAQUE / image.min(), SHORTEST_M, LONGEST_M))
        rows, columns = (-(-n // CELL_PIXELS) + 1 for n in shape)
        field.along = wp.zeros((rows, columns, NODES + 1), dtype=wp.vec2, device=device)
        field.veil = wp.zeros((rows, columns, NODES + 1), dtype=wp.vec3, device=device)
        coarse = ((rows + 1) // 2 + 1, (columns + 1) // 2 + 1, NODES // 2 + 1)
        field.lit = wp.ones(coarse, dtype=wp.vec3, device=device)

    def _admix(self, name: str, admixture: Admixture) -> None:
        for key in ("spread", "scattering"):
            setattr(self.field, f"{name}_{key}", wp.vec3(*np.round(getattr(admixture, key), 7).tolist()))
        for key in ("direct", "image", "veil", "dimming", "glow"):
            setattr(self.field, f"{name}_{key}", self._table(getattr(admixture, key)))

    def _table(self, values: Array) -> wp.array:
        return wp.array(values.astype(np.float32), dtype=wp.vec3, device=self.device)

    def move(self, time_s: float, position: Array) -> None:
        """Update the field to a time, around a camera at position (3,), m in `map`."""
        field = self.field
        if self.even and self.plumes is None:
            return
        to = np.radians(self._site.current_to_deg)
        gone = DRIFT_SHARE * self._site.current_m_s * time_s
        field.drift = wp.vec2(*np.round([gone * np.cos(to), gone * np.sin(to)], 6).tolist())
        field.silty = 0
        if self.plumes is not None:
            self._settle(self.plumes.at(time_s), position)
        field.on = int(field.silty or not self.even)

    def _settle(self, puffs: Puffs, position: Array) -> None:
        """Rasterise the puffs near the camera onto the grid, from tables of their separable distribution."""
        seen = min(SILT_REACH_M, SILT_REACH * self.field.reach)
        centre, spread, floor, amount = puffs.near(position, seen)
        if not len(amount):
            return
        spread = np.maximum(spread, LEAST_SPREAD * GRID_M)
        reach = SPREADS * spread
        low = np.maximum((centre - reach[:, None]).min(axis=0), position - seen)
        high = np.minimum((centre + reach[:, None]).max(axis=0), position + seen)
        low[2], high[2] = floor.min(), (centre[:, 2] + reach).max()
        low = np.floor(low / GRID_M) * GRID_M
        counts = np.maximum(np.ceil((high - low) / GRID_M).astype(int) + 1, 2)
        tables = []
        for axis in range(3):
            away = low[axis] + GRID_M * np.arange(counts[axis]) - centre[:, axis, None]
            tables.append(_normal(away, spread[:, None]))
        z = low[2] + GRID_M * np.arange(counts[2])
        mirrored = z - (2 * floor - centre[:, 2])[:, None]
        direct = z - centre[:, 2, None]
        upright = tables[2] + _normal(mirrored, spread[:, None])
        above = _beyond(direct, spread[:, None]) + _beyond(mirrored, spread[:, None])
        x, y = self._floats((tables[0] * amount[:, None]).T), self._floats(tables[1])
        ends = (centre[:, 1, None] + reach[:, None] * [-1, 1] - low[1]) / GRID_M
        ends = np.clip(np.ceil(ends), 0, counts[1]).astype(np.int32)
        first, last = (wp.array(end, dtype=wp.int32, device=self.device) for end in np.ascontiguousarray(ends.T))
        column = wp.array(np.stack([upright, above], -1).round(7).astype(np.float32), dtype=wp.vec2, device=self.device)
        field = self.field
        field.grid = wp.zeros(tuple(counts.tolist()), dtype=wp.vec2, device=self.device)
        field.corner, field.cell, field.silty = wp.vec3(*np.round(low, 6).tolist()), GRID_M, 1
        wp.launch(fill, counts[0], inputs=[x, y, column, first, last], outputs=[field.grid], device=self.device)

    def _floats(self, values: Array) -> wp.array:
        return wp.array(
            np.ascontiguousarray(np.round(values, 7), dtype=np.float32), dtype=wp.float32, device=self.device
        )

    def march(self, view: CameraView, optics: Optics) -> None:
        """March along the rays of a view; `optics.turbidity` must be this field."""
        field = optics.turbidity
        if optics.lamps.count:
            wp.launch(reach_out, field.lit.shape, inputs=[view, optics], outputs=[field.lit], device=self.device)
        inputs, outputs = [view, optics], [field.along, field.veil]
        wp.launch(walk, field.along.shape[:2], inputs=inputs, outputs=outputs, device=self.device)


def _normal(away: Array, spread: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (away / spread) ** 2) / (np.sqrt(2 * np.pi) * spread))


def _beyond(away: Array, spread: Array) -> Array:
    return np.asarray(0.5 * erfc(away / (np.sqrt(2) * spread)))


ADD_WEIGHED = """
    const int count = 2 * grid.shape[2];
    const float* __restrict from = column.data[p * grid.shape[2]].c;
    float* __restrict to = grid.data[(i * grid.shape[1] + j) * grid.shape[2]].c;
    for (int k = 0; k < count; ++k) to[k] = to[k] + from[k] * weight;
"""
"""In C++, as its compiler vectorises the loop, knowing that the numbers are contiguous."""


@wp.func_native(ADD_WEIGHED)
def add_weighed(
    column: wp.array2d(dtype=wp.vec2), p: int, weight: float, grid: wp.array3d(dtype=wp.vec2), i: int, j: int
):
    """Add row p of `column` (P, Z), times a weight, to the line i, j of `grid` (X, Y, Z)."""
    ...


@wp.kernel
def fill(
    x: wp.array2d(dtype=wp.float32),
    y: wp.array2d(dtype=wp.float32),
    column: wp.array2d(dtype=wp.vec2),
    first: wp.array(dtype=wp.int32),
    last: wp.array(dtype=wp.int32),
    grid: wp.array3d(dtype=wp.vec2),
):
    """Sum the puffs, each a product of functions of x, y and z, into silt at the grid points and its integral above.

    first, last: range of the lines along y that each puff reaches.
    """
    i = wp.tid()
    for p in range(x.shape[1]):
        if x[i, p] > LEAST_WEIGHT:
            for j in range(first[p], last[p]):
                weight = x[i, p] * y[p, j]
                if weight > LEAST_WEIGHT:
                    add_weighed(column, p, weight, grid, i, j)


@wp.func
def ray_of(view: CameraView, row: int, column: int, rows: int, columns: int):
    """Column and row in the image, px, of a ray of a grid that spans it."""
    v = float(view.rays.shape[0] - 3) * float(row) / float(rows - 1)
    u = float(view.rays.shape[1] - 3) * float(column) / float(columns - 1)
    return wp.vec2(u, v)


@wp.kernel
def reach_out(view: CameraView, optics: Optics, lit: wp.array3d(dtype=wp.vec3)):
    """Compute the amounts between the lamps and each node: the mean weighted by the light that arrives, and a factor
    that corrects for using this mean."""
    row, column, node = wp.tid()
    field = optics.turbidity
    place = ray_of(view, row, column, lit.shape[0], lit.shape[1])
    origin = ray_start(view, place[0], place[1])
    direction = wp.normalize(ray_through(view, place[0], place[1]))
    # Nodes are spaced like those of `walk`, whose last one is at infinity.
    fine = float(node) * float(field.along.shape[2] - 1) / float(lit.shape[2] - 1)
    share = wp.min(fine / float(field.along.shape[2] - 2), 1.0)
    p = origin + direction * (field.reach * share * share)
    amount = wp.vec2(0.0, 0.0)
    arriving = wp.float32(0.0)
    sent = wp.float32(0.0)
    for k in range(optics.lamps.count):
        start = optics.lamps.positions[k]
        step = (p - start) / float(LAMP_STEPS)
        between = wp.vec2(0.0, 0.0)
        for s in range(LAMP_STEPS):
            found = amounts(field, start + step * (float(s) + 0.5))
            between += wp.vec2(found[0], found[1])
        between = between * wp.length(step)
        light = lamp_irradiance(optics.lamps, k, p)[1] + FAINT
        left = light * wp.max(decay(field.own_spread[1] * between[0] + field.silt_spread[1] * between[1]), FAINT)
        amount += between * left
        arriving += left
        sent += light
    amount = amount / arriving
    alone = wp.max(decay(field.own_spread[1] * amount[0] + field.silt_spread[1] * amount[1]), FAINT)
    lit[row, column, node] = wp.vec3(amount[0], amount[1], arriving / (sent * alone))


@wp.func
def attenuated(field: Turbidity, amount: wp.vec2, range_step: float, distance: float):
    """Optical depths (3,) added by the amounts on the way to a distance, m."""
    column = distance / range_step
    return look_up(field.own_veil, column) * amount[0] + look_up(field.silt_veil, column) * amount[1]


@wp.kernel
def walk(view: CameraView, optics: Optics, along: wp.array3d(dtype=wp.vec2), veil: wp.array3d(dtype=wp.vec3)):
    """Compute the amounts on the way to each node, and the factor on the veil that they cause."""
    row, column = wp.tid()
    field = optics.turbidity
    place = ray_of(view, row, column, along.shape[0], along.shape[1])
    origin = ray_start(view, place[0], place[1])
    direction = wp.normalize(ray_through(view, place[0], place[1]))
    cosine = (direction[2] + 1.0) / optics.cosine_step
    last = along.shape[2] - 2
    way = wp.vec2(0.0, 0.0)  # amounts so far
    even = wp.vec3(0.0, 0.0, 0.0)
    gathered = wp.vec3(0.0, 0.0, 0.0)
    start = wp.float32(0.0)
    before = amounts(field, origin)
    depth_before = wp.vec3(0.0, 0.0, 0.0)
    left_before = wp.vec3(1.0, 1.0, 1.0)
    factor = wp.vec3(1.0, 1.0, 1.0)
    for k in range(1, last + 1):
        share = float(k) / float(last)
        end = field.reach * share * share
        step = end - start
        here = amounts(field, origin + direction * end)
        middle = origin + direction * (0.5 * (start + end))
        mean = (before + here) * 0.5
        mean[1] = (before[1] + 4.0 * silt_at(field, middle)[0] + here[1]) / 6.0
        way += wp.vec2(mean[0], mean[1]) * step
        line = -middle[2] / optics.depth_step
        depth = attenuated(field, way, optics.range_step, end)
        left = look_up(field.even_left, end / optics.range_step)
        if middle[2] < 0.0:
            light = wp.cw_mul(look_up(optics.daylight, line), (left_before + left) * (0.5 * step))
            own = look_up_pair(field.even_glow, line, cosine)
            glow = own + look_up_pair(field.own_glow, line, cosine) * mean[0]
            glow += look_up_pair(field.silt_glow, line, cosine) * mean[1]
            lost = wp.cw_mul(decays(depth_before), mean_decays(depth - depth_before))
            even += wp.cw_mul(own, light)
            gathered += wp.cw_mul(wp.cw_mul(glow, light), wp.cw_mul(lost, dimmed(field, mean, line)))
            if origin[2] + direction[2] * end >= 0.0:
                sky = wp.cw_mul(look_up(field.sky, cosine), left)
                even += sky
                gathered += wp.cw_mul(sky, decays(depth))
            factor = wp.cw_div(gathered + DARKEST, even + DARKEST)
        if k == 1:
            along[row, column, 0] = wp.vec2(0.0, 0.0)
            veil[row, column, 0] = factor
        along[row, column, k] = way
        veil[row, column, k] = factor
        before = here
        start = end
        depth_before = depth
        left_before = left
    # Beyond the reach, own particles stay as they are there, and there is no silt.
    if origin[2] + direction[2] * start < 0.0:
        line = -(origin[2] + direction[2] * start) / optics.depth_step
        light = wp.cw_mul(look_up(optics.daylight, line), left_before)
        own = look_up_pair(field.even_glow, line, cosine)
        glow = own + look_up_pair(field.own_glow, line, cosine) * before[0]
        rate = field.even_image + look_up(field.own_veil, start / optics.range_step) * before[0]
        even += wp.cw_div(wp.cw_mul(own, light), field.even_image)
        lost = wp.cw_mul(decays(depth_before), dimmed(field, before, line))
        gathered += wp.cw_mul(wp.cw_div(wp.cw_mul(glow, light), rate), lost)
        factor = wp.cw_div(gathered + DARKEST, even + DARKEST)
    along[row, column, last + 1] = way
    veil[row, column, last + 1] = factor
