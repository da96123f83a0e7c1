"""Recipes: TOML files that say what a split, a sequence and a rig are, read into validated frozen dataclasses.

Everything that makes the bytes of a sequence is in here; keys carry their unit, angles are in degrees. A bad
value is refused with file, key, value and the allowed range. The fields below are the documentation of the keys.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from oysterbench.errors import RecipeError

CLASSES = {0: "water", 1: "bottom", 2: "oyster", 3: "stone", 4: "plant", 5: "sponge", 6: "vehicle", 7: "hash"}
"""What the numbers of a class image mean; hash is broken shell."""

BOTTOMS = ("sand", "mud", "gravel", "shell")

JERLOV_TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
WATER_TYPES = (*JERLOV_TYPES, "chesapeake-clear", "chesapeake-mid", "chesapeake-turbid", "pure")
PATH_KINDS = ("loop",)
LOOP_RIPPLE = 0.25
"""The radius of a loop varies by this share of its mean."""
TRACKS = ("slam",)
LENSES = {"pinhole": (0,), "brown-conrady": (4, 5), "fisheye": (4,)}
"""How many coefficients of distortion each lens has."""
VEHICLES = ("none", "bluerov2")


def number(low: float, high: float, default: Any = dataclasses.MISSING) -> Any:
    """A numeric key with its allowed range, both ends included."""
    return field(default=default, metadata={"range": (low, high)})


def choice(options: tuple[str, ...], default: Any = dataclasses.MISSING) -> Any:
    """A text key with its allowed values."""
    return field(default=default, metadata={"options": options})


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
    stones: int = number(0, 5_000, 0)
    rocks: int = number(0, 500, 0)  # of 0.2 to 0.4 m
    bottom: str = choice(BOTTOMS, "sand")
    silt: float = number(0, 1, 0.5)  # sediment on what faces up
    hash_per_m2: float = number(0, 500, 0.0)  # pieces of broken shell
    plant_cover: float = number(0, 1, 0.0)  # share of the bottom that seagrass or algae grow on
    sponges_per_m2: float = number(0, 50, 0.0)  # on shells and stones

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


@dataclass(frozen=True, kw_only=True)
class LightRecipe:
    """Sun and sky above the surface."""

    sun_elevation_deg: float = number(5, 90)
    sun_azimuth_deg: float = number(-360, 360)  # direction towards the sun, from east, counter-clockwise
    sky_fraction: float = number(0, 1, 0.3)  # share of the downwelling irradiance that comes from the sky
    daylight: float = number(0, 1, 1.0)  # share of full daylight (100 000 lx) that there is: less for dusk and night
    wind_m_s: float = number(0, 15, 0.0)  # over the surface; its waves gather the sun into caustics, none in a calm
    occlusion_m: float = number(0, 0.5, 0.0)  # reach of rays that find what hides the sky; 0: crevices by height alone
    lamps: float = number(0, 100, 1.0)  # factor on the intensity of the rig's lamps


@dataclass(frozen=True, kw_only=True)
class PathRecipe:
    """How the vehicle moves: from rest along a loop over the reef, with the small motions of a hovering ROV."""

    kind: str = choice(PATH_KINDS)
    radius_m: float = number(0.2, 100)  # mean radius of the loop
    speed_m_s: float = number(0.01, 5)  # along the loop, once the ramp is over
    ramp_s: float = number(0.5, 60, 3.0)  # time from rest to full speed
    altitude_m: float = number(0.2, 20)  # above the smoothed bottom
    sway_m: float = number(0, 0.5, 0.06)  # amplitude of surge, sway and heave about the nominal path
    tilt_deg: float = number(0, 30, 4.0)  # amplitude of roll, pitch and yaw about the nominal attitude
    clearance_m: float = number(0, 10, 0.3)  # least distance kept above oysters and stones


@dataclass(frozen=True, kw_only=True)
class SequenceRecipe:
    """One sequence: a reef, its water and light, and the path over it."""

    name: str
    duration_s: float = number(1, 7200)
    reef: ReefRecipe
    water: WaterRecipe
    light: LightRecipe
    path: PathRecipe


@dataclass(frozen=True, kw_only=True)
class CameraRecipe:
    """A camera on the rig. Pitch is positive below the horizon."""

    name: str
    width: int = number(16, 8192)
    height: int = number(16, 8192)
    hfov_deg: float = number(10, 160)  # in water; of the pinhole, for a lens of brown-conrady before its distortion
    rate_hz: float = number(0.1, 200)
    layer_rate_hz: float = number(0, 200, 0.0)  # of depth, class and instance images; a divisor of rate_hz
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    pitch_deg: float = number(-90, 90, 0.0)
    yaw_deg: float = number(-180, 180, 0.0)
    jpeg_quality: int = number(50, 100, 95)
    max_range_m: float = number(1, 100, 20.0)  # farther than this is water
    lens: str = choice(
        tuple(LENSES), "pinhole"
    )  # brown-conrady: k1 k2 p1 p2 [k3]; fisheye (Kannala-Brandt): k1 k2 k3 k4
    distortion: tuple[float, ...] = number(-10, 10, ())  # coefficients as OpenCV has them
    port_mm: float | None = number(0, 200, None)  # from the pupil to a flat port; then the lens works in air behind it
    vignetting: float = number(0, 1, 0.0)  # share of the natural fall of light with cos^4 of the angle off the axis
    exposure_stops: float = number(-6, 6, 0.0)  # brighter than metered
    gain: float = number(1, 64, 1.0)  # amplification of fewer photons to the same brightness: more noise
    shutter_ms: float = number(0, 200, 0.0)  # time that the shutter is open, for motion blur; 0: an instant
    focus_m: float = number(0.05, 20, 1.0)  # distance at which marine snow is sharp


@dataclass(frozen=True, kw_only=True)
class ImuRecipe:
    """Noise of an inertial unit: continuous white densities, bias random walks, and turn-on biases (1 sigma)."""

    rate_hz: float = number(10, 4000)
    gyro_noise_density: float = number(0, 1)  # rad/s/sqrt(Hz)
    gyro_random_walk: float = number(0, 1)  # rad/s^2/sqrt(Hz)
    gyro_turn_on: float = number(0, 1, 0.0)  # rad/s
    accel_noise_density: float = number(0, 10)  # m/s^2/sqrt(Hz)
    accel_random_walk: float = number(0, 10)  # m/s^3/sqrt(Hz)
    accel_turn_on: float = number(0, 10, 0.0)  # m/s^2
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # imu to base_link


@dataclass(frozen=True, kw_only=True)
class LampRecipe:
    """A lamp on the rig. Pitch is positive below the horizon."""

    intensity_cd: float = number(0, 1e6)  # along its axis
    half_angle_deg: float = number(1, 89, 45.0)  # of the cone, to the middle of its edge
    edge_deg: float = number(0.5, 60, 15.0)  # width of the soft edge
    colour: tuple[float, float, float] = number(0, 2, (1.0, 1.0, 1.0))  # of its light over daylight's
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    pitch_deg: float = number(-90, 90, 0.0)
    yaw_deg: float = number(-180, 180, 0.0)


@dataclass(frozen=True, kw_only=True)
class RigRecipe:
    """A vehicle: its body, its cameras and lamps, and its inertial unit."""

    name: str
    summary: str
    truth_rate_hz: float = number(1, 4000, 200.0)
    imu: ImuRecipe
    camera: tuple[CameraRecipe, ...]
    lamp: tuple[LampRecipe, ...] = ()
    vehicle: str = choice(VEHICLES, "none")  # body that the cameras see and that casts a shadow


@dataclass(frozen=True, kw_only=True)
class SplitRecipe:
    """A split: what the TOML file says, plus the rig that it names."""

    name: str
    version: str
    track: str = choice(TRACKS)
    seed: int = number(0, 2**63 - 1)
    summary: str
    sequence: tuple[SequenceRecipe, ...]
    rig: RigRecipe
    rig_source: str = field(repr=False)  # text of the rig's file
    source: str = field(repr=False)  # text of the split's file

    def find_sequence(self, name: str) -> SequenceRecipe:
        """The sequence of that name."""
        for sequence in self.sequence:
            if sequence.name == name:
                return sequence
        names = ", ".join(sequence.name for sequence in self.sequence)
        raise RecipeError(f"split {self.name} has no sequence {name!r}; it has {names}")

    def digest(self) -> str:
        """SHA-256 over the values of recipe and rig: two recipes with one digest make the same bytes."""
        values = {k: v for k, v in dataclasses.asdict(self).items() if k not in ("source", "rig_source", "summary")}
        return hashlib.sha256(repr(values).encode()).hexdigest()


def count(duration_s: float, rate_hz: float) -> int:
    """Number of samples at times 0, 1 / rate, 2 / rate, ... below the duration."""
    return math.ceil(duration_s * rate_hz - 1e-9)


def split_names() -> list[str]:
    """Names of the splits that come with oysterbench."""
    folder = resources.files("oysterbench_datasets") / "splits"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_split(name_or_path: str) -> SplitRecipe:
    """Read a split by its name, or a TOML file by its path.

    Raises RecipeError naming the file, the key, the value and what is allowed.
    """
    path = Path(name_or_path)
    if name_or_path.endswith(".toml"):
        source = _read_text(path, f"{path}: no such recipe; `oysterbench splits` lists the known splits")
    else:
        known = split_names()
        if name_or_path not in known:
            raise RecipeError(
                f"unknown split {name_or_path!r}; known splits: {', '.join(known)} (or the path of a .toml recipe)"
            )
        path = Path(str(resources.files("oysterbench_datasets") / "splits" / f"{name_or_path}.toml"))
        source = _read_text(path, f"{path}: no such recipe")
    return parse_split(source, str(path))


def parse_split(source: str, where: str, rig_source: str | None = None) -> SplitRecipe:
    """Read a split from the text of its recipe; the rig is found by its name unless its text is given."""
    table = _parse_toml(source, where)
    rig_name = table.pop("rig", None)
    if not isinstance(rig_name, str):
        raise RecipeError(
            f"{where}: key 'rig': expected the name of a file in datasets/rigs, or the path of a .toml file beside the "
            f"recipe, got {rig_name!r}"
        )
    if rig_source is None:
        if rig_name.endswith(".toml"):
            rig_path = Path(where).parent / rig_name
        else:
            rig_path = Path(str(resources.files("oysterbench_datasets") / "rigs" / f"{rig_name}.toml"))
        rig_source = _read_text(rig_path, f"{where}: key 'rig': there is no rig {rig_name!r} ({rig_path} is absent)")
    rig_where = f"rig {rig_name}"
    rig = _build(RigRecipe, _parse_toml(rig_source, rig_where), rig_where, "")
    table = {**table, "rig": rig, "rig_source": rig_source, "source": source}
    split = _build(SplitRecipe, table, where, "")
    _check_split(split, where)
    return split


def vary_split(split: SplitRecipe, changes: Mapping[str, Any], where: str) -> SplitRecipe:
    """The split with one sequence, its first, and with some values replaced, each checked like those of a file.

    Keys of `changes` are those of a sequence (`water.jerlov`) or, behind `camera.`, of the rig's cameras
    (`camera.pitch_deg`).
    """
    sequence, rig = as_plain(split.sequence[0]), as_plain(split.rig)
    for key, value in changes.items():
        first, *rest = key.split(".")
        tables = rig["camera"] if first == "camera" else [sequence]
        path = rest if first == "camera" else [first, *rest]
        for table in tables:
            for parent in path[:-1]:
                if not isinstance(table.get(parent), dict):
                    raise RecipeError(f"{where}: unknown key {key!r}; known keys here: {', '.join(table)}")
                table = table[parent]
            table[path[-1]] = value
    varied = dataclasses.replace(
        split,
        sequence=(_build(SequenceRecipe, sequence, where, ""),),
        rig=_build(RigRecipe, rig, where, ""),
    )
    _check_split(varied, where)
    return varied


def _check_split(split: SplitRecipe, where: str) -> None:
    """What no single key can say."""
    if not split.sequence:
        raise RecipeError(f"{where}: expected at least one [[sequence]], got none")
    names = [sequence.name for sequence in split.sequence]
    if len(set(names)) != len(names):
        raise RecipeError(f"{where}: key 'sequence.name': names must differ, got {names}")
    for name in (split.name, *names):
        if not name or not all(c.isalnum() or c in "-_" for c in name):
            raise RecipeError(f"{where}: key 'name': expected letters, digits, '-' and '_', got {name!r}")
    for camera in split.rig.camera:
        if len(camera.distortion) not in LENSES[camera.lens]:
            wanted = " or ".join(str(n) for n in LENSES[camera.lens])
            raise RecipeError(
                f"{where}: rig {split.rig.name}: key 'camera.distortion': expected {wanted} coefficients for "
                f"lens = {camera.lens!r}, got {list(camera.distortion)}"
            )
        if camera.layer_rate_hz and not (camera.rate_hz / camera.layer_rate_hz).is_integer():
            raise RecipeError(
                f"{where}: rig {split.rig.name}: key 'camera.layer_rate_hz': expected a divisor of rate_hz = "
                f"{camera.rate_hz}, got {camera.layer_rate_hz}"
            )
    for sequence in split.sequence:
        if sequence.water.type is None and sequence.water.jerlov is None:
            raise RecipeError(
                f"{where}: sequence {sequence.name}: missing key 'water.type' (one of {', '.join(WATER_TYPES)})"
            )
        given = [key for key in ("oysters", "density_per_m2") if getattr(sequence.reef, key) is not None]
        if len(given) != 1:
            raise RecipeError(
                f"{where}: sequence {sequence.name}: keys 'reef.oysters', 'reef.density_per_m2': expected exactly one "
                f"of them, got {' and '.join(given) or 'neither'}"
            )
        room = sequence.reef.size_m / 2 / (1 + LOOP_RIPPLE) - 2 * sequence.path.sway_m
        if sequence.path.radius_m > room:
            raise RecipeError(
                f"{where}: sequence {sequence.name}: key 'path.radius_m': the path leaves the reef; expected at most "
                f"{room:.3g} for reef.size_m = {sequence.reef.size_m:g}, "
                f"got {sequence.path.radius_m:g}"
            )
        if sequence.path.altitude_m >= sequence.reef.depth_m:
            raise RecipeError(
                f"{where}: sequence {sequence.name}: key 'path.altitude_m': the vehicle would leave the water; "
                f"expected less than reef.depth_m = {sequence.reef.depth_m:g}, got {sequence.path.altitude_m:g}"
            )


def _read_text(path: Path, absent: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RecipeError(absent) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RecipeError(f"{path}: cannot be read: {error}") from None


def _parse_toml(source: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(source)
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(f"{where}: not valid TOML: {error}") from None


def _build(kind: type, table: Any, where: str, prefix: str) -> Any:
    """Dataclass `kind` from a TOML table, key by key."""
    if not isinstance(table, Mapping):
        raise RecipeError(f"{where}: key {prefix[:-1]!r}: expected a table, got {table!r}")
    hints = typing.get_type_hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for key in table:
        if key not in fields:
            raise RecipeError(
                f"{where}: unknown key {prefix + key!r}; known keys here: {', '.join(_documented(fields))}"
            )
    values = {}
    for name, definition in fields.items():
        if name in table:
            values[name] = _convert(table[name], hints[name], definition, where, prefix + name)
        elif definition.default is dataclasses.MISSING:
            raise RecipeError(f"{where}: missing key {prefix + name!r}{_allowed(definition)}")
    return kind(**values)


def _convert(value: Any, hint: Any, definition: dataclasses.Field[Any], where: str, key: str) -> Any:
    """One value, checked against its type and range."""
    if isinstance(hint, types.UnionType):  # a key that may be left out
        if value is None:
            return None
        hint = next(kind for kind in typing.get_args(hint) if kind is not type(None))
    if dataclasses.is_dataclass(hint):
        kind = typing.cast(type, hint)
        return value if isinstance(value, kind) else _build(kind, value, where, f"{key}.")
    if typing.get_origin(hint) is tuple:
        inner = typing.get_args(hint)
        if not isinstance(value, list):
            raise RecipeError(f"{where}: key {key!r}: expected a list, got {value!r}")
        if len(inner) == 2 and inner[1] is Ellipsis:
            return tuple(_convert(item, inner[0], definition, where, key) for item in value)
        if len(value) != len(inner):
            raise RecipeError(f"{where}: key {key!r}: expected {len(inner)} numbers, got {value!r}")
        return tuple(_convert(v, t, definition, where, key) for v, t in zip(value, inner, strict=True))
    if hint is str:
        options = definition.metadata.get("options")
        if not isinstance(value, str) or (options and value not in options):
            raise RecipeError(f"{where}: key {key!r}: expected {_text(options)}, got {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int if hint is int else (int, float)):
        wanted = "a whole number" if hint is int else "a number"
        raise RecipeError(f"{where}: key {key!r}: expected {wanted}{_allowed(definition)}, got {value!r}")
    low, high = definition.metadata.get("range", (-math.inf, math.inf))
    if not low <= value <= high:
        raise RecipeError(f"{where}: key {key!r}: expected {low:g} to {high:g}, got {value!r}")
    return hint(value)


def _documented(fields: Mapping[str, Any]) -> list[str]:
    return [name for name in fields if name not in ("source", "rig_source")]


def _allowed(definition: dataclasses.Field[Any]) -> str:
    if "range" in definition.metadata:
        low, high = definition.metadata["range"]
        return f" from {low:g} to {high:g}"
    if "options" in definition.metadata:
        return f" ({_text(definition.metadata['options'])})"
    return ""


def _text(options: tuple[str, ...] | None) -> str:
    return "one of " + ", ".join(options) if options else "text"


def as_plain(value: Any) -> Any:
    """A recipe as nested dicts and lists, for JSON; what is not given (None) is left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        values = {f.name: as_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {name: item for name, item in values.items() if item is not None}
    if isinstance(value, tuple | list):
        return [as_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: as_plain(item) for key, item in value.items()}
    return value
