"""Small reefs, poses and renderers that tests of the renderer share."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import CameraRecipe, LampRecipe, RigRecipe, SequenceRecipe, load_split
from oysterbench.render.camera import CameraRenderer
from oysterbench.scene.rig import R_FORWARD_OPTICAL
from oysterbench.scene.world import World, build_world

CAMERA = CameraRecipe(name="test", width=160, height=120, hfov_deg=69.0, rate_hz=10.0)
SPLIT = load_split("slam-mini")
FLAT = {"relief_rms_m": 0.0, "oysters": 0, "stones": 0}


def small_reef(reef: dict[str, Any] | None = None, water: Any = None, light: Any = None) -> SequenceRecipe:
    """A reef of 4 x 4 m in 3 m of water, with some of its keys replaced."""
    recipe = SPLIT.sequence[0]
    base = {"size_m": 4.0, "depth_m": 3.0, "relief_rms_m": 0.08, "oysters": 60, "stones": 6}
    return dataclasses.replace(
        recipe,
        reef=dataclasses.replace(recipe.reef, **{**base, **(reef or {})}),
        water=dataclasses.replace(recipe.water, **(water or {})),
        light=dataclasses.replace(recipe.light, **(light or {})),
    )


def pose(x: float, y: float, z: float, yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """T_map_cam of a camera at x, y, z in `map` that looks down by its pitch."""
    body = Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    return transform(body @ R_FORWARD_OPTICAL, [x, y, z])


def noise(name: str = "a") -> np.random.Generator:
    """A stream for the sensor's noise."""
    return Streams(3).generator("noise", name)


def world_of(recipe: SequenceRecipe) -> World:
    """The world of a recipe, always the same."""
    return build_world(recipe, Streams(4))


def rig_with(*lamps: LampRecipe, vehicle: str = "none") -> RigRecipe:
    """The usual rig with lamps and perhaps a body."""
    return dataclasses.replace(SPLIT.rig, lamp=lamps, vehicle=vehicle)


def renderer_of(recipe: SequenceRecipe, camera: CameraRecipe = CAMERA, **keys: Any) -> CameraRenderer:
    """A renderer over the world of a recipe."""
    return CameraRenderer(world_of(recipe), camera, recipe, **keys)
