"""Description of a published system: the system.toml of its folder, and the methods that it provides."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from oysterbench.core.errors import MethodError
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.core.places import home
from oysterbench.methods.code import file_digest
from oysterbench.methods.finding import find_method
from oysterbench.methods.interfaces import interface_of
from oysterbench.methods.options import read_value, split_variant, variant_name
from oysterbench.methods.tuning import OptionRange

ENTRY_POINTS = "oysterbench.systems"
MANIFEST = "system.toml"

Sensor = Literal["mono", "stereo", "imu", "dvl", "sonar", "pressure", "compass", "altimeter"]


@dataclass(frozen=True, kw_only=True)
class SystemMethod:
    """A way to run a system.

    track: the track that it takes part in; form: its input form, as for `ExternalCommand`; deterministic: whether two
    runs on the same sequence give the same result; options: those that differ from the system's defaults; limit_factor:
    factor on the default time limit of a run, used if the user gives no limit

    For the track slam only: sensors: those it uses; online: whether each pose is as known at its time; poses_of: as for
    `ExternalCommand`; align: how its path is aligned if the user does not say, as a system without scale cannot be
    scored unaligned; max_gap_s: longest gap between two of its poses, None for the evaluator's default
    """

    about: str
    deterministic: bool
    track: Literal["slam", "segmentation", "detection"] = "slam"
    form: str = "euroc"
    options: Mapping[str, Any] = field(default_factory=dict)
    limit_factor: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    sensors: tuple[Sensor, ...] = ()
    online: bool | None = None
    poses_of: str = "imu"
    align: str = "posyaw"
    max_gap_s: float | None = None


OF_SLAM = ("sensors", "online", "poses_of", "align", "max_gap_s")


@dataclass(frozen=True, kw_only=True)
class SystemOption(OptionRange):
    """An option of a system. file: whether it is the path of a file, which is then identified by its content, and whose
    default is relative to the home; made_by: what to type to make a missing file."""

    file: bool = False
    made_by: str = ""


@dataclass(frozen=True, kw_only=True)
class Submodule:
    """Another repository that the source needs in its tree; its keys are as in `Description`."""

    source: str
    commit: str
    folders: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Description:
    """Content of a system.toml.

    source: URL of its repository; commit: 40 hexadecimal digits; folders: folders of the repository that are needed,
    all if empty; submodules: path in its tree -> other repository, as in git; packages: Debian packages needed to build
    and run it; python: requirements, for a system that is a Python package; program: file that the build produces;
    renders: whether `prepare` of its configure.py, which ends a build, renders sequences; cpu_minutes, disk_mb: CPU
    time and disk space that building takes
    """

    title: str
    paper: str
    url: str
    licence: str
    program: str
    methods: Mapping[str, SystemMethod]
    source: str = ""
    commit: str = ""
    folders: tuple[str, ...] = ()
    submodules: Mapping[str, Submodule] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    python: tuple[str, ...] = ()
    renders: bool = False
    cpu_minutes: float = 0.0
    disk_mb: float = 0.0
    options: Mapping[str, SystemOption] = field(default_factory=dict)


@dataclass(frozen=True)
class System:
    """A published system. folder: the files that describe, build and configure it; module: that folder as a module."""

    name: str
    folder: Path
    module: str
    description: Description

    @property
    def digest(self) -> str:
        """SHA-256 of what it is built from: other code or another commit makes another build, other options do not."""
        described = self.description
        builds = (described.commit, described.folders, described.submodules, described.python, described.program)
        found = hashlib.sha256(msgspec.json.encode(builds, order="sorted"))
        for path in sorted(self.recipe_files()):
            found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return found.hexdigest()

    def recipe_files(self) -> list[Path]:
        """Files that decide what is built: our own sources and edits, with those that the systems share; empty for a
        system that is a Python package."""
        if not (self.folder / "CMakeLists.txt").exists():
            return []
        places = [self.folder, self.folder.parent / "common"]
        files = [path for place in places for path in place.rglob("*") if path.is_file()]
        return [path for path in files if path.suffix in {".cpp", ".h", ".txt"} or path.name == "edits.toml"]

    @property
    def place(self) -> Path:
        """Folder of its build."""
        return home() / "systems" / f"{self.name}-{self.description.commit[:8] or 'python'}-{self.digest[:8]}"


@cache
def systems() -> Mapping[str, System]:
    """All known systems, by name. Raises MethodError where the description of one is invalid."""
    found = {}
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name):
        spec = find_spec(point.value)
        if spec is None or spec.origin is None:
            raise MethodError(f"system {point.name!r}: its entry point {point.value} is not an installed package")
        found[point.name] = read_system(point.name, Path(spec.origin).parent, point.value)
    return found


def read_system(name: str, folder: Path, module: str = "") -> System:
    """Read the system of a folder. Raises MethodError, with file and key, where its system.toml is invalid."""
    path = folder / MANIFEST
    try:
        description = msgspec.toml.decode(path.read_bytes(), type=Description)
    except (OSError, msgspec.MsgspecError) as error:
        raise MethodError(f"{path}: {error}") from None
    for method, values in description.methods.items():
        for key in values.options.keys() - description.options.keys():
            raise MethodError(f"{path}: methods.{method}.options: the system has no option {key!r}")
        if wrong := _wrong(values):
            raise MethodError(f"{path}: methods.{method}.{wrong}")
    return System(name, folder, module, description)


def _wrong(method: SystemMethod) -> str | None:
    """What in a method's entry does not fit its track, with the key first; None if all of it does."""
    forms = interface_of(method.track).forms
    if method.form not in forms:
        return f"form: expected one of {', '.join(forms)}, as its track is {method.track}, got {method.form!r}"
    given = [one.name for one in fields(method) if getattr(method, one.name) != one.default and one.name in OF_SLAM]
    if method.track == "slam":
        lacking = [key for key in ("sensors", "online") if key not in given]
        return f"{lacking[0]}: missing, as its track is slam" if lacking else None
    return f"{given[0]}: of the track slam; its track is {method.track}" if given else None


