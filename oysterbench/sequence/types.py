"""What a sequence gives: measurements, calibrations, and the views that a method and an evaluator have of it."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn

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
from oysterbench.sequence.calibration import (
    AltimeterCalibration,
    CameraCalibration,
    DvlCalibration,
    ImuCalibration,
    MagnetometerCalibration,
    PressureCalibration,
    ScannerCalibration,
    SonarCalibration,
)
from oysterbench.sequence.names import LAYERS, TRUTH_TOPICS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CameraCalibration", "ImuCalibration", "Measurement", "SensorsOnly", "Sequence", "imu_arrays"]

Measurement = (
    ImuMeasurement
    | DvlMeasurement
    | PressureMeasurement
    | MagneticMeasurement
    | RangeMeasurement
    | SonarImage
    | ScanPing
    | Image
    | Cloud
)
"""What a stream may hold."""

SINGLE = ("imu", "dvl", "pressure", "magnetometer")
"""Sensors of which a rig has one at most: their kind is their name."""

CALIBRATIONS = ("cameras", "sonars", "scanners", "altimeters", *(f"{kind}_calibration" for kind in SINGLE))


class Sequence(ABC):
    """Sensors of one run of a vehicle, in time order, and the truth if the file holds it.

    Every iterator gives the samples with `start_ns <= stamp_ns < end_ns`, all by default, and reads no more of a file
    than that. SequenceError where the sequence has no such sensor, or its file is damaged.
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

    @abstractmethod
    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Colour frames of a camera, in time order."""

    @abstractmethod
    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        """Inertial samples, in time order."""

    def dvl(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[DvlMeasurement]:
        """Samples of the Doppler velocity log, in time order."""
        self._lacks("DVL")

    def pressure(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[PressureMeasurement]:
        """Samples of the pressure sensor, in time order."""
        self._lacks("pressure sensor")

    def magnetometer(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[MagneticMeasurement]:
        """Samples of the magnetometer, in time order."""
        self._lacks("magnetometer")

    def ranges(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[RangeMeasurement]:
        """Ranges of an altimeter, in time order."""
        self._lacks(f"altimeter {name!r}")

    def sonar(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[SonarImage]:
        """Fan images of an imaging sonar, in time order."""
        self._lacks(f"sonar {name!r}")

    def scans(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ScanPing]:
        """Pings of a scanning sonar, in time order."""
        self._lacks(f"scanner {name!r}")

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        """Returns of an imaging sonar with elevation, class and instance: truth, which no method sees."""
        self._lacks(f"cloud of a sonar {name!r}")

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Images of a layer of truth, such as `depth` (see `Image`), in time order."""
        self._lacks(f"layer {layer!r} of a camera {camera!r}")

    def oysters(self) -> pd.DataFrame:
        """The truth about each oyster, a row each."""
        self._lacks("truth about oysters")

    def steering(self) -> pd.DataFrame:
        """What an expert would command at each picture, a row each."""
        self._lacks("truth about steering")

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        """Messages of a scalar sensor as a table, indexed by stamp_ns."""
        self._lacks(f"table of {topic}")

    @abstractmethod
    def truth(self) -> Trajectory:
        """True poses T_map_base. Raises SequenceError where the file has none."""

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """From the first stamp to the last, s."""

    @abstractmethod
    def contents(self) -> list[tuple[str, str, int]]:
        """Name, type and number of messages of each topic."""

    def stream(self, *sensors: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Any]:
        """Inertial samples and those of `sensors` (all cameras by default), merged in time order.

        A sensor is `dvl`, `pressure` or `magnetometer`, or a camera, sonar, scanner or altimeter by its name. At one
        stamp they come in this order, inertial first, so that a frame is always preceded by all inertial samples up to
        its stamp; of the others as they were named.
        """
        wanted = [name for name in dict.fromkeys(sensors or tuple(self.cameras)) if name != "imu"]
        sources = [self._tagged(k, read(start_ns, end_ns)) for k, read in enumerate(map(self._reader, wanted), start=1)]
        inertial = self._tagged(0, self.imu(start_ns, end_ns))
        return (item for _, _, item in heapq.merge(inertial, *sources, key=lambda row: row[:2]))

    @staticmethod
    def _tagged(rank: int, samples: Iterator[Any]) -> Iterator[tuple[int, int, Any]]:
        return ((sample.stamp_ns, rank, sample) for sample in samples)

    def _reader(self, sensor: str) -> Callable[[int | None, int | None], Iterator[Any]]:
        if sensor in SINGLE:
            return getattr(self, sensor)
        named: list[tuple[Mapping[str, Any], Callable[..., Iterator[Any]]]] = [
            (self.altimeters, self.ranges),
            (self.cameras, self.images),
            (self.sonars, self.sonar),
            (self.scanners, self.scans),
        ]
        for known, read in named:
            if sensor in known:
                return lambda start_ns, end_ns: read(sensor, start_ns, end_ns)
        known_names = [kind for kind in SINGLE if getattr(self, f"{kind}_calibration") is not None]
        known_names += [name for known, _ in named for name in known]
        raise SequenceError(f"{self.name} has no sensor {sensor!r}; its sensors: {', '.join(known_names)}")

    def for_method(self) -> Sequence:
        """The same sensors without the truth: what a method is given."""
        return SensorsOnly(self)

    def _lacks(self, what: str) -> NoReturn:
        raise SequenceError(f"{self.name} has no {what}; `oysterbench info` lists what a sequence has")


