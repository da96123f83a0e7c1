"""Bare worlds that sound can be computed for by hand: a level bottom, walls and balls; and paths of constant motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.streams import Streams
from oysterbench.render.rays import RayCaster
from oysterbench.scene.instances import CLASS_NUMBERS, Instances, join_instances, make_instances
from oysterbench.scene.library import Library
from oysterbench.scene.mesh import build_mesh
from oysterbench.scene.path import Motion
from oysterbench.scene.terrain import Terrain
from oysterbench.scene.world import World

BALL, BOX = 0, 1


def caster_over(depth_m: float, *things: Instances, heights=None) -> RayCaster:
    """A caster over a level bottom, or one of heights(x, y), with things on it or in the water."""
    lines = np.concatenate([[-90.0, -50.0, -30.0], np.linspace(-20, 20, 161), [30.0, 50.0, 90.0]])
    x, y = np.meshgrid(lines, lines)
    ground = np.full(x.shape, -depth_m) if heights is None else heights(x, y)
    terrain = Terrain(lines, ground.astype(np.float32), 3)
    ball = trimesh.creation.icosphere(subdivisions=5)
    box = trimesh.creation.box()
    box.unmerge_vertices()  # hard edges
    meshes = tuple(build_mesh(shape.vertices, shape.faces) for shape in (ball, box))
    instances = join_instances(things) if things else nothing()
    return RayCaster(
        World(terrain, Library((), meshes, {}, {}), instances, Streams(0), lines, terrain.heights, terrain.heights)
    )


def ball(x: float, y: float, z: float, radius: float, kind: str = "stone") -> Instances:
    """A ball around a point of `map`, m."""
    return _thing(BALL, (x, y, z), (radius, radius, radius), kind)


def wall(x: float, kind: str = "stone") -> Instances:
    """A wall 40 m wide and high, whose near face is the plane at x, m."""
    return _thing(BOX, (x + 0.5, 0.0, 0.0), (1.0, 40.0, 40.0), kind)


def nothing() -> Instances:
    """An empty table."""
    return ball(0, 0, 0, 1).take(np.zeros(0, dtype=int))


def at(x: float, y: float, z: float, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> np.ndarray:
    """T_map_base at a place; pitch is positive below the horizon."""
    return transform(Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True).as_matrix(), (x, y, z))


@dataclasses.dataclass(frozen=True)
class Steady:
    """A path that starts at T_map_base, with a velocity in `map`, m/s, and perhaps a body rate, rad/s, at its start."""

    T_map_base: np.ndarray
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, times_s: np.ndarray) -> Motion:
        n = len(times_s)
        turned = Rotation.from_rotvec(np.outer(times_s, self.rate)).as_matrix()
        zeros = np.zeros((n, 3))
        return Motion(
            position=self.T_map_base[:3, 3] + np.outer(times_s, self.velocity),
            velocity=np.tile(self.velocity, (n, 1)),
            acceleration=zeros,
            rotation=self.T_map_base[:3, :3] @ turned,
            rate=np.tile(self.rate, (n, 1)),
            rate_dot=zeros,
        )


def _thing(shape: int, place, scale, kind: str) -> Instances:
    assert kind in CLASS_NUMBERS
    return make_instances(
        kind,
        np.array([shape]),
        np.array([place], dtype=float),
        np.eye(3)[None],
        np.array([scale], dtype=float),
        np.full((1, 3), 0.3),
        np.zeros(1),
    )
