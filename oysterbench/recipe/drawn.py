"""Values of a recipe that are drawn at random: a key, and the range that its value comes from.

In a hidden split the draw depends on the salt, as everything random does, so that the recipe reveals a range but not
the path that the vehicle took.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import Table, as_plain, build
from oysterbench.recipe.scene import SequenceRecipe


def draw(recipe: SequenceRecipe, share: Callable[[str], float], where: str) -> SequenceRecipe:
    """Return the sequence with its drawn values filled in. `share(key)`, in [0, 1], is the position of a value in its
    range.

    Raises RecipeError, which starts with `where`, for a key that is not a number of a sequence, for the duration, which
    every file shows and which decides how much is rendered, and for a value that the key does not allow.
    """
    if not recipe.drawn:
        return recipe
    keys = [drawn.key for drawn in recipe.drawn]
    if again := next((key for key in keys if keys.count(key) > 1), None):
        raise RecipeError(f"{where}: key 'drawn': expected one range for each key, got several for {again!r}")
    table = as_plain(dataclasses.replace(recipe, drawn=(), rig=Table()))  # a rig is public: nothing of it is drawn
    for drawn in recipe.drawn:
        if drawn.key == "duration_s":
            raise RecipeError(
                f"{where}: key 'drawn': expected keys other than 'duration_s', which the files show anyway; state the "
                "duration as a number"
            )
        low, high = drawn.between
        place: Any = table
        *parents, name = drawn.key.split(".")
        for parent in parents:
            place = place.get(parent) if isinstance(place, dict) else None
        known = place if isinstance(place, dict) else {}
        old = known.get(name)
        if isinstance(old, bool) or not isinstance(old, int | float) or low > high:
            raise RecipeError(
                f"{where}: key 'drawn': expected the key of a number that the sequence states, such as "
                f"'path.speed_m_s', and two values in order, got {drawn.key!r} between {list(drawn.between)}"
            )
        value = low + (high - low) * share(drawn.key)
        known[name] = round(value) if isinstance(old, int) else value
    return dataclasses.replace(build(SequenceRecipe, table, where, ""), rig=recipe.rig)