class SensorsOnly(Sequence):
    """A sequence whose truth cannot be reached: no poses, layers, oysters, nor clouds.

    A sonar's cloud is hidden as a whole, not only its classes and instances: an imaging sonar measures no elevation, so
    the third coordinate of its points is truth as well.
    """

    def __init__(self, sequence: Sequence) -> None:
        self.name = sequence.name
        for key in CALIBRATIONS:
            setattr(self, key, getattr(sequence, key))
        self.metadata = {"sequence": sequence.name}
        self._duration_s = sequence.duration_s
        self._contents = [row for row in sequence.contents() if is_measured(row[0])]
        # Only the iterators are kept, in closures, not the sequence: nothing here leads to the truth by name.
        self._iterators: dict[str, Callable[..., Any]] = {
            kind: _closed(getattr(sequence, kind))
            for kind in ("images", "imu", "dvl", "pressure", "magnetometer", "ranges", "sonar", "scans", "frame")
        }

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        return self._iterators["images"](camera, start_ns, end_ns)

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        return self._iterators["imu"](start_ns, end_ns)

    def dvl(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[DvlMeasurement]:
        return self._iterators["dvl"](start_ns, end_ns)

    def pressure(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[PressureMeasurement]:
        return self._iterators["pressure"](start_ns, end_ns)

    def magnetometer(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[MagneticMeasurement]:
        return self._iterators["magnetometer"](start_ns, end_ns)

    def ranges(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[RangeMeasurement]:
        return self._iterators["ranges"](name, start_ns, end_ns)

    def sonar(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[SonarImage]:
        return self._iterators["sonar"](name, start_ns, end_ns)

    def scans(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ScanPing]:
        return self._iterators["scans"](name, start_ns, end_ns)

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        if topic not in (name for name, _, _ in self._contents):
            self._hidden(f"frame({topic!r})")
        return self._iterators["frame"](topic, start_ns, end_ns)

    @property
    def duration_s(self) -> float:
        return self._duration_s

    def contents(self) -> list[tuple[str, str, int]]:
        return list(self._contents)

    def truth(self) -> Trajectory:
        self._hidden("truth()")

    def oysters(self) -> pd.DataFrame:
        self._hidden("oysters()")

    def steering(self) -> pd.DataFrame:
        self._hidden("steering()")

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        self._hidden("clouds()")

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        self._hidden("layer()")

    def _hidden(self, call: str) -> NoReturn:
        raise MethodError(f"a method does not see the truth: Sequence.{call} is for evaluators")


def is_measured(topic: str) -> bool:
    """Whether a topic is what a real vehicle would have: neither truth, nor a layer, nor a cloud with classes."""
    last = topic.rsplit("/", 1)[-1]
    return not (topic in TRUTH_TOPICS or topic.startswith("/truth") or last in LAYERS or last == "cloud")


def _closed(call: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: call(*arguments)


def imu_arrays(samples: Iterator[ImuMeasurement]) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps (N,) ns, gyro (N, 3) rad/s and accel (N, 3) m/s^2 of all samples."""
    rows = list(samples)
    return (
        np.array([row.stamp_ns for row in rows], dtype=np.int64),
        np.array([row.gyro for row in rows]).reshape(-1, 3),
        np.array([row.accel for row in rows]).reshape(-1, 3),
    )