def find_system(name: str) -> System:
    """Return the system of that name. Raises MethodError where there is none."""
    known = systems()
    if name not in known:
        meant = did_you_mean(nearest(name, known))
        raise MethodError(f"unknown system {name!r}; {meant}known: {', '.join(known) or 'none'}")
    return known[name]


def split_reference(reference: str) -> tuple[System, str, dict[str, Any]] | None:
    """Split `METHOD[key=value,...]` into system, method and all its options; None if no system has such a method.

    Options that are files have absolute paths, but appear in the method's name by their digest. Raises MethodError for
    an option that the system does not have, an invalid value, or a missing file.
    """
    method, given = split_variant(reference)
    system = next((one for one in systems().values() if method in one.description.methods), None)
    if system is None:
        return None
    known = system.description.options
    values = {key: option.default for key, option in known.items() if option.default is not None}
    values |= system.description.methods[method].options
    for key, text in given.items():
        if key not in known:
            meant = did_you_mean(nearest(key, known))
            raise MethodError(
                f"method {method!r} has no option {key!r}; {meant}its options: {', '.join(known) or 'none'}"
            )
        option = known[key]
        sample = option.default if option.default is not None else next(iter(option.ends), None)
        values[key] = read_value(text, sample, f"option {key!r} of method {method!r}")
        if option.choices and values[key] not in option.choices:
            expected = ", ".join(map(str, option.choices))
            raise MethodError(f"option {key!r} of method {method!r}: expected one of {expected}, got {text}")
    for key in file_options(system, values):
        path = (Path() if key in given else home()) / Path(values[key]).expanduser()
        if not path.is_file():
            advice = f"; type: {known[key].made_by}" if known[key].made_by else ""
            raise MethodError(f"option {key!r} of method {method!r}: no file {path}{advice}")
        values[key] = str(path.absolute())
        if key in given:
            given[key] = file_digest(path)[:8]
    return system, variant_name(method, given), values


def file_options(system: System, values: Mapping[str, Any]) -> list[str]:
    """Keys of the options that are set and name a file."""
    return [key for key, option in system.description.options.items() if option.file and values.get(key)]


def track_of(reference: str) -> str:
    """Return the track of a method, of a published system or any other. Raises MethodError where there is none."""
    found = split_reference(reference)
    if found is None:
        return find_method(reference).track
    system, name, _ = found
    return system.description.methods[name.partition("[")[0]].track
