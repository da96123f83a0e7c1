"""Keys of water that varies: what cannot be is refused before anything is rendered."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import load_split, vary_split

MINI = load_split("slam-mini")


def vary(**changes):
    return vary_split(MINI, {key.replace("__", "."): value for key, value in changes.items()}, "mini.toml").sequence[0]


def test_water_is_even_unless_a_recipe_says_otherwise() -> None:
    water = MINI.sequence[0].water
    assert (water.layer.factor, water.patches.contrast, water.plumes.attenuation) == (1.0, 0.0, 0.0)


def test_the_tables_of_water_are_read() -> None:
    sequence = vary(
        water__layer={"factor": 2.5, "thickness_m": 0.4},
        water__plumes={"attenuation": 8.0},
        reef__bottom="mud",
    )
    assert sequence.water.layer.factor == 2.5
    assert sequence.water.plumes.size_m == 0.6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"water__layer__factor": 9.0}, r"key 'water.layer.factor': expected 1 to 5, got 9"),
        (
            {"water__plumes__attenuation": 8.0, "reef__bottom": "gravel", "reef__silt": 0.1},
            r"'water.plumes.attenuation': there is nothing to raise; .* got 8 over gravel with silt = 0.1",
        ),
        (
            {"water__plumes__attenuation": 8.0, "water__plumes__bursts_per_100m2_min": 3.0, "reef__bottom": "mud"},
            r"'water.plumes.bursts_per_100m2_min': still water raises no silt",
        ),
        (
            {"water__plumes__attenuation": 8.0, "reef__bottom": "mud", "path__altitude_m": 2.5},
            r"thrusters reach no bottom from there; expected 0, bursts, or an altitude of at most 1.5, got 8 at 2.5",
        ),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        vary(**changes)
