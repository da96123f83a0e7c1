"""What a sequence is made of: its reef, its water and light, and the path over it."""

from __future__ import annotations

from dataclasses import dataclass, field

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import Table, choice, number
from oysterbench.recipe.life import LifeRecipe
from oysterbench.recipe.path import PathRecipe
from oysterbench.recipe.turbidity import LayerRecipe, PatchesRecipe, PlumesRecipe

REEF_CLASSES = {0: "water", 1: "bottom", 2: "oyster", 3: "stone", 4: "plant", 5: "sponge", 6: "vehicle", 7: "hash"}
LIFE_CLASSES = {8: "fish", 9: "crab", 10: "debris", 11: "tether"}
CLASSES = REEF_CLASSES | LIFE_CLASSES
"""Meaning of the numbers in a class image; hash is broken shell. LIFE_CLASSES are those of `SequenceRecipe.life`."""

OYSTER = next(number for number, name in CLASSES.items() if name == "oyster")
"""Number of the class oyster."""

UNDISTURBED = "none"
"""Disturbance of a dive with which others of its split are compared."""

BOTTOMS = ("sand", "mud", "gravel", "shell")

JERLOV_TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
WATER_TYPES = (*JERLOV_TYPES, "chesapeake-clear", "chesapeake-mid", "chesapeake-turbid", "pure")


@dataclass(frozen=True, kw_only=True)
class ReefRecipe:
    """The bottom and what lies on it, in a square centred on the origin of `map`."""

    size_m: float = number(4, 200)  # side of the square
    depth_m: float = number(0.5, 60)  # mean depth of the bottom
    relief_rms_m: float = number(0, 3)  # RMS height of the fractal seabed
    oysters: int | None = number(0, 60_000, None)  # number of oysters; alternatively, give density_per_m2
    density_per_m2: float | None = number(0, 1_000, None)  # oysters per square metre, dead ones included
    oyster_size_mm: float = number(25, 170, 85.0)  # median shell height, before heights are limited to 25 to 172 mm
    clump_size: float = number(1, 30, 7.0)  # mean number of oysters in a clump
    patchiness: float = number(0, 1, 0.5)  # 0 spreads the clumps evenly, 1 leaves bare ground between patches of them
    box_share: float = number(0, 1, 0.08)  # share of oysters that are boxes: dead, with both valves on the hinge
    valve_share: float = number(0, 1, 0.15)  # share of oysters that are single valves lying loose on the bottom
    shell_spread: float = number(0, 2, 0.0)
    """Extra variation of shell proportions and colours, beyond those of one reef of one age."""
    stones: int = number(0, 5_000, 0)  # number of small stones
    rocks: int = number(0, 500, 0)  # number of rocks of 0.2 to 0.4 m
    bottom: str = choice(BOTTOMS, "sand")  # material of the seabed
    silt: float = number(0, 1, 0.5)  # sediment on surfaces that face up
    hash_per_m2: float = number(0, 500, 0.0)  # pieces of broken shell per square metre
    plant_cover: float = number(0, 1, 0.0)  # share of the bottom on which seagrass or algae grow
    sponges_per_m2: float = number(0, 50, 0.0)  # sponges per square metre, on shells and stones
    drape: float = number(0, 1, 0.0)  # share of all surfaces not facing down that loose, fluffy silt covers
    infill_mm: float = number(0, 80, 0.0)  # depth of loose silt between oysters and stones, which buries their feet
    turf: float = number(0, 1, 0.0)  # share of upward-facing shell that a fur of short algae covers
    fouling: float = number(0, 1, 0.0)  # how densely barnacles, worm tubes and spat cover the outside of shells
    grit: float = number(0, 1, 0.0)  # white specks of shell on everything; 1: about 2400 per square metre
    burrows: float = number(0, 1, 0.0)  # mouths of worm and shrimp burrows; 1: about 2400 per square metre
    algae_per_m2: float = number(0, 500, 0.0)
    """Bunches of filamentous algae, green and brown, per square metre, on shells and stones."""
    litter_per_m2: float = number(0, 200, 0.0)
    """Dead eelgrass blades, stalks and threads per square metre, lying on everything."""

    @property
    def oyster_count(self) -> int:
        """Number of oysters, from either key."""
        return round((self.density_per_m2 or 0.0) * self.size_m**2) if self.oysters is None else self.oysters


