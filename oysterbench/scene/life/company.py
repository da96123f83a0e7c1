"""Cast of a dive: schools, fish, crabs and debris drawn from their streams, each to be encountered on the path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import LifeRecipe, SequenceRecipe
from oysterbench.scene.life import crab, fish
from oysterbench.scene.life.course import Course, build_course
from oysterbench.scene.life.drifter import Debris
from oysterbench.scene.life.flotsam import KINDS, VARIANTS, build_cable, build_flotsam
from oysterbench.scene.life.ground import Ground
from oysterbench.scene.life.school import School, draw_wander, school_places
from oysterbench.scene.life.states import Group, Vehicle
from oysterbench.scene.life.tether import PIECES, TURN_S, Tether
from oysterbench.scene.life.walker import Crab
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.path import Path
from oysterbench.scene.waves import Waves

AHEAD_M, ASIDE_M = (0.8, 1.8), 0.5  # where things are encountered, relative to the vehicle
SCHOOL_LOOP_M, FISH_LOOP_M, CRAB_LOOP_M = (1.2, 2.5), (0.8, 2.0), (0.25, 0.7)  # radii of courses
SCHOOL_HEIGHT_M, FISH_HEIGHT_M = (0.25, 0.7), (0.10, 0.5)  # over the ground's bound
TOADFISH_SHARE, TOADFISH_HEIGHT = 0.2, 0.05  # share of the solitary fish; height over the ground in lengths
CRAB_WIDTH_M, CRAB_SPEED_M_S = (0.05, 0.14), (0.03, 0.10)
DEBRIS_M = {"leaf": (0.04, 0.10), "grass": (0.12, 0.35), "film": (0.08, 0.25)}  # lengths
DEBRIS_HEIGHT_M = (0.05, 0.8)
CURRENT_NEAR_BOTTOM = 0.8  # relative to the mean current, within a metre of the bottom (law of the wall)


@dataclass(frozen=True)
class Company:
    """A group and its meshes: their name, unique among the meshes of all groups, and the function that builds them."""

    group: Group
    meshes: tuple[str, Callable[[], list[Mesh]]]


@dataclass(frozen=True)
class _Meeting:
    """What is needed of a dive to place encounters: its duration, half the side of the free square, the vehicle."""

    duration_s: float
    half_m: float
    vehicle: Vehicle

    def place(self, share: float, generator: np.random.Generator) -> tuple[float, Array]:
        """Time, s, at a share of the dive, and a place x, y (2,), m, in front of the vehicle then, inside the reef."""
        time = float(np.clip(share, 0.02, 0.98)) * self.duration_s
        position, rotation = self.vehicle(np.array([time]))
        ahead = rotation[0, :2, 0] / max(float(np.linalg.norm(rotation[0, :2, 0])), 1e-6)
        left = np.array([-ahead[1], ahead[0]])
        place = position[0, :2] + generator.uniform(*AHEAD_M) * ahead + generator.uniform(-ASIDE_M, ASIDE_M) * left
        return time, np.clip(place, -self.half_m, self.half_m)

    def course(
        self, share: float, loop_m: tuple[float, float], speed: float, rest: tuple[float, float], streams: Streams
    ) -> Course:
        """Draw a course that crosses the vehicle's way; rest: swing and period (s) of its speed."""
        generator = streams.generator("course")
        time, place = self.place(share, generator)
        radius = min(generator.uniform(*loop_m), 0.6 * self.half_m)
        return build_course(place, time, radius, speed, *rest, self.half_m, generator)


def gather(recipe: SequenceRecipe, ground: Ground, path: Path, waves: Waves, streams: Streams) -> list[Company]:
    """Draw all groups of a recipe's life."""

    def vehicle(times_s: Array) -> tuple[Array, Array]:
        motion = path.at(np.clip(times_s, 0.0, recipe.duration_s))
        return motion.position, motion.rotation

    life = recipe.life
    margin = max(life.school_half_axes_m()[0] if life.schools else 0.0, 0.2)
    dive = _Meeting(recipe.duration_s, recipe.reef.size_m / 2 - margin, vehicle)
    company = [_school(life, k, dive, ground, streams.at("school", k)) for k in range(life.schools)]
    company += [_alone(life, k, dive, ground, streams.at("fish", k)) for k in range(life.fish)]
    company += [_crab(life, k, dive, ground, streams.at("crab", k)) for k in range(life.crabs)]
    company += _debris(recipe, dive, ground, waves, streams)
    if life.tether:
        company.append(_tether(life, dive, ground, waves, streams.generator("tether")))
    return company


def _share(k: int, count: int, generator: np.random.Generator) -> float:
    """When the k-th of several is encountered, as a share of the dive: spread evenly, at random within its part."""
    return float((k + generator.random()) / count)


def _fish_meshes(species: str) -> tuple[str, Callable[[], list[Mesh]]]:
    phases = 2 * np.pi * np.arange(fish.PHASES) / fish.PHASES
    return species, lambda: [fish.build_fish(species, phase) for phase in phases]


def _school(life: LifeRecipe, k: int, dive: _Meeting, ground: Ground, streams: Streams) -> Company:
    generator = streams.generator("fish")
    n, length = life.school_size, life.school_fish_cm * 1e-2
    species = "silverside" if generator.random() < 0.65 or length < 0.07 else "croaker"
    lengths = length * np.exp(0.08 * generator.standard_normal(n))
    speed = life.school_speed_m_s * generator.uniform(0.85, 1.15)
    course = dive.course(_share(k, life.schools, generator), SCHOOL_LOOP_M, speed, (0.3, 9.0), streams)
    half_axes = life.school_half_axes_m()
    group = School(
        species,
        _fish_colours(n, generator),
        course,
        school_places(n, half_axes, generator),
        lengths,
        half_axes[2] + generator.uniform(*SCHOOL_HEIGHT_M),
        draw_wander(n, lengths, speed, generator),
        generator.random(n),
        ground,
        dive.vehicle,
    )
    return Company(group, _fish_meshes(species))


