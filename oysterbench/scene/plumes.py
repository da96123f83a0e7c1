"""Plumes of silt over soft bottom, as puffs that drift, spread and settle: a pure function of path, site and time.

Thrusters erode where the stress of their jets on the bottom is above a critical one; there and in bursts of the current
silt rises until the water over the bottom is as thick as the recipe says. A puff is a normal distribution above a level
floor that reflects it (image method: Fischer et al. 1979, ch. 2.3), less what has settled through the floor.
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
from oysterbench.scene.path.disturbance import HULL, current
from oysterbench.scene.path.itinerary import KNOT_S
from oysterbench.scene.waves import Waves, build_waves

HEAVE_ADDED_KG, HEAVE_LINEAR, HEAVE_QUADRATIC = 14.57, 5.18, 36.99
"""Of a BlueROV2 up and down (Wu 2018), kg, N/(m/s), N/(m/s)^2; the rest of its hull is disturbance.HULL."""

JET_DECAY = 6.2  # of a round jet's axial speed over U0 D / x (Albertson et al. 1950; Rajaratnam 1976)
JET_DIAMETER_M = 0.076  # of a T200 thruster
BED_FRICTION = 0.01  # times D / h: of a propeller's jet on the bed (Maynord 2000, UMRS ENV report 33)
EDGE_SHARE = 0.1  # of level thrust, whose jets sweep the bottom with their edges only
THRUSTER_BELOW_M = 0.1  # the body's origin
WATER_KG_M3 = 1020.0

EMIT_S = 0.5  # between puffs of the wash
WASH_PUFFS, BURST_PUFFS = 2, 10
WASH_M = 0.35  # by which a jet throws silt sideways before it slows down
RISE = 0.8  # of a plume's size: height to which it is thrown up
RISE_S = 1.0  # in which a puff comes up
LONGEST_S = 240.0
FAINTEST = 0.02  # 1/m in its middle, below which a puff is forgotten
MIRROR_NODES, MIRROR_WEIGHTS = leggauss(8)


class Puffs(NamedTuple):
    """Puffs at a time: centre (N, 3) m in `map`, spread (N,) m (standard deviation along each axis), floor (N,) m (z
    of the bottom that mirrors them), amount (N,) m^2 (attenuation in green, 1/m, times volume)."""

    centre: Array
    spread: Array
    floor: Array
    amount: Array

    def attenuation(self, points: Array) -> Array:
        """Attenuation (M,) that they add at points (M, 3), 1/m."""
        away = points[:, None] - self.centre
        mirrored = points[:, None, 2] - (2 * self.floor - self.centre[:, 2])
        level = np.exp(-0.5 * (away[..., 0] ** 2 + away[..., 1] ** 2) / self.spread**2)
        upright = np.exp(-0.5 * (away[..., 2] / self.spread) ** 2) + np.exp(-0.5 * (mirrored / self.spread) ** 2)
        return np.asarray((level * upright * self.amount / (np.sqrt(2 * np.pi) * self.spread) ** 3).sum(axis=1))


@dataclass(frozen=True)
class Plumes:
    """All puffs of a sequence. born (N,) s; place (N, 3) m in `map`, spread, floor (N,) m, amount (N,) m^2 at birth.

    times (T,) s, drift (T, 2) m: how far the current has carried the water since times[0].
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
        """The puffs that are there at a time."""
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
        """Share of the silt that has not settled: through the floor goes settling speed times what is just above it."""
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
    """The plumes of a sequence, or None where its recipe has none."""
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
    along = np.column_stack([np.interp(_emissions(recipe), times, axis) for axis in flow.T])
    return _wash(plumes, path, _emissions(recipe), along, thickest, ground_height, streams.generator("water", "wash"))


def _emissions(recipe: SequenceRecipe) -> Array:
    return np.arange(0.0, recipe.duration_s, EMIT_S)


def _grown(plumes: Plumes, born: Array, place: Array, floor: Array, spread: Array, attenuation: Array) -> Plumes:
    """With more puffs, of an attenuation (N,) 1/m each in its middle."""
    mirrored = 1 + np.exp(-2 * ((place[:, 2] - floor) / spread) ** 2)
    amount = attenuation * (np.sqrt(2 * np.pi) * spread) ** 3 / mirrored
    return dataclasses.replace(
        plumes,
        born=np.concatenate([plumes.born, np.round(born, 7)]),
        place=np.concatenate([plumes.place, np.round(place, 7)]),
        spread=np.concatenate([plumes.spread, np.round(spread, 7)]),
        floor=np.concatenate([plumes.floor, np.round(floor, 7)]),
        amount=np.concatenate([plumes.amount, np.round(amount, 7)]),
    )