@dataclass(frozen=True, kw_only=True)
class WaterRecipe:
    """Type of the water, and changes to its constituents. Absorption at 440 nm, scattering at 550 nm, both in 1/m."""

    type: str | None = choice(WATER_TYPES, None)
    """One of Jerlov's types, Chesapeake Bay, or pure water to which the keys below add; alternatively, give jerlov."""
    jerlov: str | None = choice(JERLOV_TYPES, None)  # Jerlov's types only; instead of `type`
    turbidity: float = number(0, 20, 1.0)  # factor on scattering and absorption by the particles of the type
    secchi_m: float | None = number(0.2, 12, None)
    """Scales everything but the water itself to give this Secchi depth, by 1.45 / Kd, which hardly depends on
    scattering: far from the type's own Secchi depth, the visibility along a line of sight, 4.8 / c, is another."""
    cdom_440: float = number(0, 10, 0.0)  # absorption by dissolved matter, added
    nap_440: float = number(0, 20, 0.0)  # absorption by mineral and dead particles, added
    algae_440: float = number(0, 10, 0.0)  # absorption by algae, added
    scattering_550: float = number(0, 60, 0.0)  # scattering by particles, added
    snow_per_m3: float = number(0, 50_000, 0.0)  # flakes of marine snow of 0.4 mm and more, per cubic metre
    forward_blur: float = number(0, 1, 0.0)  # share of forward-scattered light that is blurred instead of staying sharp
    layer: LayerRecipe = field(default=LayerRecipe())  # a turbid layer over the bottom
    patches: PatchesRecipe = field(default=PatchesRecipe())  # clouds of clearer and more turbid water
    plumes: PlumesRecipe = field(default=PlumesRecipe())  # silt stirred up from the bottom

    def check(self, where: str) -> None:
        """Check what no single key can express. Raises RecipeError, which starts with `where`."""
        if self.type is None and self.jerlov is None:
            raise RecipeError(f"{where}: missing key 'water.type' (one of {', '.join(WATER_TYPES)})")
        if None not in (self.type, self.jerlov) and self.type != self.jerlov:
            raise RecipeError(
                f"{where}: keys 'water.type', 'water.jerlov': expected one of them, got {self.type!r} and "
                f"{self.jerlov!r}"
            )
        added = self.cdom_440 + self.nap_440 + self.algae_440 + self.scattering_550
        if self.secchi_m is not None and self.type == "pure" and not added:
            raise RecipeError(
                f"{where}: key 'water.secchi_m': pure water has nothing to scale; expected cdom_440, nap_440, "
                f"algae_440 or scattering_550 beside it, or another type, got {self.secchi_m:g}"
            )


@dataclass(frozen=True, kw_only=True)
class LightRecipe:
    """Sun and sky above the surface."""

    sun_elevation_deg: float = number(5, 90)  # above the horizon
    sun_azimuth_deg: float = number(-360, 360)  # direction towards the sun, counter-clockwise from east
    sky_fraction: float = number(0, 1, 0.3)  # share of the downwelling irradiance that comes from the sky
    daylight: float = number(0, 1, 1.0)  # share of full daylight (100 000 lx): less at dusk and at night
    wind_m_s: float = number(0, 15, 0.0)  # its waves focus sunlight into caustics; 0: calm, no caustics
    occlusion_m: float = number(0, 0.5, 0.0)
    """Length of the rays that test which part of the sky is hidden; 0: crevices darken by height only."""
    shade: float = number(0, 1, 0.0)
    """Share of daylight taken away by soft shadows of things floating or standing above."""
    shade_m: float = number(0.05, 20, 0.5)  # typical distance between shaded and lit places
    lamps: float = number(0, 100, 1.0)  # factor on the intensity of the rig's lamps


