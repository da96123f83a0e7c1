"""Sensor kinds: one descriptor per kind, defined by its file in this package, over which everything else loops.

A module of `oysterbench.sensors` that defines `KIND` adds a kind: rigs accept its block, the simulation measures with
it, sequences read it, and tables, exports and the viewer show it. Nothing here may import `scene` or `render` at its
top: reading a sequence needs neither.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.core.geometry import Array, is_rigid
from oysterbench.core.ros import Message
from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe, SiteRecipe
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.faults import Fault
from oysterbench.sensors.uncertainty import ErrorModel, Quality, RigCalibration, mount_errors, moved

if TYPE_CHECKING:
    from oysterbench.render.camera import CameraRenderer
    from oysterbench.render.rays import RayCaster
    from oysterbench.scene.path import Path
    from oysterbench.scene.plumes import Plumes
    from oysterbench.sensors.panels import Panel

R = TypeVar("R", bound=SensorRecipe)
C = TypeVar("C")
M = TypeVar("M")
T = TypeVar("T")

XYZ = ("x", "y", "z")

Row = dict[str, float]
"""Numbers of a message by column, in SI units."""


@dataclass(frozen=True)
class Export:
    """A third-party format that a sensor kind can be exported to.

    summary: one line that describes it. write(sequence, name, folder, truth): fills a folder with a sensor's
    measurements, with or without ground truth, and returns lines that tell the user about it.
    """

    summary: str
    write: Callable[[Any, str, File, bool], list[str]]


class SensedWorld(Protocol):
    """The world in which sensors measure: a sequence that is being simulated."""

    @property
    def recipe(self) -> SequenceRecipe: ...
    @property
    def path(self) -> Path: ...
    @property
    def streams(self) -> Streams: ...
    @property
    def caster(self) -> RayCaster: ...
    @property
    def renderers(self) -> Mapping[str, CameraRenderer]: ...
    @property
    def calibration(self) -> RigCalibration: ...
    @property
    def plumes(self) -> Plumes | None: ...

    def bodies(self, times_s: Array) -> list[Array]:
        """Poses T_map_base (4, 4) at times (N,) s."""

    def instrument(self, recipe: SensorRecipe, build: Callable[[], T]) -> T:
        """Return what `build` makes for a sensor, built only once."""


@dataclass(frozen=True)
class Instants:
    """When a sensor measures. times_s (N,): from the start; stamps_ns (N,) int64: by its own clock; wanted (K,) int64:
    indices of the instants whose measurements are requested."""

    times_s: Array
    stamps_ns: NDArray[np.int64]
    wanted: NDArray[np.int64]


@dataclass(frozen=True)
class Strip:
    """Columns of a topic's table that share a plot: its title, and the factor to the unit shown."""

    topic: str
    title: str
    columns: tuple[str, ...]
    factor: float = 1.0


