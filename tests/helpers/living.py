"""A small reef on which everything moves."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

from oysterbench.core.streams import Streams
from oysterbench.recipe import LifeRecipe, SequenceRecipe
from oysterbench.scene.life import Life, build_life
from oysterbench.scene.path import Path, build_path
from oysterbench.scene.world import World
from tests.helpers.reefs import small_reef, world_of

ALL = LifeRecipe(
    schools=1, school_size=12, school_fish_cm=6.0, fish=3, crabs=3, debris=6, tether=True, sway=1.0, surge_m=0.12
)


def living_reef(life: LifeRecipe = ALL, **reef: Any) -> SequenceRecipe:
    """A reef of 6 x 6 m with seagrass and life, and a loop of 20 s over it."""
    recipe = small_reef({"size_m": 6.0, "plant_cover": 0.08, **reef})
    path = dataclasses.replace(recipe.path, radius_m=1.2, speed_m_s=0.3)
    return dataclasses.replace(recipe, life=life, path=path)


@cache
def living_world(recipe: SequenceRecipe) -> tuple[World, Path, Life | None]:
    """World, path and life of a recipe, always the same."""
    world, streams = world_of(recipe), Streams(4)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    return world, path, build_life(recipe, world, path, streams)