@dataclass(frozen=True, kw_only=True)
class SiteRecipe:
    """The site and its day, as they affect sound, pressure, compass, hull. Directions from east, counter-clockwise."""

    temperature_c: float = number(-2, 40, 20.0)  # of the water
    salinity_ppt: float = number(0, 45, 15.0)  # determines, with temperature and depth, the speed of sound
    ph: float = number(7, 9, 7.8)  # determines, with the two above, the absorption of sound
    tide_m: float = number(0, 10, 0.0)  # amplitude of the tide about z = 0, as measured by a pressure sensor
    tide_period_h: float = number(0.01, 30, 12.42)  # 12.42: the lunar tide, twice a day
    wave_height_m: float = number(0, 10, 0.0)  # significant wave height
    wave_period_s: float = number(0.5, 30, 5.0)  # period at the peak of the spectrum
    wave_to_deg: float = number(-360, 360, 0.0)  # direction in which the waves travel
    current_m_s: float = number(0, 3, 0.0)  # mean speed of the current
    current_to_deg: float = number(-360, 360, 0.0)  # direction in which the current flows
    field_ut: float = number(20, 70, 50.5)  # strength of the Earth's magnetic field
    inclination_deg: float = number(-90, 90, 65.0)  # dip of the field below the horizon
    iron: int = number(0, 500, 0)  # number of pieces of steel on or in the bottom: anchors, rebar, wreckage
    iron_am2: float = number(0.01, 1000, 5.0)
    """Median magnetic moment of a piece, in A m^2: 0.1 to 1 per kilogram (Breiner 1973, Applications Manual for
    Portable Magnetometers)."""
    declination_deg: float = number(-180, 180, -10.8)  # of magnetic north from true north, east positive


@dataclass(frozen=True, kw_only=True)
class DrawnRecipe:
    """A value that is drawn from a range instead of being stated."""

    key: str  # a numeric key of the sequence, such as path.heading_deg; all but duration_s
    between: tuple[float, float]  # lowest and highest value


CALIBRATIONS = ("exact", "good", "poor")
"""Quality of the calibration (`sensors.uncertainty`): without error, by an expert, or from last season."""


@dataclass(frozen=True, kw_only=True)
class SequenceRecipe:
    """One sequence: a reef, its water and light, the path over it, its site, and what moves there.

    same_dive_as: the sequence whose random draws (reef, path and noise) it shares; the two differ only where their keys
    do. disturbance, strength: name of that difference, and how strong it is.
    rig: changes to the split's rig in this sequence, block by block: `rig = { camera = { shutter_ms = 15.0 } }` applies
    to all of its cameras.
    """

    name: str  # name of the file, and in every result
    duration_s: float = number(1, 7200)  # length of the recording
    difficulty: int | None = number(1, 5, None)  # 1: calm and clear, to 5: everything the sea does; shown in tables
    same_dive_as: str = ""  # name of the sequence whose reef, path and noise this one shares
    disturbance: str = ""  # name of what differs from that dive
    strength: int = number(0, 3, 0)  # how strong that is; 0: the undisturbed dive
    reef: ReefRecipe  # the bottom
    water: WaterRecipe  # optics of the water
    light: LightRecipe  # sun, sky and lamps
    path: PathRecipe  # motion of the vehicle
    site: SiteRecipe = field(default=SiteRecipe())  # waves, current, sound, magnetism
    life: LifeRecipe = field(default=LifeRecipe())  # what moves by itself
    rig: Table = field(default=Table())  # what differs from the split's rig
    calibration: str = choice(CALIBRATIONS, "exact")
    """How well the calibration given to methods matches poses, lenses and noise of the rig; even if exact, it knows no
    clock offsets, biases, scale errors or iron."""
    drawn: tuple[DrawnRecipe, ...] = ()  # values that are drawn at random
