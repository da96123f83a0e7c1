"""What moves by itself: plants in the surge, fish, crabs, drifting debris, the tether; and checks of their keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import number

if TYPE_CHECKING:
    from oysterbench.recipe.scene import SequenceRecipe

SCHOOL_SPACING = 1.2
"""Distance between neighbours in a school, in lengths of a fish: each has about a cube of its length (Pitcher &
Partridge 1979, 0.7 to 2 cubed lengths in saithe and herring)."""

SCHOOL_SHAPE = (1.5, 1.0, 0.6)
"""Half axes of a school along its course, across and up, in units of their geometric mean (Partridge et al. 1980)."""

SCHOOL_SHARE = 1 / 3  # greatest length of a school, as a share of the reef's side

FISH_CLEARANCE_M = 0.1  # least water over the highest fish and under the lowest


@dataclass(frozen=True, kw_only=True)
class LifeRecipe:
    """What moves by itself. The vehicle meets each school, fish, crab and piece of debris at least once: they are
    placed near its path, at times spread over the dive.

    Sizes and speeds of groups: ranges from SLAM practice in estuaries, for silversides (Menidia menidia 7 to 12 cm),
    young croaker and perch (10 to 25 cm).
    """

    schools: int = number(0, 20, 0)  # number of schools of fish
    school_size: int = number(2, 50, 20)  # fish in each school
    school_fish_cm: float = number(2, 25, 8.0)  # median length of a fish in a school
    school_speed_m_s: float = number(0.05, 1.0, 0.25)  # speed at which a school swims
    fish: int = number(0, 50, 0)  # number of solitary fish
    fish_cm: float = number(2, 25, 16.0)  # median length of a solitary fish
    fish_speed_m_s: float = number(0.05, 1.0, 0.15)  # speed at which a solitary fish swims
    crabs: int = number(0, 100, 0)  # number of blue crabs, 5 to 14 cm across, walking at up to 0.2 m/s with rests
    debris: int = number(0, 200, 0)  # number of leaves, blades of grass and strips of film drifting with the current
    tether: bool = False  # a cable from the stern to the surface, trailing behind with slack
    tether_slack_m: float = number(0, 3, 1.0)  # how far the slack hangs out to the side of the vehicle
    sway: float = number(0, 1, 0.0)
    """Share of the water's motion that the tips of blades follow; 1: limp (Luhar & Nepf 2016)."""
    surge_m: float = number(0, 0.3, 0.0)  # amplitude at the bottom of a distant swell, where the site has no waves
    surge_period_s: float = number(3, 8, 5.0)  # period of that swell

    @property
    def moves(self) -> bool:
        """Whether anything but plants moves by itself."""
        return bool(self.schools or self.fish or self.crabs or self.debris or self.tether)

    def school_half_axes_m(self) -> tuple[float, float, float]:
        """Half axes of a school along its course, across and up, m."""
        radius = 0.5 * SCHOOL_SPACING * self.school_fish_cm * 1e-2 * self.school_size ** (1 / 3)
        mean = math.prod(SCHOOL_SHAPE) ** (1 / 3)
        along, across, up = (radius * axis / mean for axis in SCHOOL_SHAPE)
        return along, across, up


def check_life(sequence: SequenceRecipe, where: str) -> None:
    """Check what no single key of life can express. Raises RecipeError, which starts with `where`."""
    life, reef, site = sequence.life, sequence.reef, sequence.site
    if life.schools:
        along, _, up = life.school_half_axes_m()
        if 2 * along > SCHOOL_SHARE * reef.size_m:
            raise RecipeError(
                f"{where}: key 'life.school_size': {life.school_size} fish of {life.school_fish_cm:g} cm make a school "
                f"of {2 * along:.2g} m; expected one of at most a third of reef.size_m = {reef.size_m:g}"
            )
        _check_depth("school_fish_cm", life.school_fish_cm, 2 * up, reef.depth_m, where)
    if life.fish:
        _check_depth("fish_cm", life.fish_cm, 0.5 * life.fish_cm * 1e-2, reef.depth_m, where)
    if life.surge_m and site.wave_height_m:
        raise RecipeError(
            f"{where}: key 'life.surge_m': the site states waves, which move the plants; expected 0 where "
            f"site.wave_height_m = {site.wave_height_m:g}, got {life.surge_m:g}"
        )
    if life.sway and not reef.plant_cover:
        raise RecipeError(f"{where}: key 'life.sway': no plants to sway; expected reef.plant_cover above 0, got 0")
    if life.sway and not (life.surge_m or site.wave_height_m):
        raise RecipeError(
            f"{where}: key 'life.sway': nothing moves the plants; expected site.wave_height_m or life.surge_m above 0"
        )


def _check_depth(key: str, value: float, height: float, depth: float, where: str) -> None:
    if height + 2 * FISH_CLEARANCE_M > 0.8 * depth:
        raise RecipeError(
            f"{where}: key 'life.{key}': fish that stand {height:.2g} m high do not fit into reef.depth_m = {depth:g}; "
            f"expected smaller or fewer ones, got {value:g}"
        )
