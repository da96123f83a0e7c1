"""What a sequence is made of: its reef, its water and light, and the path over it."""

from __future__ import annotations

from dataclasses import dataclass, field

from oysterbench.recipe.keys import Table, choice, number
from oysterbench.recipe.life import LifeRecipe
from oysterbench.recipe.path import PathRecipe
from oysterbench.recipe.turbidity import LayerRecipe, PatchesRecipe, PlumesRecipe

REEF_CLASSES = {0: "water", 1: "bottom", 2: "oyster", 3: "stone", 4: "plant", 5: "sponge", 6: "vehicle", 7: "hash"}
LIFE_CLASSES = {8: "fish", 9: "crab", 10: "debris", 11: "tether"}
CLASSES = REEF_CLASSES | LIFE_CLASSES
"""What the numbers of a class image mean; hash is broken shell. LIFE_CLASSES are those of `SequenceRecipe.life`."""

UNDISTURBED = "none"
"""The disturbance of a dive that others of its split are held against."""

BOTTOMS = ("sand", "mud", "gravel", "shell")

JERLOV_TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
WATER_TYPES = (*JERLOV_TYPES, "chesapeake-clear", "chesapeake-mid", "chesapeake-turbid", "pure")


@dataclass(frozen=True, kw_only=True)
class ReefRecipe:
    """The bottom and what lies on it, in a square centred on the origin of `map`."""

    size_m: float = number(4, 200)
    depth_m: float = number(0.5, 60)  # mean depth of the bottom
    relief_rms_m: float = number(0, 3)  # of the fractal seabed
    oysters: int | None = number(0, 60_000, None)  # how many, or instead:
    density_per_m2: float | None = number(0, 1_000, None)  # oysters on a square metre, dead ones included
    oyster_size_mm: float = number(25, 170, 85.0)  # median shell height
    clump_size: float = number(1, 30, 7.0)  # mean oysters in a clump
    patchiness: float = number(0, 1, 0.5)  # of the clumps: 0 spreads them evenly, 1 leaves bare ground between patches
    box_share: float = number(0, 1, 0.08)  # of the oysters: dead, both valves still on their hinge
    valve_share: float = number(0, 1, 0.15)  # of the oysters: a single valve, loose on the bottom
    shell_spread: float = number(0, 2, 0.0)  # of shells' proportions and colours beyond one reef's of one age
    stones: int = number(0, 5_000, 0)
    rocks: int = number(0, 500, 0)  # of 0.2 to 0.4 m
    bottom: str = choice(BOTTOMS, "sand")
    silt: float = number(0, 1, 0.5)  # sediment on what faces up
    hash_per_m2: float = number(0, 500, 0.0)  # pieces of broken shell
    plant_cover: float = number(0, 1, 0.0)  # share of the bottom that seagrass or algae grow on
    sponges_per_m2: float = number(0, 50, 0.0)  # on shells and stones
    drape: float = number(0, 1, 0.0)  # share that loose silt, smooth and fluffy, covers of what does not face down
    infill_mm: float = number(0, 80, 0.0)  # depth of loose silt among oysters and stones: buries their feet
    turf: float = number(0, 1, 0.0)  # share of what faces up that a fur of short algae covers, on shells
    fouling: float = number(0, 1, 0.0)  # how much of shells' outsides barnacles, worms' tubes and spat have settled on
    grit: float = number(0, 1, 0.0)  # white specks of shell on everything: at 1 about 2400 on a square metre
    burrows: float = number(0, 1, 0.0)  # mouths of worms' and shrimps' burrows: at 1 about 2400 on a square metre
    algae_per_m2: float = number(0, 500, 0.0)  # bunches of filamentous algae, green and brown, on shells and stones
    litter_per_m2: float = number(0, 200, 0.0)  # dead blades of eelgrass, stalks and threads that lie on everything

    @property
    def oyster_count(self) -> int:
        """How many oysters, from either key."""
        return round((self.density_per_m2 or 0.0) * self.size_m**2) if self.oysters is None else self.oysters


@dataclass(frozen=True, kw_only=True)
class WaterRecipe:
    """The water's type, and what it holds more or less of. Absorption at 440 nm, scattering at 550 nm, both in 1/m."""

    type: str | None = choice(WATER_TYPES, None)  # of Jerlov, of Chesapeake Bay, or pure water to add to; or instead:
    jerlov: str | None = choice(JERLOV_TYPES, None)  # Jerlov's types alone; `type` goes before it
    turbidity: float = number(0, 20, 1.0)  # factor on scattering and absorption of the type's particles
    secchi_m: float | None = number(0.2, 12, None)  # makes all but the water itself so much that a disc vanishes there
    cdom_440: float = number(0, 10, 0.0)  # added absorption of dissolved matter
    nap_440: float = number(0, 20, 0.0)  # added absorption of mineral and dead particles
    algae_440: float = number(0, 10, 0.0)  # added absorption of algae
    scattering_550: float = number(0, 60, 0.0)  # added scattering of particles
    snow_per_m3: float = number(0, 50_000, 0.0)  # marine snow: flakes of 0.4 mm and more
    forward_blur: float = number(0, 1, 0.0)  # share of the light scattered forward that is drawn blurred, not sharp
    layer: LayerRecipe = field(default=LayerRecipe())
    patches: PatchesRecipe = field(default=PatchesRecipe())
    plumes: PlumesRecipe = field(default=PlumesRecipe())


