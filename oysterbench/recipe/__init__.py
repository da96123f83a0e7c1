"""Recipes: TOML files that define a split, a sequence and a rig, read into validated frozen dataclasses.

Everything that determines the bytes of a sequence is in them; keys carry their unit, angles are in degrees. A bad
value is refused with file, key, value and the allowed range. The fields of the dataclasses document the keys.
"""

from oysterbench.recipe.drawn import draw
from oysterbench.recipe.keys import as_plain
from oysterbench.recipe.life import LifeRecipe
from oysterbench.recipe.path import LOOP_RIPPLE, PathRecipe
from oysterbench.recipe.rig import CameraRecipe, LampRecipe, RigRecipe, count
from oysterbench.recipe.scene import (
    BOTTOMS,
    CLASSES,
    JERLOV_TYPES,
    LIFE_CLASSES,
    OYSTER,
    REEF_CLASSES,
    UNDISTURBED,
    WATER_TYPES,
    DrawnRecipe,
    LightRecipe,
    ReefRecipe,
    SequenceRecipe,
    SiteRecipe,
    WaterRecipe,
)
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.recipe.split import SplitRecipe, load_split, parse_split, split_names, vary_split, with_rig
from oysterbench.recipe.steering import SteeringRecipe

__all__ = [
    "BOTTOMS",
    "CLASSES",
    "JERLOV_TYPES",
    "LIFE_CLASSES",
    "LOOP_RIPPLE",
    "OYSTER",
    "REEF_CLASSES",
    "UNDISTURBED",
    "WATER_TYPES",
    "CameraRecipe",
    "DrawnRecipe",
    "LampRecipe",
    "LifeRecipe",
    "LightRecipe",
    "PathRecipe",
    "ReefRecipe",
    "RigRecipe",
    "SensorRecipe",
    "SequenceRecipe",
    "SiteRecipe",
    "SplitRecipe",
    "SteeringRecipe",
    "WaterRecipe",
    "as_plain",
    "count",
    "draw",
    "load_split",
    "parse_split",
    "split_names",
    "vary_split",
    "with_rig",
]
