"""Marine snow: flakes fixed in slowly moving water, lit by daylight and lamps, drawn as out-of-focus discs.

Space is a grid whose cells each hold a Poisson number of flakes at hashed places, so that flakes persist across frames.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe
from oysterbench.render.lamps import phase
from oysterbench.render.lens import project
from oysterbench.render.noise import key_of, lattice
from oysterbench.render.optics import Optics, beam_light, lamp_irradiance, veiling
from oysterbench.render.passage import STILL, Passage
from oysterbench.render.tables import look_up, look_up_pair
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView
from oysterbench.render.water import Water
from oysterbench.render.way import way_to
from oysterbench.scene.rig import camera_matrix

wp.set_module_options(KERNEL_OPTIONS)


SMALLEST_M, LARGEST_M = 0.0004, 0.003  # diameters; number density falls with their cube (Jackson et al. 1997)
NEAREST_M = 0.06  # nearer flakes are too far out of focus to be visible
FARTHEST_M = 2.5
PUPIL_M = 0.0012  # diameter of the lens aperture, if the recipe has none
PER_CELL = 1.5  # mean number of flakes in a cell
MOST_PER_CELL = 8
SINKING_M_S = 0.0008  # tens of metres per day (Alldredge & Silver 1988)
DRIFT_M_S = 0.02  # speed of a slow current
ALBEDO = wp.constant(0.45)  # of a flake, matte
HIDING = wp.constant(0.4)  # opacity of a flake, which is a loose web
FORWARD = wp.constant(0.7)  # asymmetry of its scattering of a lamp's light
MATTE = wp.constant(0.7)  # share of a lamp's light that it reflects like a matte ball
LEAST_RADIUS_PX = 0.75  # of a disc: a pixel's own extent
SOFT_RIM = wp.constant(0.5)  # width of a disc's rim relative to its radius
SMALL_RADIUS_PX = wp.constant(2.0)  # below this radius, discs are drawn with a soft profile
LARGEST_RADIUS_PX = 24.0
LONGEST_WAY_PX = 64.0  # largest displacement of a flake along either axis in one exposure or readout
UNIT = 2.0**-20  # quantum in which light is accumulated, so that sums in any order agree


class Snow:
    """Flakes in the water, and their light in the images of one camera."""

    def __init__(self, per_m3: float, camera: CameraRecipe, water: Water, appearance: Streams, device: str) -> None:
        self.per_m3 = per_m3
        self.camera = camera
        self.device = device
        generator = appearance.generator("snow")
        self._seed = key_of(int(generator.integers(0, 2**32)), appearance, "snow")
        heading = 2 * np.pi * generator.random()
        self._velocity = np.array([DRIFT_M_S * np.cos(heading), DRIFT_M_S * np.sin(heading), -SINKING_M_S])
        self.cell = float((PER_CELL / max(per_m3, 1e-9)) ** (1 / 3))
        mean = per_m3 * self.cell**3
        terms = np.cumprod([np.exp(-mean), *(mean / k for k in range(1, MOST_PER_CELL + 1))])
        self._cumulative = np.round(np.cumsum(terms), 9)
        reach = 5.0 / float((water.absorption + 0.2 * water.scattering).min())
        self._reach = float(np.clip(reach, 0.3, FARTHEST_M))
        h, w = camera.height, camera.width
        self.light = wp.zeros((h, w, 4), dtype=wp.int32, device=device) if per_m3 > 0 else None

    def flakes(self, T_map_cam: Array, rays: NDArray[np.float32], time_s: float) -> tuple[Array, Array]:
        """Places (N, 3) in the optical frame, m, and diameters (N,), m, of the flakes near the view at a time."""
        rotation, place = T_map_cam[:3, :3], T_map_cam[:3, 3] - self._velocity * time_s
        rows, columns = (np.linspace(0, n - 1, 7).astype(int) for n in rays.shape[:2])
        corners = np.concatenate([rays[np.ix_(rows, columns)][..., :2].reshape(-1, 2), np.ones((49, 1))], axis=1)
        corners = corners / np.linalg.norm(corners, axis=1, keepdims=True) * self._reach * 1.05
        corners = np.concatenate([_turn(rotation, corners), np.zeros((1, 3))]) + place
        low, high = (np.floor(f(axis=0) / self.cell).astype(np.int64) for f in (corners.min, corners.max))
        axes = [np.arange(a - 1, b + 2) for a, b in zip(low, high, strict=True)]
        # Each axis of the grid separately, so that sums over all cells have the same order on every processor.
        grid = [(axis + 0.5) * self.cell - place[k] for k, axis in enumerate(axes)]
        x, y, z = (
            (grid[0][:, None] * rotation[0, k] + grid[1] * rotation[1, k])[:, :, None] + grid[2] * rotation[2, k]
            for k in range(3)
        )
        margin = self.cell * 0.87
        tangent = np.abs(rays[..., :2]).max(axis=(0, 1)) * 1.02
        slack = margin * np.sqrt(1 + tangent**2)
        ahead = np.maximum(z, 0)
        near = (z > -margin) & (x**2 + y**2 + z**2 < (self._reach + margin) ** 2)
        near &= (np.abs(x) < ahead * tangent[0] + slack[0]) & (np.abs(y) < ahead * tangent[1] + slack[1])
        cells = np.argwhere(near) + [axis[0] for axis in axes]
        key = self._hash(cells)
        count = np.searchsorted(self._cumulative, _unit(key))
        owner = np.repeat(np.arange(len(cells)), count)
        first = np.cumsum(count) - count
        key = _scramble(
            key[owner] + np.uint32(0x9E3779B9) * (np.arange(len(owner)) - first[owner] + 1).astype(np.uint32)
        )
        offsets = np.empty((len(owner), 3))
        for axis in range(3):
            key = _scramble(key + np.uint32(axis + 1))
            offsets[:, axis] = _unit(key)
        key = _scramble(key + np.uint32(7))
        # Numbers above a diameter fall with its square: a density of d^-3, sampled by inversion.
        sizes = SMALLEST_M / np.sqrt(1.0 - _unit(key) * (1.0 - (SMALLEST_M / LARGEST_M) ** 2))
        places = _turn(rotation.T, (cells[owner] + offsets) * self.cell - place)
        distance2 = (places**2).sum(axis=1)
        seen = (places[:, 2] > NEAREST_M) & (distance2 < self._reach**2)
        return places[seen], sizes[seen]

    def _hash(self, cells: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Hashes (N,) of cells (N, 3) of the grid; with a salt, those of the points of other patterns: who knew where
        flakes hang over a hidden reef would know where each image of them was taken."""
        if self._seed[1] == 0:
            x, y, z = (cells & 0xFFFFFFFF).astype(np.uint32).T
            return _scramble(_scramble(_scramble(x + np.uint32(self._seed[0])) + y) + z)
        found = wp.zeros(len(cells), dtype=wp.uint32, device=self.device)
        points = wp.array(cells.astype(np.int32), dtype=wp.vec3i, device=self.device)
        wp.launch(hash_cells, len(cells), inputs=[points, self._seed], outputs=[found], device=self.device)
        return np.asarray(found.numpy())

    def fall(
        self,
        view: CameraView,
        optics: Optics,
        depth: wp.array,
        T_map_cam: Array,
        rays: NDArray,
        time_s: float,
        passage: Passage = STILL,
    ) -> None:
        """Draw the flakes in front of the surfaces at `depth` (H, W), m, into `light`."""
        assert self.light is not None
        self.light.zero_()
        places, sizes = self.flakes(T_map_cam, rays, time_s)
        pixels = project(places, self.camera) if len(places) else np.zeros((0, 2))
        focal = float(camera_matrix(self.camera)[0, 0])
        z = places[:, 2]
        pupil = self.camera.aperture_mm * 1e-3 or PUPIL_M
        confusion = pupil * np.abs(1 / z - 1 / self.camera.focus_m)
        own = (sizes / z) ** 2
        radius = np.maximum(0.5 * focal * np.sqrt(own + confusion**2), LEAST_RADIUS_PX)
        radius = np.minimum(radius, LARGEST_RADIUS_PX)
        cover = np.minimum(own * (0.5 * focal) ** 2 / radius**2, 1.0)
        inside = (np.abs(pixels - [self.camera.width / 2, self.camera.height / 2]) - radius[:, None]).max(axis=1)
        inside = inside < max(self.camera.width, self.camera.height) / 2 + 1
        if not inside.any():
            return
        columns, places = np.column_stack([pixels, radius, cover])[inside], places[inside]
        if passage.rows is not None:
            columns[:, :2] += self._rolled(passage.rows, T_map_cam, places, columns[:, 1])
        if passage.ends is not None:
            columns, places = self._streaks(passage.ends, T_map_cam, columns, places)
        discs = wp.array(np.round(columns, 5).astype(np.float32), dtype=wp.vec4, device=self.device)
        where = wp.array(np.round(places, 6).astype(np.float32), dtype=wp.vec3, device=self.device)
        wp.launch(
            draw,
            len(columns),
            inputs=[view, optics, discs, where, depth, 1.0 / UNIT],
            outputs=[self.light],
            device=self.device,
        )

    def _way(self, ends: Array, T_map_cam: Array, places: Array) -> Array:
        """Image displacement (N, 2), px, of places (N, 3) in the optical frame as the camera moves between `ends`."""
        seen = []
        for end in ends:
            motion = np.round(np.linalg.inv(end) @ T_map_cam, 9)
            points = _turn(motion[:3, :3], places) + motion[:3, 3]
            points[:, 2] = np.maximum(points[:, 2], NEAREST_M / 2)
            seen.append(project(points, self.camera))
        return np.asarray(np.clip(seen[1] - seen[0], -LONGEST_WAY_PX, LONGEST_WAY_PX))

    def _rolled(self, rows: Array, T_map_cam: Array, places: Array, heights: Array) -> Array:
        """Image displacement (N, 2), px, of flakes at heights (N,) in the image by the time their rows are exposed."""
        way = self._way(rows[[0, -1]], T_map_cam, places) / (len(rows) - 1)
        late = (np.clip(heights, 0, self.camera.height) - (self.camera.height - 1) / 2) / (1 - way[:, 1])
        return np.asarray(way * late[:, None])

    def _streaks(self, ends: Array, T_map_cam: Array, columns: Array, places: Array) -> tuple[Array, Array]:
        """Replace each disc with a row of discs along its displacement during the exposure; return these and their
        places."""
        way = self._way(ends, T_map_cam, places)
        parts = np.ceil(np.sqrt((way**2).sum(axis=1)) / np.maximum(1.5 * columns[:, 2], 1.0)).astype(int) + 1
        owner = np.repeat(np.arange(len(parts)), parts)
        at = (np.arange(len(owner)) - (np.cumsum(parts) - parts)[owner] + 0.5) / parts[owner] - 0.5
        drawn = columns[owner]
        drawn[:, :2] += way[owner] * at[:, None]
        drawn[:, 3] /= parts[owner]
        return drawn, places[owner]


