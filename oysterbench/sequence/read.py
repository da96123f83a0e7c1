"""Reading a sequence file: typed iterators over an MCAP file, with no ROS installed; checksums are checked."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import SequenceError
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
from oysterbench.sequence import topics
from oysterbench.sequence.calibration import RigCalibration, camera_calibration, inertial_calibration, rig_calibration
from oysterbench.sequence.file import (
    DAMAGE,
    Attachments,
    Reading,
    damaged,
    read_attachments,
    read_messages,
    read_metadata,
    summary_of,
)
from oysterbench.sequence.types import Sequence

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "CALIBRATION",
    "METADATA",
    "OYSTERS",
    "STEERING",
    "McapSequence",
    "camera_calibration",
    "inertial_calibration",
    "read_attachments",
    "read_messages",
]

METADATA = "oysterbench"
CALIBRATION = "calibration.json"
OYSTERS = "truth/oysters.csv"
STEERING = "truth/steering.csv"


class McapSequence(Sequence):
    """A sequence in an MCAP file. The file is opened anew by each iterator, so that several may run at once."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise SequenceError(f"{self.path}: no such file; expected a sequence (.mcap) or an EuRoC folder")
        with Reading(self.path) as reader:
            summary = summary_of(self.path, reader)
            records = read_metadata(reader)
            self.attachments: Mapping[str, bytes] = Attachments(self.path, summary)
            if METADATA not in records or CALIBRATION not in self.attachments:
                raise SequenceError(f"{self.path}: an MCAP file, but not a sequence written by oysterbench")
            assert summary.statistics is not None
            self.metadata = records[METADATA]
            self.statistics = summary.statistics
            self.counts = {
                channel.topic: summary.statistics.channel_message_counts.get(channel.id, 0)
                for channel in summary.channels.values()
            }
            self.types = {
                channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()
            }
            self.name = self.metadata["sequence"]
            self._calibrate(rig_calibration(json.loads(self.attachments[CALIBRATION])))

    def _calibrate(self, rig: RigCalibration) -> None:
        self.imu_calibration, self.cameras = rig.imu, rig.cameras
        self.sonars, self.scanners, self.altimeters = rig.sonars, rig.scanners, rig.altimeters
        self.dvl_calibration, self.pressure_calibration = rig.dvl, rig.pressure
        self.magnetometer_calibration = rig.magnetometer

    @property
    def duration_s(self) -> float:
        return (self.statistics.message_end_time - self.statistics.message_start_time) * 1e-9

    def contents(self) -> list[tuple[str, str, int]]:
        return [(topic, self.types[topic], count) for topic, count in self.counts.items()]

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        self._check(camera, self.cameras, "camera")
        for (data,) in self._messages((f"/{camera}/image",), start_ns, end_ns):
            stamp, pixels = self._decoded(topics.read_colour, data)
            yield Image(stamp, camera, pixels)

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Images of a layer, such as `depth` (see `Image`): those that the recipe's `layers` name."""
        self._check(camera, self.cameras, "camera")
        if f"/{camera}/{layer}" not in self.types or layer not in topics.LAYERS:
            known = [name for name in topics.LAYERS if f"/{camera}/{name}" in self.types]
            raise SequenceError(
                f"{self.path}: {camera} has no layer {layer!r}; its layers: {', '.join(known) or 'none'}; more can be "
                "asked for with the rig's key 'camera.layers'"
            )
        for (data,) in self._messages((f"/{camera}/{layer}",), start_ns, end_ns):
            stamp, pixels = self._decoded(topics.read_layer, data, layer)
            yield Image(stamp, camera, pixels)

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        return self._samples(topics.read_imu, (topics.IMU,), start_ns, end_ns)

    def dvl(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[DvlMeasurement]:
        if self.dvl_calibration is None:
            self._lacks("DVL")
        names = (topics.DVL_VELOCITY, topics.DVL_BEAMS, topics.DVL_ALTITUDE)
        return self._samples(topics.read_dvl, names, start_ns, end_ns, self.dvl_calibration.beam_directions)

    def pressure(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[PressureMeasurement]:
        if self.pressure_calibration is None:
            self._lacks("pressure sensor")
        return self._samples(topics.read_pressure, (topics.PRESSURE,), start_ns, end_ns)

    def magnetometer(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[MagneticMeasurement]:
        if self.magnetometer_calibration is None:
            self._lacks("magnetometer")
        return self._samples(topics.read_magnetic, (topics.MAGNETOMETER,), start_ns, end_ns)

    def ranges(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[RangeMeasurement]:
        self._check(name, self.altimeters, "altimeter")
        return self._samples(topics.read_range, (f"/{name}/range",), start_ns, end_ns, name)

    def sonar(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[SonarImage]:
        self._check(name, self.sonars, "sonar")
        return self._samples(topics.read_sonar, (f"/{name}/image",), start_ns, end_ns, name)

    def scans(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ScanPing]:
        self._check(name, self.scanners, "scanner")
        return self._samples(topics.read_scan, (f"/{name}/ping", f"/{name}/head"), start_ns, end_ns, name)

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        self._check(name, self.sonars, "sonar")
        if f"/{name}/cloud" not in self.types:
            raise SequenceError(f"{self.path}: {name} sends no cloud; the rig's key 'sonar.cloud' asks for one")
        return self._samples(topics.read_cloud, (f"/{name}/cloud",), start_ns, end_ns, name)

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        """Messages of a scalar sensor as a table: indexed by stamp_ns, a column per number (`sequence.tables`)."""
        from oysterbench.sequence.tables import has_table, table

        if topic not in self.types or not has_table(topic, self.types[topic]):
            scalar = [name for name, kind in self.types.items() if has_table(name, kind)]
            raise SequenceError(
                f"{self.path}: no topic {topic!r} that makes a table; those that do: {', '.join(scalar)}"
            )
        data = (data for (data,) in self._messages((topic,), start_ns, end_ns))
        return self._decoded(table, data, self.types[topic])

    def truth(self) -> Trajectory:
        truth = self._decoded(topics.read_truth, [data for (data,) in self._messages((topics.TRUTH,))])
        if len(truth) == 0:
            raise SequenceError(f"{self.path} has no truth: no message on {topics.TRUTH}")
        return truth

    def oysters(self) -> pd.DataFrame:
        """The truth about each oyster, a row each: id (as in instance images), state, host (the oyster it grows on, or
        0), height_m, length_m, width_m, volume_m3, and the pose of its umbo in `map`: x, y, z (m), qx, qy, qz, qw."""
        if OYSTERS not in self.attachments:
            raise SequenceError(f"{self.path} has no truth about oysters: no attachment {OYSTERS}")
        import pandas as pd

        return self._decoded(pd.read_csv, io.BytesIO(self.attachments[OYSTERS]))

    def steering(self) -> pd.DataFrame:
        """What an expert would command at each picture of the front camera, a row each: stamp_ns; yaw and pitch, the
        numbers of the classes; heading_rad, pitch_rad (bow down positive), depth_m and altitude_m of the vehicle; and
        value_Y_P, the oysters that the expert's best plan would gain if it began with classes Y and P."""
        if STEERING not in self.attachments:
            raise SequenceError(f"{self.path} has no truth about steering: no attachment {STEERING}")
        import pandas as pd

        return self._decoded(pd.read_csv, io.BytesIO(self.attachments[STEERING]))

    def _check(self, name: str, known: Mapping[str, Any], kind: str) -> None:
        if name not in known:
            raise SequenceError(f"{self.path}: no {kind} {name!r}; {kind}s: {', '.join(known) or 'none'}")

    def _samples(
        self,
        read: Callable[..., Any],
        names: tuple[str, ...],
        start_ns: int | None,
        end_ns: int | None,
        *arguments: Any,
    ) -> Iterator[Any]:
        for data in self._messages(names, start_ns, end_ns):
            yield self._decoded(read, *data, *arguments)

    def _messages(
        self, names: tuple[str, ...], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[bytes, ...]]:
        """The data of one message of each topic at a time. Several topics are those of one sensor: they go together."""
        sources = [read_messages(self.path, [name], start_ns, end_ns) for name in names]
        try:
            for messages in zip(*sources, strict=True):
                yield tuple(message.data for message in messages)
        except ValueError as error:  # one topic has more messages than another
            raise SequenceError(damaged(self.path, f"{', '.join(names)}: {error}")) from None

    def _decoded(self, read: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return read(*arguments)
        except DAMAGE as error:
            raise SequenceError(damaged(self.path, str(error))) from None
