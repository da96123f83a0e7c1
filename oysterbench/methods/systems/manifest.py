"""What a published system is: the system.toml of its folder, and the methods that it brings."""

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
from oysterbench.core.files import home
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.methods.adapters import file_digest
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

    track: that it answers to; form: what it is given, as of `ExternalCommand`; deterministic: whether two runs on one
    sequence leave the same; options: that differ from the system's; limit_factor: by what the time limit of a run is
    multiplied, where the user gives none

    Of the track slam alone: sensors: that it uses; online: whether a pose is what was known at its time; poses_of: as
    of `ExternalCommand`; align: how it is aligned where the user does not say, as a system without scale cannot be
    scored as it is; max_gap_s: between two poses of it, None for the evaluator's
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
    """An option of a system. file: whether it is the path of a file, by whose content it is then known, and which lies
    under the home where the user names none; made_by: what to type where there is none."""

    file: bool = False
    made_by: str = ""


@dataclass(frozen=True, kw_only=True)
class Submodule:
    """Another repository that the source needs within its tree; its keys as those of `Description`."""

    source: str
    commit: str
    folders: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Description:
    """A system.toml.

    source: address of its repository; commit: of 40 digits; folders: of the repository that are needed, all where
    there are none; submodules: where in its tree others lie, after git's word; packages: Debian's, that building and
    running need; python: requirements, for a system that is a package of Python's; program: what the build leaves;
    cpu_minutes, disk_mb: that building takes
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
    cpu_minutes: float = 0.0
    disk_mb: float = 0.0
    options: Mapping[str, SystemOption] = field(default_factory=dict)


@dataclass(frozen=True)
class System:
    """A published system by its name; folder: with what describes, builds and configures it; module: that folder's."""

    name: str
    folder: Path
    module: str
    description: Description

    @property
    def digest(self) -> str:
        """SHA-256 of what builds it: other code, or another commit, is another build; other options are not."""
        described = self.description
        builds = (described.commit, described.folders, described.submodules, described.python, described.program)
        found = hashlib.sha256(msgspec.json.encode(builds, order="sorted"))
        for path in sorted(self.recipe_files()):
            found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return found.hexdigest()

    def recipe_files(self) -> list[Path]:
        """The files that decide what is built: sources and edits of ours, and those that the systems share; none of a
        system that is a package of Python's."""
        if not (self.folder / "CMakeLists.txt").exists():
            return []
        places = [self.folder, self.folder.parent / "common"]
        files = [path for place in places for path in place.rglob("*") if path.is_file()]
        return [path for path in files if path.suffix in {".cpp", ".h", ".txt"} or path.name == "edits.toml"]

    @property
    def place(self) -> Path:
        """Where it is built."""
        return home() / "systems" / f"{self.name}-{self.description.commit[:8] or 'python'}-{self.digest[:8]}"


@cache
def systems() -> Mapping[str, System]:
    """All that are known here, by name. Raises MethodError where one is described wrongly."""
    found = {}
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name):
        spec = find_spec(point.value)
        if spec is None or spec.origin is None:
            raise MethodError(f"system {point.name!r}: its entry point {point.value} is not an installed package")
        found[point.name] = read_system(point.name, Path(spec.origin).parent, point.value)
    return found


def read_system(name: str, folder: Path, module: str = "") -> System:
    """The system of a folder. Raises MethodError, with file and key, where its system.toml is not one."""
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
    """What of a method is not of its track."""
    forms = interface_of(method.track).forms
    if method.form not in forms:
        return f"form: expected one of {', '.join(forms)}, as its track is {method.track}, got {method.form!r}"
    given = [one.name for one in fields(method) if getattr(method, one.name) != one.default and one.name in OF_SLAM]
    if method.track == "slam":
        lacking = [key for key in ("sensors", "online") if key not in given]
        return f"{lacking[0]}: missing, as its track is slam" if lacking else None
    return f"{given[0]}: of the track slam; its track is {method.track}" if given else None


def find_system(name: str) -> System:
    """The system of that name. Raises MethodError where there is none."""
    known = systems()
    if name not in known:
        meant = did_you_mean(nearest(name, known))
        raise MethodError(f"unknown system {name!r}; {meant}known: {', '.join(known) or 'none'}")
    return known[name]


def split_reference(reference: str) -> tuple[System, str, dict[str, Any]] | None:
    """System, method and all options of `METHOD[key=value,...]`; None where no system has such a method.

    A file among them is named by its whole path, and in the method's name by its digest. Raises MethodError for an
    option that the system has not, a value that is none, or a file that is not there.
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
        sample = option.default if option.default is not None else next(iter(option.choices), None)
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
    """Keys of the options that name a file."""
    return [key for key, option in system.description.options.items() if option.file and values.get(key)]


def track_of(reference: str) -> str:
    """The track of a method, of a published system or any other. Raises MethodError where there is no such method."""
    found = split_reference(reference)
    if found is None:
        return find_method(reference).track
    system, name, _ = found
    return system.description.methods[name.partition("[")[0]].track