def _turn(rotation: Array, points: Array) -> Array:
    """Rotate points (N, 3), written out so that sums have the same order on every processor."""
    x, y, z = points[:, 0, None], points[:, 1, None], points[:, 2, None]
    return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + z * rotation[:, 2])


def _scramble(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """A bijection of 32 bits that mixes well (Wellons 2018, "lowbias32")."""
    x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
    return np.asarray(x ^ (x >> np.uint32(16)))


def _unit(x: NDArray[np.uint32]) -> Array:
    return (x.astype(float) + 0.5) / 2.0**32


@wp.kernel
def hash_cells(cells: wp.array(dtype=wp.vec3i), seed: wp.vec2ui, found: wp.array(dtype=wp.uint32)):
    """Hash cells of the grid of flakes."""
    k = wp.tid()
    cell = cells[k]
    found[k] = lattice(cell[0], cell[1], cell[2], seed)


@wp.kernel
def draw(
    view: CameraView,
    optics: Optics,
    discs: wp.array(dtype=wp.vec4),
    places: wp.array(dtype=wp.vec3),
    depth: wp.array2d(dtype=wp.float32),
    unit: float,
    light: wp.array3d(dtype=wp.int32),
):
    """Draw a flake: its light and opacity, spread over its disc (column, row, radius in px, share that it covers)."""
    k = wp.tid()
    disc = discs[k]
    place = places[k]
    distance = wp.length(place)
    direction = view.rotation * (place / distance)
    p = view.position + direction * distance
    across = disc[0] / float(depth.shape[1] - 1)
    way = way_to(optics, across, disc[1] / float(depth.shape[0] - 1), distance, p)
    # A matte ball lit from the upper hemisphere reflects half of the light.
    lit = look_up(optics.daylight, -p[2] / optics.depth_step) * (0.5 * (optics.sun + optics.sky))
    lit = wp.cw_mul(lit, way.day)
    for lamp in range(optics.lamps.count):
        away = wp.normalize(p - optics.lamps.positions[lamp])
        turned = -wp.dot(away, direction)
        share = MATTE * (2.0 / 3.0) * (0.5 + 0.5 * -turned) + (1.0 - MATTE) * 3.14159265 * phase(turned, FORWARD)
        lit += wp.cw_mul(lamp_irradiance(optics.lamps, lamp, p), way.lamps) * share
    row = -p[2] / optics.depth_step
    column = distance / optics.range_step
    arrives = look_up_pair(optics.direct, row, column) + look_up_pair(optics.forward_scatter, row, column)
    seen = wp.cw_mul(lit * ALBEDO, wp.cw_mul(arrives, way.image))
    seen += wp.cw_mul(veiling(optics, -view.position[2], distance, direction[2]), way.veil)
    if optics.lamps.count > 0:
        rows = float(optics.lamps.beams.shape[0] - 1) / float(depth.shape[0] - 1)
        columns = float(optics.lamps.beams.shape[1] - 1) / float(depth.shape[1] - 1)
        seen += beam_light(optics.lamps, disc[1] * rows, disc[0] * columns, distance)
    seen = seen * HIDING
    radius = disc[2]
    reach = radius + wp.max(0.5, 0.5 * SOFT_RIM * radius)
    if radius < SMALL_RADIUS_PX:
        reach = 1.75 * radius
    top = wp.max(int(wp.ceil(disc[1] - reach)), 0)
    bottom = wp.min(int(wp.floor(disc[1] + reach)), depth.shape[0] - 1)
    left = wp.max(int(wp.ceil(disc[0] - reach)), 0)
    right = wp.min(int(wp.floor(disc[0] + reach)), depth.shape[1] - 1)
    for i in range(top, bottom + 1):
        for j in range(left, right + 1):
            dx = float(j) - disc[0]
            dy = float(i) - disc[1]
            # Soft at the rim or, if small, throughout, with the same total as a disc of that radius.
            rim = wp.max(1.0, SOFT_RIM * radius)
            inside = wp.clamp((radius + 0.5 * rim - wp.sqrt(dx * dx + dy * dy)) / rim, 0.0, 1.0)
            if radius < SMALL_RADIUS_PX:
                off = wp.max(1.0 - (dx * dx + dy * dy) / (3.0 * radius * radius), 0.0)
                inside = off * off
            before = depth[i, j] <= 0.0 or depth[i, j] > place[2]
            if inside > 0.0 and before:
                share = inside * disc[3] * unit
                wp.atomic_add(light, i, j, 0, int(seen[0] * share))
                wp.atomic_add(light, i, j, 1, int(seen[1] * share))
                wp.atomic_add(light, i, j, 2, int(seen[2] * share))
                wp.atomic_add(light, i, j, 3, int(HIDING * share))
