"""Mechanically scanned sonar: one narrow beam on a turning head, which moves on with every ping."""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import ScanPing
from oysterbench.core.streams import Streams
from oysterbench.recipe import ScannerRecipe, SiteRecipe
from oysterbench.render.rays import RayCaster
from oysterbench.sensors import acoustics, echoes
from oysterbench.sensors.echoes import Rays

COLUMNS, ROWS = 24, 240  # of rays over the beam's main lobe


class ScanningSonar:
    """A scanning sonar in a world, over a bottom of a kind of recipe.BOTTOMS.

    Amplitudes are linear, in counts of `amplitude_step`, as an imaging sonar's are. Each ping is sent and heard at one
    pose: what a turning head smears is that the vehicle moves between its pings.
    """

    def __init__(self, caster: RayCaster, recipe: ScannerRecipe, site: SiteRecipe, bottom: str = "sand") -> None:
        self.caster = caster
        self.recipe = recipe
        self.site = site
        self.amplitude_step = echoes.amplitude_step(recipe)
        self._mount = acoustics.mount_pose(recipe)
        self._mu = acoustics.backscatter(bottom)
        self._across, self._vertical = float(np.radians(recipe.beam_deg)), float(np.radians(recipe.vfov_deg))
        self._fill = acoustics.aperture(self._across) * acoustics.aperture(self._vertical)

    @property
    def ranges(self) -> Array:
        """(bins,) m, of the middles of the bins, as the sonar believes them."""
        return echoes.bin_middles(self.recipe)

    def ping(self, T_map_base: Array, streams: Streams, index: int, stamp_ns: int = 0) -> ScanPing:
        """Ping `index`, with the vehicle at T_map_base (4, 4) and the head where that many steps have brought it."""
        branch = streams.at("scanner", self.recipe.name, index)
        angle = head_angle(self.recipe, index)
        power, loss = self.listen(T_map_base, angle, branch)
        amplitudes = echoes.record(power, self.recipe, loss, branch.generator("noise"))
        return ScanPing(stamp_ns, self.recipe.name, angle, amplitudes)

    def listen(self, T_map_base: Array, angle: float, streams: Streams) -> tuple[Array, float]:
        """Expected power (bins,) of a ping with the head at an angle (rad), and the absorption in dB/m."""
        T_map_sonar = np.asarray(T_map_base, dtype=float) @ self._mount
        medium = echoes.Medium.at(self.site, -float(T_map_sonar[2, 3]), self.recipe.frequency_khz)
        axis = echoes.range_axis(self.recipe, medium.speed)
        rays = self._rays(angle, streams.generator("rays"))
        returns = echoes.send(self.caster, T_map_sonar, rays, self._mu, medium.loss, self._fill, axis.reach)
        power = echoes.add_up(axis, rays.columns, 1, returns.nearest, returns.farthest, returns.powers)
        return echoes.resolve(power, axis, medium.speed, self.recipe.bandwidth_khz)[0], medium.loss

    def _rays(self, angle: float, generator: np.random.Generator) -> Rays:
        """Rays anywhere in the cells of a grid over the main lobe."""
        widest, highest = acoustics.first_null(self._across), acoustics.first_null(self._vertical)
        width, height = 2 * widest / COLUMNS, 2 * highest / ROWS
        anywhere = generator.random((2, COLUMNS, ROWS))
        across, along = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS), indexing="ij")
        off = width * (across + anywhere[0]) - widest
        elevations = height * (along + anywhere[1]) - highest
        middles = [angle + width * (across + 0.5) - widest, height * (along + 0.5) - highest]
        weights = acoustics.beam_pattern(off, self._across) * acoustics.beam_pattern(elevations, self._vertical)
        return Rays(
            azimuths=(angle + off).ravel(),
            elevations=elevations.ravel(),
            middles=np.reshape(middles, (2, -1)),
            widths=np.full(off.size, width),
            heights=np.full(off.size, height),
            columns=np.zeros(off.size, dtype=np.int64),
            weights=weights.ravel(),
        )


def head_angle(recipe: ScannerRecipe, index: int) -> float:
    """Angle (rad, left of the mount's x, in (-pi, pi]) of the head at ping `index`.

    A full turn starts ahead and goes on to the left; a sector is swept to and fro, first from right to left.
    """
    if recipe.sector_deg >= 360:
        turned = (index * recipe.step_deg) % 360.0
        return float(np.radians(turned - 360.0 if turned > 180.0 else turned))
    steps = max(1, int(np.floor(recipe.sector_deg / recipe.step_deg + 1e-9)))
    place = index % (2 * steps)
    return float(np.radians((min(place, 2 * steps - place) - steps / 2) * recipe.step_deg))
