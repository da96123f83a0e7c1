"""Inhomogeneous water: a turbid layer over the bottom, patches, and plumes of silt."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import number

SILTY = 0.3  # reef.silt from which any bottom has enough of it for a plume
WASH_REACH_M = 1.5  # greatest altitude at which a thrust of 10 N erodes fresh mud, 0.05 Pa (scene.plumes.bed_stress)


@dataclass(frozen=True, kw_only=True)
class LayerRecipe:
    """A bottom nepheloid layer: more of the water's own particles, increasing exponentially towards the mean bottom.

    This is the balance of settling and uniform turbulence (Rouse 1937 with a constant diffusivity).
    """

    factor: float = number(1, 5, 1.0)  # factor on the particles at the bottom; 2 to 3 is common in the lowest 0.5 m
    thickness_m: float = number(0.05, 20, 0.5)  # height over which the excess falls to 1/e


@dataclass(frozen=True, kw_only=True)
class PatchesRecipe:
    """Clouds of more and fewer particles, vertically uniform, that drift with the current.

    In estuaries, optical transects vary by 10 to 60 % over metres to tens of metres.
    """

    contrast: float = number(0, 0.8, 0.0)  # greatest share by which the number of particles varies
    size_m: float = number(0.5, 50, 4.0)  # typical size of a patch


@dataclass(frozen=True, kw_only=True)
class PlumesRecipe:
    """Plumes of silt, raised by the vehicle's thrusters close to soft bottom, and in bursts by current and animals."""

    attenuation: float = number(0, 20, 0.0)
    """Attenuation c added at the centre of a dense fresh plume, 1/m; 2 to 20 is observed."""
    size_m: float = number(0.3, 1.5, 0.6)  # diameter of a fresh plume (4 standard deviations)
    settling_mm_s: float = number(0.1, 1, 0.4)  # settling speed of silt (Stokes: grains of 10 to 35 um)
    diffusivity_m2_s: float = number(1e-5, 1e-2, 3e-4)  # Okubo 1971 at 1 to 3 m: 2e-4 to 7e-4
    critical_pa: float = number(0.05, 2, 0.2)
    """Stress at which the bottom erodes: fresh mud 0.05 to 0.2, consolidated up to 2."""
    bursts_per_100m2_min: float = number(0, 30, 0.0)
    """Bursts raised by current, waves and animals, per 100 m^2 and minute."""


def check_plumes(
    plumes: PlumesRecipe, bottom: str, silt: float, moving_water: bool, altitude_m: float, where: str
) -> None:
    """Refuse impossible plumes. moving_water: whether the site has current or waves. Raises RecipeError, which starts
    with `where`."""
    if not plumes.attenuation:
        return
    if bottom != "mud" and silt < SILTY:
        raise RecipeError(
            f"{where}: key 'water.plumes.attenuation': there is nothing to raise; expected 0, or reef.bottom = "
            f"'mud', or reef.silt of at least {SILTY:g}, got {plumes.attenuation:g} over {bottom} with silt = {silt:g}"
        )
    if plumes.bursts_per_100m2_min and not moving_water:
        raise RecipeError(
            f"{where}: key 'water.plumes.bursts_per_100m2_min': still water raises no silt; expected 0, or a "
            f"site.current_m_s or site.wave_height_m above 0, got {plumes.bursts_per_100m2_min:g}"
        )
    if not plumes.bursts_per_100m2_min and altitude_m > WASH_REACH_M:
        raise RecipeError(
            f"{where}: key 'water.plumes.attenuation': thrusters reach no bottom from there; expected 0, bursts, or an "
            f"altitude of at most {WASH_REACH_M:g}, got {plumes.attenuation:g} at {altitude_m:g}"
        )
