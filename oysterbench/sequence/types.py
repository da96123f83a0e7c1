"""Content of a sequence: measurements, calibrations, and the views that methods and evaluators have of it."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import (
    Cloud,
    DvlMeasurement,
    Image,
    ImuMeasurement,
    MagneticMeasurement,
    PressureMeasurement,
    RangeMeasurement,
    ScanPing,
    SonarImage,
)
from oysterbench.core.trajectory import Trajectory
from oysterbench.sensors.altimeter import AltimeterCalibration
from oysterbench.sensors.camera import CameraCalibration
from oysterbench.sensors.dvl import DvlCalibration
from oysterbench.sensors.imu import ImuCalibration
from oysterbench.sensors.magnetometer import MagnetometerCalibration
from oysterbench.sensors.pressure import PressureCalibration
from oysterbench.sensors.registry import AnyKind, calibrated_kinds, sensor_kinds
from oysterbench.sensors.scanner import ScannerCalibration
from oysterbench.sensors.sonar import SonarCalibration
from oysterbench.sensors.uncertainty import Uncertainty
from oysterbench.sequence.truth import TRUTH, TRUTH_TYPES

INERTIAL = ("/imu", "imu0")
"""Names of the inertial measurements in the contents of a sequence file and of an EuRoC folder."""

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "AltimeterCalibration",
    "CameraCalibration",
    "DvlCalibration",
    "ImuCalibration",
    "ImuMeasurement",
    "PressureCalibration",
    "SensorsOnly",
    "Sequence",
    "SonarCalibration",
    "Uncertainty",
    "imu_arrays",
]

LIVE = "live"
"""State of a living oyster in the table of ground truth."""


class Sequence(ABC):
    """Sensors of one run of a vehicle, in time order, and the ground truth if the file holds it.

    Every iterator gives the measurements with `start_ns <= stamp_ns < end_ns`, all by default, and reads no more of a
    file than that. Raises SequenceError where the sequence has no such sensor, or its file is damaged.

    It may be used in a `with` statement but need not: a file is open only while an iterator reads it.

    Examples
    --------
    >>> import oysterbench
    >>> sequence = oysterbench.open("mini-01.mcap")
    >>> list(sequence.cameras), round(sequence.duration_s, 3)
    (['cam_left', 'cam_right'], 1.99)
    >>> pressure = next(sequence.pressure())
    >>> sequence.frame("/dvl/velocity").index.name
    'stamp_ns'
    """

    name: str
    metadata: Mapping[str, str]
    cameras: Mapping[str, CameraCalibration]
    imu_calibration: ImuCalibration
    sonars: Mapping[str, SonarCalibration] = MappingProxyType({})
    scanners: Mapping[str, ScannerCalibration] = MappingProxyType({})
    altimeters: Mapping[str, AltimeterCalibration] = MappingProxyType({})
    dvl_calibration: DvlCalibration | None = None
    pressure_calibration: PressureCalibration | None = None
    magnetometer_calibration: MagnetometerCalibration | None = None
    uncertainty: Uncertainty | None = None
    """Stated errors of the calibrations; None where they state none."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return None  # nothing is open

    def __repr__(self) -> str:
        from oysterbench.sequence.display import outline

        return f"<Sequence {self.name}: {outline(self)}>"

    def _repr_html_(self) -> str:
        from oysterbench.sequence.display import sequence_card

        return sequence_card(self)

    def sensors(self) -> dict[str, AnyKind]:
        """Name of every sensor -> its kind."""
        return {name: kind for kind in calibrated_kinds() for name in self.calibrations(kind)}

    def calibrations(self, kind: AnyKind) -> Mapping[str, Any]:
        """Name of each sensor of a kind -> its calibration."""
        known = getattr(self, kind.attribute, None)
        if kind.single:
            return {} if known is None else {kind.block: known}
        return known or {}

    def calibration(self, name: str) -> Any:
        """Calibration of any sensor, by its name or, if a rig has at most one, its kind."""
        return self.calibrations(self._kind(name))[name]

    def measurements(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Any]:
        """Measurements of any sensor, by its name or, if a rig has at most one, its kind; in time order."""
        return self._by_reader(self._kind(name), name, start_ns, end_ns)

    def _kind(self, name: str) -> AnyKind:
        known = self.sensors()
        if name not in known:
            raise SequenceError(f"{self.name} has no sensor {name!r}; its sensors: {', '.join(known)}")
        return known[name]

    def _by_reader(self, kind: AnyKind, name: str, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        """Read a sensor by the method here for its kind, if there is one, which a subclass may override."""
        if not kind.reader:
            return self._measured(kind.block, name, start_ns, end_ns)
        found: Iterator[Any] = getattr(self, kind.reader)(*(() if kind.single else (name,)), start_ns, end_ns)
        return found

    def _measured(self, block: str, name: str, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        """Measurements of any sensor; to be overridden by subclasses that support every kind."""
        kind = sensor_kinds()[block]
        self._lacks(kind.title if kind.single else f"{kind.title} {name!r}")

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Colour frames of a camera, in time order."""
        return self._measured("camera", camera, start_ns, end_ns)

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        """Inertial measurements, in time order."""
        return self._measured("imu", "imu", start_ns, end_ns)

    def dvl(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[DvlMeasurement]:
        """Measurements of the Doppler velocity log, in time order."""
        return self._measured("dvl", "dvl", start_ns, end_ns)

    def pressure(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[PressureMeasurement]:
        """Measurements of the pressure sensor, in time order."""
        return self._measured("pressure", "pressure", start_ns, end_ns)

    def magnetometer(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[MagneticMeasurement]:
        """Measurements of the magnetometer, in time order."""
        return self._measured("magnetometer", "magnetometer", start_ns, end_ns)

    def ranges(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[RangeMeasurement]:
        """Ranges of an altimeter, in time order."""
        return self._measured("altimeter", name, start_ns, end_ns)

    def sonar(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[SonarImage]:
        """Fan images of an imaging sonar, in time order."""
        return self._measured("sonar", name, start_ns, end_ns)

    def scans(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ScanPing]:
        """Pings of a scanning sonar, in time order."""
        return self._measured("scanner", name, start_ns, end_ns)

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        """Returns of an imaging sonar with elevation, class and instance: ground truth, which no method sees."""
        self._lacks(f"cloud of a sonar {name!r}")

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Images of a ground-truth layer, such as `depth` (see `Image`), in time order."""
        self._lacks(f"layer {layer!r} of a camera {camera!r}")

    def oysters(self) -> pd.DataFrame:
        """Ground truth on the oysters, one row each."""
        self._lacks("truth about oysters")

    def living(self) -> dict[int, bool]:
        """Whether each oyster is alive, by its id; boxes and single valves are dead."""
        table = self.oysters()
        return {int(k): state == LIVE for k, state in zip(table["id"], table["state"], strict=True)}

    def faults(self) -> pd.DataFrame:
        """Sensor faults that occurred, one row each."""
        self._lacks("truth about faults")

    def taken(self) -> pd.DataFrame:
        """How each frame was truly taken by cameras that adapt or repeat frames, one row each."""
        self._lacks("truth about how frames were taken")

    def moving(self) -> pd.DataFrame:
        """Everything that moves by itself, one row each."""
        self._lacks("truth about what moves")

    def moving_poses(self) -> pd.DataFrame:
        """Poses of everything that moves by itself, one row each per stamp."""
        self._lacks("truth about what moves")

    def steering(self) -> pd.DataFrame:
        """Commands that an expert would give at each image, one row each."""
        self._lacks("truth about steering")

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        """Messages of a scalar sensor as a table, indexed by stamp_ns."""
        self._lacks(f"table of {topic}")

    @abstractmethod
    def truth(self) -> Trajectory:
        """True poses T_map_base. Raises SequenceError where there are none."""

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """Time from the first stamp to the last, s."""

    @abstractmethod
    def contents(self) -> list[tuple[str, str, int]]:
        """Name, type and number of messages of each topic."""

    def rates(self) -> dict[str, float | None]:
        """Mean number of messages per second of each topic; None where all were at one instant, or there are none."""
        span_s = self.duration_s
        return {topic: count / span_s if span_s > 0 else None for topic, _, count in self.contents()}

    @property
    def has_truth(self) -> bool:
        """Whether there are true poses, according to the list of contents."""
        return TRUTH in (topic for topic, _, _ in self.contents())

    @property
    def has_imu(self) -> bool:
        """Whether there are inertial measurements, according to the list of contents: a file may have some of its
        split's topics only."""
        return any(topic in INERTIAL and count > 0 for topic, _, count in self.contents())

    def stream(self, *sensors: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Any]:
        """Measurements of the IMU and of `sensors` (all cameras by default), merged in time order.

        A sensor goes by its name or, if a rig has at most one, by its kind, such as `dvl`. At equal stamps, the IMU
        comes first, so that a frame is always preceded by all inertial measurements up to its stamp; the others follow
        in the order in which they were named.
        """
        wanted = [name for name in dict.fromkeys(sensors or tuple(self.cameras)) if name != "imu"]
        sources = [self._tagged(k, self.measurements(name, start_ns, end_ns)) for k, name in enumerate(wanted, start=1)]
        inertial = self._tagged(0, self.imu(start_ns, end_ns))
        return (item for _, _, item in heapq.merge(inertial, *sources, key=lambda row: row[:2]))

    @staticmethod
    def _tagged(rank: int, measured: Iterator[Any]) -> Iterator[tuple[int, int, Any]]:
        return ((item.stamp_ns, rank, item) for item in measured)

    def truly_calibrated(self) -> Sequence:
        """The same sequence with the true calibrations, which fit the ground truth, in place of the given ones, for
        evaluators; the sequence itself where they do not differ.

        The time offset of a camera is then that of its stamps, `clock_offset_ms` of the recipe included, and its
        `taken_ns` is when the image that a frame shows was truly taken: earlier where it repeats one, and without the
        jitter of stamps. A file without its recipe (split.toml and rig.toml) knows neither offset nor jitter of a
        clock. Clocks of other sensors are in no calibration.
        """
        return self

    def for_method(self) -> Sequence:
        """The same sensors without the ground truth: what a method is given."""
        return SensorsOnly(self)

    def _lacks(self, what: str) -> NoReturn:
        raise SequenceError(f"{self.name} has no {what}; `oysterbench info` lists what a sequence has")


class SensorsOnly(Sequence):
    """A sequence whose ground truth cannot be accessed: no poses, layers, oysters or clouds.

    A sonar's cloud is hidden as a whole, not only its classes and instances: an imaging sonar measures no elevation, so
    the third coordinate of its points is ground truth as well.
    """

    def __init__(self, sequence: Sequence) -> None:
        self.name = sequence.name
        for kind in calibrated_kinds():
            if hasattr(sequence, kind.attribute):
                setattr(self, kind.attribute, getattr(sequence, kind.attribute))
        self.uncertainty = sequence.uncertainty
        self.metadata = {"sequence": sequence.name}
        self._duration_s = sequence.duration_s
        self._contents = [row for row in sequence.contents() if is_measured(row[0])]
        rates = sequence.rates()
        self._rates = {topic: rates[topic] for topic, _, _ in self._contents}
        # Only the iterators are kept, in closures, not the sequence: nothing here leads to the truth by name.
        self._iterators: dict[str, Callable[..., Any]] = {
            "read": _closed(sequence._by_reader),
            "frame": _closed(sequence.frame),
        }

    def _measured(self, block: str, name: str, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        found: Iterator[Any] = self._iterators["read"](sensor_kinds()[block], name, start_ns, end_ns)
        return found

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        if topic not in (name for name, _, _ in self._contents):
            self._hidden(f"frame({topic!r})")
        table: pd.DataFrame = self._iterators["frame"](topic, start_ns, end_ns)
        return table

    @property
    def duration_s(self) -> float:
        return self._duration_s

    def contents(self) -> list[tuple[str, str, int]]:
        return list(self._contents)

    def rates(self) -> dict[str, float | None]:
        return dict(self._rates)

    def truth(self) -> Trajectory:
        self._hidden("truth()")

    def truly_calibrated(self) -> Sequence:
        self._hidden("truly_calibrated()")

    def oysters(self) -> pd.DataFrame:
        self._hidden("oysters()")

    def faults(self) -> pd.DataFrame:
        self._hidden("faults()")

    def taken(self) -> pd.DataFrame:
        self._hidden("taken()")

    def moving(self) -> pd.DataFrame:
        self._hidden("moving()")

    def moving_poses(self) -> pd.DataFrame:
        self._hidden("moving_poses()")

    def steering(self) -> pd.DataFrame:
        self._hidden("steering()")

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        self._hidden("clouds()")

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        self._hidden("layer()")

    def _hidden(self, call: str) -> NoReturn:
        raise MethodError(f"methods may not see the ground truth: Sequence.{call} is for evaluators")


def is_measured(topic: str) -> bool:
    """Whether a real vehicle would have a topic: it is neither ground truth, nor a layer, nor a cloud with classes."""
    truth_leaves = {leaf for kind in sensor_kinds().values() for leaf in kind.truth_leaves}
    return not (topic in TRUTH_TYPES or topic.startswith("/truth") or topic.rsplit("/", 1)[-1] in truth_leaves)


def _closed(call: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: call(*arguments)


def imu_arrays(measured: Iterator[ImuMeasurement]) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps (N,) ns, gyro (N, 3) rad/s and accel (N, 3) m/s^2 of all measurements."""
    rows = list(measured)
    return (
        np.array([row.stamp_ns for row in rows], dtype=np.int64),
        np.array([row.gyro for row in rows]).reshape(-1, 3),
        np.array([row.accel for row in rows]).reshape(-1, 3),
    )
