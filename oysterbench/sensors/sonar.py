"""Imaging sonar: a fan of beams that resolve azimuth and range, but not elevation within their aperture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Cloud, SonarImage
from oysterbench.core.ros import (
    IMAGE,
    POINTS,
    Message,
    echo_image,
    read_echo_image,
)
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import number
from oysterbench.recipe.sensors import BinnedSonarRecipe
from oysterbench.sensors import acoustics, echoes
from oysterbench.sensors.clouds import cloud_message
from oysterbench.sensors.echoes import RangeAxis, Rays, Returns
from oysterbench.sensors.faults import Fault
from oysterbench.sensors.interference import Beams, added_power, struck_pings
from oysterbench.sensors.kind import Instants, SensedWorld, SensorKind, link, topic

if TYPE_CHECKING:
    from oysterbench.render.rays import RayCaster
    from oysterbench.sensors.panels import Fan, Frame, Panel

ROWS = 200  # rows of rays over the elevations
PROBE_COLUMNS = 12  # columns of the probing rays that tell where elevations have to be dense
COLUMNS_PER_WIDTH = 1.5  # least number of ray columns per half-power width of a beam,
MOST_PER_WIDTH = 6.0  # and the greatest, where beams lie closer together than that
PATTERN_REACH = 4.0  # half-power widths on each side within which a beam receives
RAISED_M = 0.05  # height over the bottom below which a bounce off the bottom coincides with the direct echo
SonarPing = tuple[SonarImage, Cloud | None]
"""Measurement of a simulated ping: its image, and its cloud if the recipe asks for one."""

CLOUD_ROWS = 32  # rows of the cloud over the elevations


@dataclass(frozen=True, kw_only=True)
class SonarRecipe(BinnedSonarRecipe):
    """An imaging (multibeam, forward-looking) sonar: a fan of beams, each an echo strength per range bin."""

    block: ClassVar[str] = "sonar"

    hfov_deg: float = number(5, 180, 130.0)  # width of the fan
    vfov_deg: float = number(1, 90, 20.0)  # thickness of the fan
    beams: int = number(8, 1024, 256)  # number of beams in the fan
    beam_deg: float = number(0.1, 20, 1.0)  # width of a beam across, at half power
    multipath: float = number(0, 1, 0.0)  # amplitude kept by sound after one more bounce off bottom or surface
    cloud: bool = field(default=False)  # also write a point cloud, with class and instance of each return


@dataclass(frozen=True)
class SonarCalibration:
    """An imaging sonar: azimuths (beams,) rad, left of x positive; ranges (bins,) m; vertical aperture of its fan, rad;
    frequency, Hz; amplitude of one count of a pixel; pose."""

    beams: int
    bins: int
    azimuths_rad: Array
    ranges_m: Array
    vfov_rad: float
    frequency_hz: float
    amplitude_step: float
    T_base_sensor: Array


@dataclass(frozen=True)
class Columns:
    """Columns of rays, evenly spaced in azimuth, and their weights in the beams.

    edges (C + 1,): azimuths, from left to right, rad. Either a beam has per_beam columns or a column has per_column
    beams; the other number is 1. Beam b sums taps[b % per_column], taps (per_column, K), times the K columns from
    per_beam * (b // per_column) on.
    """

    edges: Array
    per_beam: int
    per_column: int
    taps: Array

    @property
    def width(self) -> float:
        """Width of a column, rad."""
        return float(self.edges[0] - self.edges[1])


@dataclass(frozen=True)
class Ping:
    """Noise-free result of one ping: its rays, their returns, the range axis, and the absorption (loss) in dB/m.

    power (beams, bins): expected power that the sonar records.
    """

    rays: Rays
    returns: Returns
    axis: RangeAxis
    loss: float
    power: Array


class ImagingSonar:
    """A multibeam sonar in a world, over a bottom type of recipe.BOTTOMS.

    An image's pixels are linear amplitudes in counts of `amplitude_step`: row k is at `ranges[k]` and column b at
    `azimuths[b]`, both as the sonar believes them to be. A row holds all the power returned from within it; 1 is the
    amplitude of a perfect scatterer (mu = 1, facing the sonar) 1 m away that fills a beam.
    """

    def __init__(self, caster: RayCaster, recipe: SonarRecipe, site: SiteRecipe, bottom: str = "sand") -> None:
        self.caster = caster
        self.recipe = recipe
        self.site = site
        self.amplitude_step = echoes.amplitude_step(recipe)
        self._mount = acoustics.mount_pose(recipe)
        self._mu = acoustics.backscatter(bottom)
        self._vertical = float(np.radians(recipe.vfov_deg))
        self._highest = acoustics.first_null(self._vertical)
        self._columns = build_columns(recipe)
        across = self._columns.taps.sum(axis=1).mean() * self._columns.width
        self._fill = across * acoustics.aperture(self._vertical)

    @property
    def azimuths(self) -> Array:
        """Azimuths (beams,) rad of the beams, positive to the left of the sonar's axis, in order from left to right."""
        return beam_azimuths(self.recipe)

    @property
    def ranges(self) -> Array:
        """Ranges (bins,) m of the row centres."""
        return echoes.bin_middles(self.recipe)

    def ping(
        self, T_map_base: Array, streams: Streams, index: int, stamp_ns: int = 0
    ) -> tuple[SonarImage, Cloud | None]:
        """Take ping `index`, with the vehicle at T_map_base (4, 4): the image, and the cloud if the recipe has one."""
        branch = streams.at("sonar", self.recipe.name, index)
        found = self.listen(T_map_base, branch)
        beams = Beams(T_map_base @ self._mount, self.azimuths, float(np.radians(self.recipe.beam_deg)), True)
        power = found.power + added_power(self.recipe, found.loss, beams, streams, branch)
        pixels = echoes.record(power, self.recipe, found.loss, branch.generator("noise"))
        image = SonarImage(stamp_ns, self.recipe.name, np.ascontiguousarray(pixels.T))
        return image, self._cloud(found, stamp_ns) if self.recipe.cloud else None

    def listen(self, T_map_base: Array, streams: Streams) -> Ping:
        """Compute a ping from T_map_base (4, 4) before speckle, noise and gain; `streams` jitters the rays."""
        T_map_sonar = np.asarray(T_map_base, dtype=float) @ self._mount
        medium = echoes.Medium.at(self.site, -float(T_map_sonar[2, 3]), self.recipe.frequency_khz)
        axis = echoes.range_axis(self.recipe, medium.speed)
        rays = self._rays(T_map_sonar, axis, streams.generator("rays"))
        returns = echoes.send(self.caster, T_map_sonar, rays, self._mu, medium.loss, self._fill, axis.reach)
        count = len(self._columns.edges) - 1
        power = echoes.add_up(axis, rays.columns, count, returns.nearest, returns.farthest, returns.powers)
        if self.recipe.multipath:
            for later, weaker in self._bounces(T_map_sonar, rays, returns, medium.loss):
                nearest, farthest = returns.nearest + later, returns.farthest + later
                power += echoes.add_up(axis, rays.columns, count, nearest, farthest, weaker)
        power = gather(power, self._columns, self.recipe.beams)
        return Ping(
            rays, returns, axis, medium.loss, echoes.resolve(power, axis, medium.speed, self.recipe.bandwidth_khz)
        )

    def _rays(self, T_map_sonar: Array, axis: RangeAxis, generator: np.random.Generator) -> Rays:
        """Draw one ray at random in each cell of a grid: even columns, and denser rows where the range changes fast."""
        columns = self._columns
        probes = np.linspace(columns.edges[0], columns.edges[-1], PROBE_COLUMNS)
        rows = echoes.row_edges(self.caster, T_map_sonar, axis, probes, self._highest, ROWS)
        count = len(columns.edges) - 1
        anywhere = generator.random((2, count, ROWS))
        azimuths = columns.edges[:-1, None] - columns.width * anywhere[0]
        heights = np.diff(rows)
        elevations = rows[:-1] + heights * anywhere[1]
        middles = np.meshgrid(columns.edges[:-1] - 0.5 * columns.width, rows[:-1] + 0.5 * heights, indexing="ij")
        return Rays(
            azimuths=azimuths.ravel(),
            elevations=elevations.ravel(),
            middles=np.reshape(middles, (2, -1)),
            widths=np.full(azimuths.size, columns.width),
            heights=np.tile(heights, count),
            columns=np.repeat(np.arange(count), ROWS),
            weights=acoustics.beam_pattern(elevations.ravel(), self._vertical),
        )

    def _bounces(self, T_map_sonar: Array, rays: Rays, returns: Returns, loss: float) -> list[tuple[Array, Array]]:
        """Extra range (N,) m and power (N,) of the echoes with one more bounce: off the flat water surface, and off the
        bottom.

        Out on the direct path and back via a mirror plane, or the other way round: two paths of the same length, the
        direct path r plus the path L to the sonar's image in the plane z = 0 or in the level bottom below the sonar.
        The sonar takes (r + L) / 2 for the range. Occlusion of the bounce is not checked, and it is received in the
        beam of the direct echo.
        """
        straight = returns.echoes.ranges.astype(float)
        heard = np.isfinite(straight)
        r = np.where(heard, straight, 1.0)
        start = T_map_sonar[:3, 3]
        points = start + r[:, None] * returns.directions
        normals = returns.echoes.normals.astype(float)
        facing = np.maximum(np.abs(echoes.dot(normals, returns.directions)), 1e-3)
        bottom = float(self.caster.world.ground_height(start[0], start[1]))
        found = []
        for plane, below in ((0.0, points[:, 2] < 0.0), (bottom, points[:, 2] > bottom + RAISED_M)):
            image = np.array([start[0], start[1], 2 * plane - start[2]])
            back = image - points
            length = np.sqrt(echoes.dot(back, back))
            # The bounced sound arrives from the direction of the point's mirror image.
            arriving = back * [-1.0, -1.0, 1.0]
            sine = echoes.dot(arriving, T_map_sonar[None, :3, 2]) / length
            ahead = echoes.dot(arriving, T_map_sonar[None, :3, 0]) > 0
            one_way = np.sqrt(acoustics.beam_pattern(np.arcsin(np.clip(sine, -1.0, 1.0)), self._vertical))
            response = one_way / np.sqrt(np.maximum(rays.weights, 1e-9))
            leaving = np.maximum(echoes.dot(normals, back) / length, 0.0)
            spread = (r / length) ** 2 * 10 ** (-0.1 * loss * (length - r))
            weaker = returns.powers * 2 * self.recipe.multipath**2 * response * spread * leaving / facing
            found.append(((length - r) / 2, np.where(heard & below & ahead, weaker, 0.0)))
        return found

    def _cloud(self, found: Ping, stamp_ns: int) -> Cloud:
        """Point cloud of the strongest return in each beam and each of CLOUD_ROWS elevation cells, where that exceeds
        the noise.

        A point lies on its ray, at the range of the image's row that it falls into; its intensity is the power of all
        returns in the same cell, in dB relative to a perfect scatterer that fills the beam at 1 m.
        """
        rays, returns = found.rays, found.returns
        left = np.radians(self.recipe.hfov_deg) / 2
        beam = np.floor((left - rays.azimuths) / (2 * left) * self.recipe.beams).astype(np.int64)
        row = ((rays.elevations + self._highest) / (2 * self._highest) * CLOUD_ROWS).astype(np.int64)
        place = found.axis.bin_of(returns.echoes.ranges.astype(float))
        heard = (returns.powers > 0) & (beam >= 0) & (beam < self.recipe.beams)
        chosen = np.flatnonzero(heard & (place >= 0) & (place < found.axis.bins))
        cell = beam[chosen] * CLOUD_ROWS + np.minimum(row[chosen], CLOUD_ROWS - 1)
        total = np.bincount(cell, returns.powers[chosen], self.recipe.beams * CLOUD_ROWS)
        order = np.lexsort((returns.powers[chosen], cell))
        order = order[np.append(np.diff(cell[order]) > 0, True)[: len(order)]]  # the last of each cell is its strongest
        strongest, power = chosen[order], total[cell[order]]
        strong = power > 10 ** (self.recipe.noise_db / 10)
        strongest, power = strongest[strong], power[strong]
        a, e = rays.azimuths[strongest], rays.elevations[strongest]
        believed = self.ranges[place[strongest].astype(np.int64)]
        points = believed[:, None] * np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return Cloud(
            stamp_ns=stamp_ns,
            sensor=self.recipe.name,
            points=np.round(points, 5).astype(np.float32),
            intensity=np.round(10 * np.log10(power), 2).astype(np.float32),
            classes=returns.echoes.classes[strongest],
            instances=returns.echoes.instances[strongest],
        )


def beam_azimuths(recipe: SonarRecipe) -> Array:
    """Azimuths (beams,) rad to the left of the axis: centres of equal parts of the horizontal aperture, left first."""
    share = (np.arange(recipe.beams) + 0.5) / recipe.beams
    return np.asarray(np.radians(recipe.hfov_deg) * (0.5 - share))


def build_columns(recipe: SonarRecipe) -> Columns:
    """Build ray columns, narrow compared with a beam, beyond the aperture's edges as far as the outer beams receive."""
    spacing, width = np.radians(recipe.hfov_deg) / recipe.beams, np.radians(recipe.beam_deg)
    per_beam = int(np.ceil(COLUMNS_PER_WIDTH * spacing / width))
    per_column = max(1, int(width / (MOST_PER_WIDTH * spacing)))
    column = spacing * per_column / per_beam
    margin = int(np.ceil(PATTERN_REACH * width / column))
    count = int(np.ceil(recipe.beams / per_column)) * per_beam + 2 * margin
    edges = np.radians(recipe.hfov_deg) / 2 + column * (margin - np.arange(count + 1))
    fine = 32  # samples of the pattern over a column
    across = (np.arange((per_beam + 2 * margin) * fine) + 0.5) / fine - margin  # in columns from its own first edge
    middles = (np.arange(per_column) + 0.5) * per_beam / per_column
    pattern = acoustics.beam_pattern((across - middles[:, None]) * column, width)
    return Columns(edges, per_beam, per_column, np.round(pattern.reshape(per_column, -1, fine).mean(axis=2), 12))


def gather(power: Array, columns: Columns, beams: int) -> Array:
    """Power (beams, bins) that the beams receive, given the power (columns, bins) that comes from each column."""
    heard = np.zeros((beams, power.shape[1]))
    for phase, taps in enumerate(columns.taps):
        those = heard[phase :: columns.per_column]
        part = np.empty_like(those)
        last = (len(those) - 1) * columns.per_beam + 1
        for k, tap in enumerate(taps):
            those += np.multiply(power[k : k + last : columns.per_beam], tap, out=part)
    return heard


class Sonar(SensorKind[SonarRecipe, SonarCalibration, Any]):
    """Sensor kind: imaging sonar. A ping's measurement is its image; its cloud is ground truth."""

    recipe = SonarRecipe
    calibration = SonarCalibration
    title = "imaging sonar"
    reader = "sonar"
    rank = 80
    bulky = True
    leaves: ClassVar = {"image": IMAGE}
    truth_leaves: ClassVar = {"cloud": POINTS}

    def topics(self, recipe: SonarRecipe) -> dict[str, str]:
        clouds = {topic(recipe.name, leaf): kind for leaf, kind in self.truth_leaves.items()}
        return super().topics(recipe) | (clouds if recipe.cloud else {})

    def calibrate(self, recipe: SonarRecipe, site: SiteRecipe) -> dict[str, Any]:
        return {
            **echoes.calibrate(recipe),
            "beams": recipe.beams,
            "bins": recipe.bins,
            "azimuths_rad": beam_azimuths(recipe).tolist(),
            "vfov_rad": float(np.radians(recipe.vfov_deg)),
            "frequency_hz": 1e3 * recipe.frequency_khz,
        }

    def measure(self, world: SensedWorld, recipe: SonarRecipe, at: Instants) -> Iterator[SonarPing]:
        site, bottom = world.recipe.site, world.recipe.reef.bottom
        sonar = world.instrument(recipe, lambda: ImagingSonar(world.caster, recipe, site, bottom))
        return echoes.pings(world, at, sonar.ping)

    def faults(self, world: SensedWorld, recipe: SonarRecipe) -> list[Fault]:
        """Pulses of other sonars that reach into its fan; value: their azimuth."""
        branch, fan = world.streams.at("sonar", recipe.name), float(np.radians(recipe.hfov_deg))
        return struck_pings(world, recipe, acoustics.mount_pose(recipe), branch.at, fan)

    def encode(self, recipe: SonarRecipe, measurement: SonarPing) -> list[Message]:
        """Messages: amplitudes as a 16-bit image, with a row per range bin, near first, and a column per beam, left
        first; and the cloud, if any."""
        image, cloud = measurement
        data = echo_image(image.stamp_ns, link(image.sensor), image.pixels)
        shown = Message(f"/{image.sensor}/image", image.stamp_ns, data)
        return [shown, *([] if cloud is None else [cloud_message(cloud)])]

    def decode(self, name: str, calibration: SonarCalibration, *data: bytes) -> SonarImage:
        stamp, pixels = read_echo_image(data[0], name, (len(calibration.ranges_m), len(calibration.azimuths_rad)))
        return SonarImage(stamp, name, pixels)

    def panels(self, sequence: Any, name: str) -> list[Panel]:
        from oysterbench.sensors.panels import WIDTH, Fan, Panel

        calibration = sequence.sonars[name]
        fan = Fan.of(calibration.azimuths_rad, calibration.ranges_m)
        title = f"{name}, to {calibration.ranges_m[-1]:.1f} m"
        return [Panel(title, WIDTH, fan.height, partial(_frames, sequence, name, fan), WIDTH * fan.height // 5)]


def _frames(sequence: Any, name: str, fan: Fan, times: NDArray[np.int64]) -> Iterator[Frame]:
    from oysterbench.sensors.panels import WIDTH, Frame, blank, jpeg, latest, white_of

    white = None
    for ping in latest(sequence.sonar, name, times):
        if ping is None:
            yield Frame(jpeg(blank(WIDTH, fan.height)), None)
            continue
        white = white or white_of(ping.pixels)
        yield Frame(jpeg(fan.draw(ping.pixels, white)), ping.stamp_ns)


KIND = Sonar()