@dataclass(frozen=True, kw_only=True)
class LightRecipe:
    """Sun and sky above the surface."""

    sun_elevation_deg: float = number(5, 90)
    sun_azimuth_deg: float = number(-360, 360)  # direction towards the sun, from east, counter-clockwise
    sky_fraction: float = number(0, 1, 0.3)  # share of the downwelling irradiance that comes from the sky
    daylight: float = number(0, 1, 1.0)  # share of full daylight (100 000 lx) that there is: less for dusk and night
    wind_m_s: float = number(0, 15, 0.0)  # over the surface; its waves gather the sun into caustics, none in a calm
    occlusion_m: float = number(0, 0.5, 0.0)  # reach of rays that find what hides the sky; 0: crevices by height alone
    shade: float = number(0, 1, 0.0)  # share of daylight that soft shades of what floats and stands above take away
    shade_m: float = number(0.05, 20, 0.5)  # how far apart shaded and lit places are
    lamps: float = number(0, 100, 1.0)  # factor on the intensity of the rig's lamps


@dataclass(frozen=True, kw_only=True)
class SiteRecipe:
    """The place and its day: what sound, pressure, compass and hull feel. Directions from east, counter-clockwise."""

    temperature_c: float = number(-2, 40, 20.0)
    salinity_ppt: float = number(0, 45, 15.0)
    ph: float = number(7, 9, 7.8)
    tide_m: float = number(0, 10, 0.0)  # amplitude of the tide about z = 0, as a pressure sensor feels it
    tide_period_h: float = number(0.01, 30, 12.42)
    wave_height_m: float = number(0, 10, 0.0)  # significant
    wave_period_s: float = number(0.5, 30, 5.0)  # of the highest part of the spectrum
    wave_to_deg: float = number(-360, 360, 0.0)  # where the waves go
    current_m_s: float = number(0, 3, 0.0)  # mean
    current_to_deg: float = number(-360, 360, 0.0)  # where the current goes
    field_ut: float = number(20, 70, 50.5)  # strength of the Earth's magnetic field
    inclination_deg: float = number(-90, 90, 65.0)  # its dip below the horizon
    iron: int = number(0, 500, 0)  # pieces of steel on or in the bottom: anchors, rebar, wreckage
    iron_am2: float = number(0.01, 1000, 5.0)
    """Their median magnetic moment, A m^2: 0.1 to 1 a kilogram (Breiner 1973, Applications Manual for Portable
    Magnetometers)."""
    declination_deg: float = number(-180, 180, -10.8)  # of magnetic from true north, east positive


@dataclass(frozen=True, kw_only=True)
class DrawnRecipe:
    """A value that is drawn from a range instead of being stated."""

    key: str  # of a number that the sequence has, such as path.heading_deg
    between: tuple[float, float]


CALIBRATIONS = ("exact", "good", "poor")
"""How well the vehicle was calibrated (`sensors.uncertainty`): not at all wrong, by an expert, or last season."""


@dataclass(frozen=True, kw_only=True)
class SequenceRecipe:
    """One sequence: a reef, its water and light, the path over it, the site that it lies at, and what moves there.

    same_dive_as: the sequence whose reef, path and noise it has, drawn as they are there; what its keys state
    otherwise is the difference. disturbance, strength: what that difference is called, and how strong it is.
    rig: what its split's rig has otherwise here, block by block: `rig = { camera = { shutter_ms = 15.0 } }` holds for
    all of its cameras.
    """

    name: str
    duration_s: float = number(1, 7200)
    difficulty: int | None = number(1, 5, None)  # from calm and clear to all that the sea does, for tables
    same_dive_as: str = ""
    disturbance: str = ""
    strength: int = number(0, 3, 0)
    reef: ReefRecipe
    water: WaterRecipe
    light: LightRecipe
    path: PathRecipe
    site: SiteRecipe = field(default=SiteRecipe())
    life: LifeRecipe = field(default=LifeRecipe())
    rig: Table = field(default=Table())
    calibration: str = choice(CALIBRATIONS, "exact")  # what methods are told of the rig
    drawn: tuple[DrawnRecipe, ...] = ()
