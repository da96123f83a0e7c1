"""Life that cannot be is refused, with its key, its value and what is expected."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import LifeRecipe, parse_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT


def split_with(life: str, reef: str = "", site: str = ""):
    text = TINY_SPLIT.replace("stones = 5\n", f"stones = 5\n{reef}\n")
    return parse_split(f"{text}\n[sequence.site]\n{site}\n[sequence.life]\n{life}\n", "life.toml", TINY_RIG)


def test_life_is_read():
    life = split_with("schools = 2\nfish = 3\ntether = true").sequence[0].life
    assert (life.schools, life.fish, life.tether, life.moves) == (2, 3, True, True)
    assert not LifeRecipe().moves


@pytest.mark.parametrize(
    ("life", "words"),
    [
        ("schools = 1\nschool_size = 51", "life.school_size': expected 2 to 50, got 51"),
        ("schools = 1\nschool_size = 50\nschool_fish_cm = 25.0", "life.school_size': 50 fish of 25 cm make a school"),
        ("fish = 1\nfish_speed_m_s = 2.0", "life.fish_speed_m_s': expected 0.05 to 1, got 2"),
        ("sway = 0.5", "life.sway': no plants to sway; expected reef.plant_cover above 0"),
        ("whales = 1", "unknown key 'sequence.life.whales'"),
    ],
)
def test_what_cannot_be_is_refused(life, words):
    with pytest.raises(RecipeError, match=f"life.toml.*{words}"):
        split_with(life)


def test_fish_that_are_higher_than_the_water_is_deep_are_refused():
    shallow = TINY_SPLIT.replace("depth_m = 3.0", "depth_m = 0.5").replace("altitude_m = 0.9", "altitude_m = 0.3")
    life = "\n[sequence.life]\nschools = 1\nschool_fish_cm = 20.0\n"
    with pytest.raises(RecipeError, match=r"'life.school_fish_cm': fish that stand .* reef.depth_m = 0.5"):
        parse_split(shallow + life, "a.toml", TINY_RIG)


def test_swell_and_waves_are_not_both_stated():
    with pytest.raises(RecipeError, match=r"'life.surge_m': the site states waves"):
        split_with("surge_m = 0.1\nsway = 1.0", "plant_cover = 0.1", "wave_height_m = 0.3")
    with pytest.raises(RecipeError, match=r"'life.sway': nothing moves the plants"):
        split_with("sway = 1.0", "plant_cover = 0.1")
