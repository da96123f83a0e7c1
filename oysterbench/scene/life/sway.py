"""Plants in the surge: each leans with the water's displacement at its place, so they sway in phase over metres."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe
from oysterbench.scene.mesh import round_positions
from oysterbench.scene.waves import Waves, build_waves, depth_factors, dispersion
from oysterbench.scene.world import World

REACH = 0.75
"""Largest displacement of a plant's tips, relative to its height, when the water moves farther (Luhar & Nepf 2016:
blades shorter than the water's excursion are stretched out by it and wait)."""

LEAST_M = 1e-4  # a wave's displacement at the bottom below which it is ignored


@dataclass(frozen=True)
class Sway:
    """The swaying plants of a world: rows (P,) of its instances, heights (P,) m, and the motion of the water over them.

    sine, cosine (P, K): of each wave component's phase at each plant; drift (K, 2) m: its amplitude at the bottom along
    x and y, times the share that the plants follow; omega (K,) rad/s.
    """

    rows: NDArray[np.int64]
    heights: Array
    sine: Array
    cosine: Array
    drift: Array
    omega: Array

    def water(self, time_s: float) -> Array:
        """Displacement (P, 2) m of the water at the plants, times the share that they follow."""
        # sin(phase - omega t), as in Waves.displacement.
        at, of = np.cos(self.omega * time_s)[:, None], np.sin(self.omega * time_s)[:, None]
        return np.asarray(
            -np.einsum("pk,ka->pa", self.sine, self.drift * at) + np.einsum("pk,ka->pa", self.cosine, self.drift * of)
        )

    def tips(self, time_s: float) -> Array:
        """Displacement (P, 2) m of the highest tips from their positions in still water."""
        moved = self.water(time_s)
        reach = REACH * self.heights[:, None]
        return np.asarray(moved / np.sqrt(1 + (moved / reach) ** 2))

    def lean(self, time_s: float) -> NDArray[np.float32]:
        """Image (P, 3) of the upright unit vector: tips move sideways and, as blades do not stretch, down."""
        aside = self.tips(time_s) / self.heights[:, None]
        up = np.sqrt(np.maximum(1 - (aside**2).sum(axis=1), 0.05))
        return round_positions(np.column_stack([aside, up]))


def build_sway(world: World, recipe: SequenceRecipe, waves: Waves) -> Sway | None:
    """Build the sway of a world's plants under waves; None if nothing sways."""
    plants = np.flatnonzero(world.of_class_mask("plant"))
    life = recipe.life
    if not life.sway or not len(plants) or not len(waves.omega):
        return None
    tall = np.array([mesh.vertices[:, 2].max() for mesh in world.meshes])
    instances = world.instances
    heights = tall[instances.shapes[plants]] * instances.scales[plants, 2].astype(float)
    size = np.linalg.norm(waves.wavenumber, axis=1)
    along = np.array([depth_factors(k, np.array([-waves.depth_m]), waves.depth_m)[0][0] for k in size])
    amplitude = waves.amplitude * along
    kept = amplitude > LEAST_M
    phase = instances.positions[plants, :2].astype(float) @ waves.wavenumber[kept].T + waves.phase[kept]
    heading = waves.wavenumber[kept] / size[kept, None]
    drift = life.sway * amplitude[kept, None] * heading
    return Sway(plants, heights, np.sin(phase), np.cos(phase), drift, waves.omega[kept])


def life_waves(recipe: SequenceRecipe, streams: Streams) -> Waves:
    """Waves that move plants and drifters: the site's, or a distant swell whose surge at the bottom is given in
    `recipe.life`."""
    life, site, depth = recipe.life, recipe.site, recipe.reef.depth_m
    if life.surge_m:
        # Linear waves of height H have a displacement of amplitude H / (2 sinh kh) at the bottom.
        k = dispersion(np.array([2 * np.pi / life.surge_period_s]), depth)[0]
        height = 2 * life.surge_m * float(np.sinh(k * depth))
        site = dataclasses.replace(site, wave_height_m=height, wave_period_s=life.surge_period_s)
    return build_waves(site, depth, streams)