def _alone(life: LifeRecipe, k: int, dive: _Meeting, ground: Ground, streams: Streams) -> Company:
    generator = streams.generator("fish")
    species = "toadfish" if generator.random() < TOADFISH_SHARE else "croaker"
    lengths = np.clip(life.fish_cm * 1e-2 * np.exp(0.2 * generator.standard_normal(1)), 0.02, 0.25)
    speed = life.fish_speed_m_s * generator.uniform(0.7, 1.3)
    on_bottom = species == "toadfish"
    height = TOADFISH_HEIGHT * lengths[0] if on_bottom else generator.uniform(*FISH_HEIGHT_M)
    rest = (0.97, 14.0) if on_bottom else (0.5, 7.0)
    share = _share(k, life.fish, generator)
    course = dive.course(share, FISH_LOOP_M, 0.5 * speed if on_bottom else speed, rest, streams)
    wander = draw_wander(1, lengths, 0.0 if on_bottom else speed, generator)
    group = School(
        species,
        _fish_colours(1, generator),
        course,
        np.zeros((1, 3)),
        lengths,
        height,
        wander,
        generator.random(1),
        ground,
        dive.vehicle,
    )
    return Company(group, _fish_meshes(species))


def _fish_colours(n: int, generator: np.random.Generator) -> Array:
    """Draw factors (N, 3) on a coat's albedo."""
    return np.asarray(np.exp(0.08 * generator.standard_normal((n, 1)) + 0.03 * generator.standard_normal((n, 3))))


def _crab(life: LifeRecipe, k: int, dive: _Meeting, ground: Ground, streams: Streams) -> Company:
    generator = streams.generator("crab")
    width = generator.uniform(*CRAB_WIDTH_M)
    rest = (0.98, generator.uniform(6.0, 12.0))
    share = _share(k, life.crabs, generator)
    course = dive.course(share, CRAB_LOOP_M, generator.uniform(*CRAB_SPEED_M_S), rest, streams)
    colours = np.exp(0.15 * generator.standard_normal((1, 3)))
    phases = 2 * np.pi * np.arange(crab.PHASES) / crab.PHASES
    return Company(Crab(colours, course, width, ground), ("crab", lambda: [crab.build_crab(phase) for phase in phases]))


def _debris(recipe: SequenceRecipe, dive: _Meeting, ground: Ground, waves: Waves, streams: Streams) -> list[Company]:
    """Draw the debris, one group per kind."""
    to = np.radians(recipe.site.current_to_deg)
    current = CURRENT_NEAR_BOTTOM * recipe.site.current_m_s * np.array([np.cos(to), np.sin(to)])
    n = recipe.life.debris
    generator = streams.generator("debris")
    kinds = generator.integers(0, len(KINDS), n)
    met = [dive.place(_share(k, n, generator), generator) for k in range(n)]
    company = []
    for number, kind in enumerate(KINDS):
        of = np.flatnonzero(kinds == number)
        if not len(of):
            continue
        m = len(of)
        own = streams.generator("debris", kind)
        places = np.column_stack([np.array([met[k][1] for k in of]), own.uniform(*DEBRIS_HEIGHT_M, m)])
        rate = 2 * np.pi / own.uniform(5.0, 15.0, (m, 3))
        wander = np.stack([own.uniform(0.02, 0.10, (m, 3)), rate, own.uniform(0, 2 * np.pi, (m, 3))])
        group = Debris(
            kind,
            np.exp(0.2 * own.standard_normal((m, 1)) + 0.05 * own.standard_normal((m, 3))),
            places,
            np.array([met[k][0] for k in of]),
            current,
            wander,
            0.25 * own.standard_normal((m, 3)),
            Rotation.from_rotvec(own.uniform(-np.pi, np.pi, (m, 3))).as_quat(),
            own.integers(0, VARIANTS, m),
            own.uniform(*DEBRIS_M[kind], m),
            waves,
            ground,
            dive.vehicle,
        )
        company.append(Company(group, _flotsam_meshes(kind, streams)))
    return company


def _flotsam_meshes(kind: str, streams: Streams) -> tuple[str, Callable[[], list[Mesh]]]:
    return kind, lambda: [build_flotsam(kind, streams.generator("flotsam", kind, k)) for k in range(VARIANTS)]


def _tether(life: LifeRecipe, dive: _Meeting, ground: Ground, waves: Waves, generator: np.random.Generator) -> Company:
    """Draw the tether: the boat lies a few metres from the start of the dive; at some time the slack hangs ahead."""
    start = dive.vehicle(np.zeros(1))[0][0, :2]
    away = generator.uniform(0, 2 * np.pi)
    anchor = start + generator.uniform(1.5, 4.0) * np.array([np.cos(away), np.sin(away)])
    time = generator.uniform(0.1, 0.9) * dive.duration_s
    bow = dive.vehicle(np.array([time]))[1][0, :2, 0]
    phase = float(np.arctan2(bow[1], bow[0])) + generator.uniform(-0.3, 0.3) - 2 * np.pi * time / TURN_S
    group = Tether(np.ones((PIECES, 3)), anchor, life.tether_slack_m, phase, dive.vehicle, waves, ground)
    return Company(group, ("tether", lambda: [build_cable()]))