class SensorKind(ABC, Generic[R, C, M]):
    """A kind of sensor: its recipe R, its calibration C, and its measurements M.

    title: its name in messages to users. rank: position of its topics in a file, small ones first. leaves,
    truth_leaves: message types of its topics by what follows the sensor's name, `/NAME/LEAF` (or `/NAME` where that is
    empty): those that a real vehicle would have, and those that only a simulation knows. read_leaves: those that make
    up a measurement (by default all of `leaves`). tables: by leaf, what turns a message into a row. reader: the method
    of `Sequence` that yields its measurements, if it has one besides `Sequence.measurements`. pose: the key of its pose
    in base_link in its calibration. required: every rig has an entry in calibration.json. bulky: each measurement is a
    job of its own. exports: formats that it can be exported to, by name.
    """

    recipe: ClassVar[type[Any]]
    calibration: ClassVar[type[Any]]
    title: ClassVar[str]
    rank: ClassVar[int]
    leaves: ClassVar[Mapping[str, str]]
    truth_leaves: ClassVar[Mapping[str, str]] = {}
    read_leaves: ClassVar[tuple[str, ...]] = ()
    tables: ClassVar[Mapping[str, Callable[[Any], Row]]] = {}
    reader: ClassVar[str] = ""
    pose: ClassVar[str] = "T_base_sensor"
    required: ClassVar[bool] = False
    bulky: ClassVar[bool] = False
    exports: ClassVar[Mapping[str, Export]] = {}

    @property
    def block(self) -> str:
        """Name of its table in a rig's file."""
        return str(self.recipe.block)

    @property
    def single(self) -> bool:
        """Whether a rig has at most one; its block is then its name."""
        return bool(self.recipe.single)

    @property
    def key(self) -> str:
        """Key in calibration.json; where a rig can have several, their calibrations are stored there by name."""
        return self.block if self.single else f"{self.block}s"

    @property
    def attribute(self) -> str:
        """Attribute of `Sequence` that holds the calibration, or the calibrations by name."""
        return f"{self.block}_calibration" if self.single else f"{self.block}s"

    def name_of(self, recipe: R) -> str:
        """Name of a sensor."""
        return self.block if self.single else str(getattr(recipe, "name"))  # noqa: B009

    def frame(self, name: str) -> str:
        """Name of the frame of a sensor's measurements: x along its axis, y left, z up."""
        return link(name)

    def topics(self, recipe: R) -> dict[str, str]:
        """Topic -> message type of everything that a sensor sends."""
        return {topic(self.name_of(recipe), leaf): kind for leaf, kind in self.leaves.items()}

    def read_topics(self, name: str) -> tuple[str, ...]:
        """Topics that contribute one message each to a measurement."""
        return tuple(topic(name, leaf) for leaf in self.read_leaves or self.leaves)

    def fill_in(self, table: Any) -> Any:
        """Return the sensor's table in a rig's file, with the keys that its other keys imply filled in."""
        return table

    @abstractmethod
    def calibrate(self, recipe: R, site: SiteRecipe) -> dict[str, Any]:
        """Result of a perfect calibration, as an entry of calibration.json."""

    def true_calibration(self, recipe: R, site: SiteRecipe) -> dict[str, Any]:
        """True calibration, where even a perfect calibration finds only a model of it."""
        return self.calibrate(recipe, site)

    def error_model(self, recipe: R, entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
        """Error model of a calibration of the given quality; entry: the result of a perfect one."""
        return ErrorModel.of(mount_errors(quality.mount_deg, quality.mount_m))

    def as_given(
        self, recipe: R, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        """Return the entry as found by a calibration with these errors (of the parameters of `error_model`)."""
        return {**entry, self.pose: moved(np.array(entry[self.pose]), errors).tolist()}

    def as_true(
        self, recipe: R, entry: Mapping[str, Any], errors: Mapping[str, float], quality: Quality
    ) -> dict[str, Any]:
        """Return the true entry, with the errors that are in the readings themselves."""
        return dict(entry)

    def true_entry(self, world: SensedWorld, recipe: R) -> Mapping[str, Any]:
        """True entry of this sensor in the rig's calibration."""
        entries = world.calibration.true[self.key]
        found: Mapping[str, Any] = entries if self.single else entries[self.name_of(recipe)]
        return found

    def read_calibration(self, entry: Mapping[str, Any]) -> C:
        """Read a calibration from its entry. Raises LookupError, TypeError or ValueError where that is malformed: its
        numbers must be finite, and its pose a rigid transform."""
        found: C = from_entry(self.calibration, entry)
        if not is_rigid(getattr(found, self.pose)):
            raise ValueError(f"{self.pose}: expected a rigid transform (4, 4), got {str(entry[self.pose])[:60]}")
        return found

    def times(self, world: SensedWorld, recipe: R) -> Array | None:
        """Times (N,) s from the start at which it measures; None: evenly, at its rate, as bulky ones always do."""
        return None

    @abstractmethod
    def measure(self, world: SensedWorld, recipe: R, at: Instants) -> Iterator[M]:
        """Yield the measurements at the wanted instants of a sensor."""

    def faults(self, world: SensedWorld, recipe: R) -> list[Fault]:
        """Faults that struck a sensor, for the ground truth."""
        return []

    @abstractmethod
    def encode(self, recipe: R, measurement: M) -> list[Message]:
        """Encode a measurement as messages."""

    def pass_on(self, recipe: R, name: str, messages: Iterator[Message]) -> Iterator[Message]:
        """Pass on all messages of a topic, in order, as they reach the file: for links in which each depends on the
        earlier ones."""
        return messages

    @abstractmethod
    def decode(self, name: str, calibration: C, *data: bytes) -> M:
        """Decode a measurement from one message of each of `read_topics`. Raises ValueError where they do not match."""

    def panels(self, sequence: Any, name: str) -> list[Panel]:
        """Image panels for the viewer."""
        return []

    def strips(self, name: str) -> list[Strip]:
        """Plots over time for the viewer."""
        return []


def topic(name: str, leaf: str) -> str:
    """Name of a sensor's topic."""
    return f"/{name}/{leaf}" if leaf else f"/{name}"


def link(name: str) -> str:
    """Name of the frame of a sensor other than a camera."""
    return f"{name}_link"


def quantise(values: ArrayLike, step: float) -> Array:
    """Round values to a step far above the last bits, in which the arithmetic of two processors may differ.

    The same recipe thus gives the same bytes on any machine.
    """
    return np.asarray(np.rint(np.asarray(values) / step) * step + 0.0)  # and no negative zeros


def columns_of(prefix: str, value: Any, axes: Iterable[str] = XYZ) -> Row:
    """Row with the components of a message's vector, in columns named prefix + axis."""
    return {f"{prefix}{axis}": getattr(value, axis) for axis in axes}


def from_entry(kind: type[T], entry: Mapping[str, Any]) -> T:
    """Build a calibration from its entry in calibration.json; keys that it does not know are ignored. Raises
    LookupError, TypeError or ValueError where a key is missing or its value is of another type or not finite."""
    values: dict[str, Any] = {}
    for name, annotation in kind.__annotations__.items():
        if name not in entry and hasattr(kind, name):
            continue
        value = values[name] = _CONVERSIONS[annotation](entry[name])
        if isinstance(value, float | np.ndarray) and not np.isfinite(value).all():
            raise ValueError(f"{name}: expected finite numbers, got {str(entry[name])[:60]}")
    return kind(**values)


_CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "Array": lambda value: np.array(value, dtype=float),
    "Array | None": lambda value: np.array(value, dtype=float),
    "int": int,
    "float": float,
    "float | None": float,
    "str": str,
}