def _burst(plumes: Plumes, recipe: SequenceRecipe, thickest: float, ground: Height, rng: np.random.Generator) -> Plumes:
    """Silt that current, waves and animals raise: a Poisson process over the reef and over time."""
    plan, size = plumes.recipe, recipe.reef.size_m
    span = recipe.duration_s + LONGEST_S
    count = rng.poisson(plan.bursts_per_100m2_min * size**2 / 100 * span / 60)
    born = np.repeat(rng.uniform(-LONGEST_S, recipe.duration_s, count), BURST_PUFFS)
    centre = np.repeat(rng.uniform(-size / 2, size / 2, (count, 2)), BURST_PUFFS, axis=0)
    strength = np.repeat(thickest * rng.uniform(0.3, 1.0, count), BURST_PUFFS)
    level = centre + 0.35 * plan.size_m * rng.standard_normal(centre.shape)
    spread = 0.25 * plan.size_m * rng.uniform(0.4, 1.2, len(born))
    floor = ground(level[:, 0], level[:, 1])
    place = np.column_stack([level, floor + plan.size_m * rng.uniform(0.0, RISE, len(born))])
    born = born + rng.uniform(0.0, 2.0, len(born))
    return _grown(plumes, born, place, floor, spread, strength * rng.uniform(0.3, 0.8, len(born)))


def _wash(
    plumes: Plumes, path: Path, times: Array, flow: Array, thickest: float, ground: Height, rng: np.random.Generator
) -> Plumes:
    """Silt that the thrusters raise at times (N,), in a current flow (N, 2) m/s: only as much as is not there yet."""
    plan = plumes.recipe
    motion = path.at(times)
    thrust = thrusts(motion.velocity, motion.acceleration, flow)
    height = motion.position[:, 2] - ground(motion.position[:, 0], motion.position[:, 1])
    excess = np.maximum(bed_stress(thrust, height) / plan.critical_pa - 1.0, 0.0)
    away = -thrust[:, :2] / np.maximum(np.linalg.norm(thrust[:, :2], axis=1), 1e-9)[:, None]
    draws = rng.random((len(times), WASH_PUFFS, 6))
    for i in np.flatnonzero(excess > 0.05):
        draw = draws[i]
        level = motion.position[i, :2] + WASH_M * away[i] * 2 * draw[:, :1] + 2 * WASH_M * (draw[:, 1:3] - 0.5)
        spread = 0.25 * plan.size_m * (0.6 + 0.6 * draw[:, 3])
        floor = ground(level[:, 0], level[:, 1])
        place = np.column_stack([level, floor + plan.size_m * RISE * draw[:, 4]])
        wanted = thickest * excess[i] / (1 + excess[i])
        missing = np.maximum(wanted - plumes.at(float(times[i])).attenuation(place), 0.0)
        more = missing * (0.3 + 0.4 * draw[:, 5])
        born = np.full(WASH_PUFFS, times[i])
        plumes = _grown(plumes, born, place, floor, spread, more)
    return plumes


def thrusts(velocity: Array, acceleration: Array, flow: Array) -> Array:
    """Force (N, 3) N of the thrusters in `map`: inertia and drag of velocity (N, 3) m/s through water that flows at
    flow (N, 2) m/s, with the means of surge and sway for both level axes."""
    through = velocity - np.column_stack([flow, np.zeros(len(flow))])
    level_speed = np.linalg.norm(through[:, :2], axis=1, keepdims=True)
    added, linear, quadratic = (float(np.mean(pair)) for pair in (HULL.added_kg, HULL.linear, HULL.quadratic))
    level = (HULL.mass_kg + added) * acceleration[:, :2] + (linear + quadratic * level_speed) * through[:, :2]
    up = (HULL.mass_kg + HEAVE_ADDED_KG) * acceleration[:, 2]
    up = up + (HEAVE_LINEAR + HEAVE_QUADRATIC * np.abs(through[:, 2])) * through[:, 2]
    return np.column_stack([level, up])


def bed_stress(thrust: Array, height: Array) -> Array:
    """Stress (N,) Pa of the thrusters' jets on the bottom, of a vehicle `height` (N,) m over it.

    A thrust F makes a jet of speed U0 = sqrt(F / (rho A)), on the bottom of JET_DECAY U0 D / h; its stress is
    C rho U^2 / 2 with C = BED_FRICTION D / h. Thrust up blows down.
    """
    force = np.maximum(thrust[:, 2], 0.0) + EDGE_SHARE * np.linalg.norm(thrust[:, :2], axis=1)
    below = np.maximum(height - THRUSTER_BELOW_M, JET_DIAMETER_M)
    speed2 = JET_DECAY**2 * 4 / np.pi * force / (WATER_KG_M3 * below**2)
    return np.asarray(0.5 * BED_FRICTION * JET_DIAMETER_M / below * WATER_KG_M3 * speed2)
