"""Conditions of a sequence, derived from the recipe of its split and stored with every result."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import eq

from oysterbench.recipe import UNDISTURBED, SequenceRecipe, SplitRecipe, draw
from oysterbench.render.spectra import secchi_depth, water_constituents

SECCHI_CLASSES_M = ((1.0, "turbid"), (4.0, "murky"), (float("inf"), "clear"))
"""Upper limits of the Secchi depth, m, of classes of water: survey altitudes are about 1 m, and from about four times
that on the water hardly affects an image."""

DENSITY_CLASSES_PER_M2 = ((1.0, "bare"), (15.0, "sparse"), (float("inf"), "dense"))
"""Upper limits of the density of oysters, per m^2, of classes of reefs; in restoration a reef counts as one from 15 per
m^2 (Oyster Metrics Workgroup 2011, the minimum density for success)."""

DARK = 0.05  # share of full daylight below which lamps are the light
OVERCAST = 0.8  # share of skylight from which the sun casts no noticeable shadow
CALM_WIND_M_S = 1.0  # below it there are no visible caustics
CALM_WAVE_M, CALM_CURRENT_M_S = 0.1, 0.1  # below both the vehicle follows its path undisturbed


def conditions(split: SplitRecipe, sequence: str) -> dict[str, float | str]:
    """Conditions of a sequence of a split, by keys of `evaluate.conditions.CONDITIONS`, with the values that it draws.

    Those that depend on a value that a hidden split draws are left out: only the salt tells what they are.
    """
    recipe = split.find_sequence(sequence)
    if not recipe.drawn:
        return _conditions(split, recipe)
    if not split.hidden:
        drawn = _conditions(split, split.drawn(recipe))
        return {key: round(value, 3) if isinstance(value, float) else value for key, value in drawn.items()}
    place = f"split {split.name}: sequence {sequence}"
    # All values at their lowest, all at their highest, and each alone at its highest.
    shares: list[Callable[[str], float]] = [lambda key: 0.0, lambda key: 1.0]
    shares += [partial(eq, one.key) for one in recipe.drawn]
    lowest, *others = [_conditions(split, draw(recipe, share, place)) for share in shares]
    return {key: value for key, value in lowest.items() if all(other[key] == value for other in others)}


def _conditions(split: SplitRecipe, recipe: SequenceRecipe) -> dict[str, float | str]:
    density = recipe.reef.oyster_count / recipe.reef.size_m**2
    secchi_m = secchi_depth(water_constituents(recipe.water))
    stated: dict[str, float | str] = {} if recipe.difficulty is None else {"difficulty": recipe.difficulty}
    if any(other.disturbance for other in split.sequence):
        stated |= {"disturbance": recipe.disturbance or UNDISTURBED, "strength": recipe.strength}
    if any(other.calibration != "exact" for other in split.sequence):
        stated |= {"calibration": recipe.calibration}
    if any(other.water.layer.factor > 1 for other in split.sequence):
        stated |= {"layer_factor": recipe.water.layer.factor}
    if any(other.water.plumes.attenuation for other in split.sequence):
        stated |= {"silt_per_m": recipe.water.plumes.attenuation}
    return {
        **stated,
        "water": _class_of(secchi_m, SECCHI_CLASSES_M),
        "light": _light(recipe, any(lamp.intensity_cd > 0 for lamp in split.rig_of(recipe).lamp)),
        "density": _class_of(density, DENSITY_CLASSES_PER_M2),
        "motion": f"{recipe.path.kind}, {'calm' if _is_calm(recipe) else 'disturbed'}",
        "water_type": recipe.water.type or recipe.water.jerlov or "",
        "path": recipe.path.kind,
        "secchi_m": round(secchi_m, 3),
        "altitude_m": recipe.path.altitude_m,
        "oysters_per_m2": round(density, 3),
        "speed_m_s": recipe.path.speed_m_s,
        "depth_m": recipe.reef.depth_m,
        "snow_per_m3": recipe.water.snow_per_m3,
        "daylight": recipe.light.daylight,
        "wind_m_s": recipe.light.wind_m_s,
        "wave_height_m": recipe.site.wave_height_m,
        "current_m_s": recipe.site.current_m_s,
        "plant_cover": recipe.reef.plant_cover,
        "duration_s": recipe.duration_s,
    }


def _class_of(value: float, classes: tuple[tuple[float, str], ...]) -> str:
    return next(name for limit, name in classes if value < limit)


def _light(recipe: SequenceRecipe, has_lamps: bool) -> str:
    light = recipe.light
    lamps = has_lamps and light.lamps > 0
    if light.daylight < DARK:
        return "lamps" if lamps else "dark"
    day = "overcast" if light.sky_fraction >= OVERCAST else "sun"
    if day == "sun" and light.wind_m_s >= CALM_WIND_M_S:
        day = "sun with caustics"
    return f"{day} and lamps" if lamps else day


def _is_calm(recipe: SequenceRecipe) -> bool:
    return recipe.site.wave_height_m < CALM_WAVE_M and recipe.site.current_m_s < CALM_CURRENT_M_S
