"""Plumes of silt over soft bottom, as puffs that drift, spread and settle: a pure function of path, site and time.

Thrusters erode the bottom where the bed stress of their jets exceeds a critical value; there, and in bursts of the
current, silt rises until the water over the bottom is as turbid as the recipe says. A puff is a normal distribution
above a level floor that reflects it (image method: Fischer et al. 1979, ch. 2.3), less what has settled through it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe
from oysterbench.recipe.turbidity import PlumesRecipe
from oysterbench.scene.path import Path
from oysterbench.scene.path.clearance import Height
from oysterbench.scene.path.disturbance import current
from oysterbench.scene.path.itinerary import KNOT_S
from oysterbench.scene.path.thrust import STEP_S, thrust
from oysterbench.scene.waves import Waves, build_waves

JET_DECAY = 6.2  # axial speed of a round jet over U0 D / x (Albertson et al. 1950; Rajaratnam 1976)
JET_DIAMETER_M = 0.076  # of a T200 thruster
BED_FRICTION = 0.01  # times D / h: friction of a propeller's jet on the bed (Maynord 2000, UMRS ENV report 33)
EDGE_SHARE = 0.1  # share of the horizontal thrust that counts: its jets sweep the bottom with their edges only
THRUSTER_BELOW_M = 0.1  # depth of the thrusters below the body's origin
WATER_KG_M3 = 1020.0

EMIT_STEPS = 10  # thrust steps between puffs of the wash
WASH_PUFFS, BURST_PUFFS = 2, 10
WASH_M = 0.35  # distance to which a jet throws silt sideways before slowing down
SPREADS = 3.5  # extent of a puff that is counted, in standard deviations
RISE = 0.8  # height to which a plume is thrown up, relative to its size
RISE_S = 1.0  # time in which a puff rises
LONGEST_S = 240.0
UPSTREAM_S, UPSTREAM_M = 60.0, 10.0  # margin around the reef (drift time, maximum) from which silt can arrive
FAINTEST = 0.05  # attenuation at its centre, 1/m, below which a puff is dropped
MIRROR_NODES, MIRROR_WEIGHTS = leggauss(8)


class Puffs(NamedTuple):
    """Puffs at one time: centre (N, 3) m in `map`, spread (N,) m (standard deviation along each axis), floor (N,) m (z
    of the bottom that mirrors them), amount (N,) m^2 (attenuation in green, 1/m, times volume)."""

    centre: Array
    spread: Array
    floor: Array
    amount: Array

    def near(self, place: Array, distance: float) -> Puffs:
        """Puffs that reach to within a distance (m) of a place (3,), m in `map`."""
        chosen = np.linalg.norm(self.centre - place, axis=1) < distance + SPREADS * self.spread
        return Puffs(*(values[chosen] for values in self))

    def attenuation(self, points: Array) -> Array:
        """Attenuation (M,), 1/m, that the puffs add at points (M, 3), m in `map`."""
        away = points[:, None] - self.centre
        mirrored = points[:, None, 2] - (2 * self.floor - self.centre[:, 2])
        level = np.exp(-0.5 * (away[..., 0] ** 2 + away[..., 1] ** 2) / self.spread**2)
        upright = np.exp(-0.5 * (away[..., 2] / self.spread) ** 2) + np.exp(-0.5 * (mirrored / self.spread) ** 2)
        return np.asarray((level * upright * self.amount / (np.sqrt(2 * np.pi) * self.spread) ** 3).sum(axis=1))


@dataclass(frozen=True)
class Plumes:
    """All puffs of a sequence. born (N,) s; place (N, 3) m in `map`, spread, floor (N,) m and amount (N,) m^2 at birth.

    times (T,) s, drift (T, 2) m: displacement of the water by the current since times[0].
    """

    recipe: PlumesRecipe
    born: Array
    place: Array
    spread: Array
    floor: Array
    amount: Array
    times: Array
    drift: Array
    waves: Waves

    def at(self, time_s: float) -> Puffs:
        """Puffs that exist at time_s."""
        age = time_s - self.born
        alive = np.flatnonzero((age > 0) & (age < LONGEST_S))
        age, born = age[alive], self.born[alive]
        spread = np.sqrt(self.spread[alive] ** 2 + 2 * self.recipe.diffusivity_m2_s * age)
        place, floor = self.place[alive].copy(), self.floor[alive]
        amount: Array = self.amount[alive] * self._left(alive, age) * _rise(age)
        place[:, :2] += self._drift(np.full(len(alive), time_s)) - self._drift(born)
        if len(self.waves.amplitude):
            there = self.waves.displacement(place, np.full(len(alive), time_s))
            place[:, :2] += (there - self.waves.displacement(place, born))[:, :2]
        place[:, 2] = floor + np.maximum(place[:, 2] - floor - self.recipe.settling_mm_s * 1e-3 * age, 0.0)
        seen = amount > FAINTEST * (np.sqrt(2 * np.pi) * spread) ** 3
        return Puffs(*(np.round(x[seen], 7) for x in (place, spread, floor, amount)))

    def _left(self, alive: NDArray[np.intp], age: Array) -> Array:
        """Share of the silt that has not settled yet: the flux through the floor is the settling speed times the
        concentration just above it."""
        speed = self.recipe.settling_mm_s * 1e-3
        then = 0.5 * age[:, None] * (1 + MIRROR_NODES)
        spread2 = self.spread[alive, None] ** 2 + 2 * self.recipe.diffusivity_m2_s * then
        height = np.maximum((self.place[alive, 2] - self.floor[alive])[:, None] - speed * then, 0.0)
        just_above = 2 * np.exp(-0.5 * height**2 / spread2) / np.sqrt(2 * np.pi * spread2)
        return np.asarray(np.exp(-speed * 0.5 * age * (just_above * MIRROR_WEIGHTS).sum(axis=1)))

    def _drift(self, times_s: Array) -> Array:
        return np.column_stack([np.interp(times_s, self.times, axis) for axis in self.drift.T])


def _rise(age: Array) -> Array:
    grown = np.clip(age / RISE_S, 0.0, 1.0)
    return np.asarray(grown * grown * (3 - 2 * grown))


def build_plumes(recipe: SequenceRecipe, path: Path, ground_height: Height, streams: Streams) -> Plumes | None:
    """Build the plumes of a sequence; None if its recipe has none."""
    plan = recipe.water.plumes
    if not plan.attenuation:
        return None
    times = np.arange(-LONGEST_S, recipe.duration_s + 2.0, KNOT_S)
    flow = np.zeros((len(times), 2))
    if recipe.site.current_m_s:
        mean, gusts = current(times, recipe.site, streams)
        flow = mean + gusts
    steps = 0.5 * KNOT_S * (flow[1:] + flow[:-1])
    drift = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    waves = build_waves(recipe.site, recipe.reef.depth_m, streams)
    thickest = plan.attenuation * (1.0 if recipe.reef.bottom == "mud" else recipe.reef.silt)
    nothing = (np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0))
    plumes = Plumes(plan, *nothing, times, drift, waves)
    plumes = _burst(plumes, recipe, thickest, ground_height, streams.generator("water", "bursts"))
    steps_s = np.arange(0.0, recipe.duration_s, STEP_S)
    force = np.einsum("nij,nj->ni", path.at(steps_s).rotation, thrust(path, recipe, streams, steps_s))
    when = slice(None, None, EMIT_STEPS)
    wash = streams.generator("water", "wash")
    return _wash(plumes, path.at(steps_s[when]).position, steps_s[when], force[when], thickest, ground_height, wash)


def _grown(plumes: Plumes, born: Array, place: Array, floor: Array, spread: Array, attenuation: Array) -> Plumes:
    """Return the plumes with puffs added, of attenuation (N,) 1/m at their centres without their mirror images."""
    amount = attenuation * (np.sqrt(2 * np.pi) * spread) ** 3
    return dataclasses.replace(
        plumes,
        born=np.concatenate([plumes.born, np.round(born, 7)]),
        place=np.concatenate([plumes.place, np.round(place, 7)]),
        spread=np.concatenate([plumes.spread, np.round(spread, 7)]),
        floor=np.concatenate([plumes.floor, np.round(floor, 7)]),
        amount=np.concatenate([plumes.amount, np.round(amount, 7)]),
    )


def _burst(plumes: Plumes, recipe: SequenceRecipe, thickest: float, ground: Height, rng: np.random.Generator) -> Plumes:
    """Add silt raised by current, waves and animals: a Poisson process over reef, surroundings and time."""
    plan = plumes.recipe
    size = recipe.reef.size_m + 2 * min(UPSTREAM_S * recipe.site.current_m_s, UPSTREAM_M)
    span = recipe.duration_s + LONGEST_S
    count = rng.poisson(plan.bursts_per_100m2_min * size**2 / 100 * span / 60)
    born = np.repeat(rng.uniform(-LONGEST_S, recipe.duration_s, count), BURST_PUFFS)
    centre = np.repeat(rng.uniform(-size / 2, size / 2, (count, 2)), BURST_PUFFS, axis=0)
    strength = thickest * rng.uniform(0.3, 1.0, count)
    level = centre + 0.35 * plan.size_m * rng.standard_normal(centre.shape)
    spread = 0.25 * plan.size_m * rng.uniform(0.4, 1.2, len(born))
    floor = ground(level[:, 0], level[:, 1])
    place = np.column_stack([level, floor + plan.size_m * rng.uniform(0.0, RISE, len(born))])
    born = born + rng.uniform(0.0, 2.0, len(born))
    share = rng.uniform(0.3, 0.8, len(born))
    scale = np.empty(count)
    for k in range(count):
        one = slice(k * BURST_PUFFS, (k + 1) * BURST_PUFFS)
        volume = (np.sqrt(2 * np.pi) * spread[one]) ** 3
        whole = Puffs(place[one], spread[one], floor[one], share[one] * volume)
        scale[k] = strength[k] / whole.attenuation(place[one]).max()
    return _grown(plumes, born, place, floor, spread, share * np.repeat(scale, BURST_PUFFS))


def _wash(
    plumes: Plumes,
    position: Array,
    times: Array,
    force: Array,
    thickest: float,
    ground: Height,
    rng: np.random.Generator,
) -> Plumes:
    """Add silt raised by the thrusters at times (N,) s, at positions (N, 3) m and with forces (N, 3) N, both in `map`:
    only as much as is still missing there."""
    plan = plumes.recipe
    height = position[:, 2] - ground(position[:, 0], position[:, 1])
    excess = np.maximum(bed_stress(force, height) / plan.critical_pa - 1.0, 0.0)
    away = -force[:, :2] / np.maximum(np.linalg.norm(force[:, :2], axis=1), 1e-9)[:, None]
    draws = rng.random((len(times), WASH_PUFFS, 6))
    for i in np.flatnonzero(excess > 0.05):
        draw = draws[i]
        level = position[i, :2] + WASH_M * away[i] * 2 * draw[:, :1] + 2 * WASH_M * (draw[:, 1:3] - 0.5)
        spread = 0.25 * plan.size_m * (0.6 + 0.6 * draw[:, 3])
        floor = ground(level[:, 0], level[:, 1])
        place = np.column_stack([level, floor + plan.size_m * RISE * draw[:, 4]])
        wanted = thickest * excess[i] / (1 + excess[i])
        missing = np.maximum(wanted - plumes.at(float(times[i])).attenuation(place), 0.0)
        more = missing * (0.3 + 0.4 * draw[:, 5])
        born = np.full(WASH_PUFFS, times[i])
        plumes = _grown(plumes, born, place, floor, spread, more)
    return plumes


def bed_stress(force: Array, height: Array) -> Array:
    """Bed stress (N,) Pa of the jets of thrusters that exert a force (N, 3) N, in `map`, on a vehicle `height` (N,) m
    above the bottom.

    A force F makes a jet of speed U0 = sqrt(F / (rho A)), which is JET_DECAY U0 D / h at the bottom; its stress is
    C rho U^2 / 2 with C = BED_FRICTION D / h. Upward thrust blows down.
    """
    on_bottom = np.maximum(force[:, 2], 0.0) + EDGE_SHARE * np.linalg.norm(force[:, :2], axis=1)
    below = np.maximum(height - THRUSTER_BELOW_M, JET_DIAMETER_M)
    speed2 = JET_DECAY**2 * 4 / np.pi * on_bottom / (WATER_KG_M3 * below**2)
    return np.asarray(0.5 * BED_FRICTION * JET_DIAMETER_M / below * WATER_KG_M3 * speed2)
