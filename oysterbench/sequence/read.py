"""Reading a sequence file: typed iterators over an MCAP file, with no ROS installed; checksums are checked."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from oysterbench.core.errors import NoTruthError, SequenceError
from oysterbench.core.measurements import Cloud, Image
from oysterbench.core.names import PLAIN, is_plain
from oysterbench.core.ros import decode, stamp_of
from oysterbench.core.text import read_json
from oysterbench.core.trajectory import Trajectory
from oysterbench.recipe.split import rig_tables
from oysterbench.sensors.camera_messages import LAYERS, read_layer
from oysterbench.sensors.clouds import read_cloud
from oysterbench.sensors.faults import COLUMNS
from oysterbench.sensors.kind import Row
from oysterbench.sensors.kind import topic as topic_of
from oysterbench.sensors.registry import read_calibrations, sensor_kinds
from oysterbench.sensors.uncertainty import DIGITS, UNCERTAINTY, Uncertainty
from oysterbench.sequence.file import (
    DAMAGE,
    Attachments,
    Reading,
    damaged,
    read_attachments,
    read_messages,
    read_metadata,
)
from oysterbench.sequence.true_camera import TrueCamera
from oysterbench.sequence.truth import TRUTH, TRUTH_POSE, odometry_row, pose_row, read_truth
from oysterbench.sequence.types import CameraCalibration, Sequence

if TYPE_CHECKING:
    import pandas as pd
    from mcap.summary import Summary

__all__ = [
    "CALIBRATION",
    "FAULTS",
    "METADATA",
    "MOVING",
    "MOVING_POSES",
    "OYSTERS",
    "STEERING",
    "TRUE_CALIBRATION",
    "McapSequence",
    "read_attachments",
    "read_messages",
]

T = TypeVar("T")

METADATA = "oysterbench"
CALIBRATION = "calibration.json"
OYSTERS = "truth/oysters.csv"
STEERING = "truth/steering.csv"
TRUE_CALIBRATION = "truth/calibration.json"
SPLIT_SOURCE, RIG_SOURCE = "split.toml", "rig.toml"
FAULTS = "truth/faults.csv"
FRAMES = "truth/frames.csv"
MOVING = "truth/moving.csv"
MOVING_POSES = "truth/moving_poses.csv"


def _table(data: bytes, name: str, columns: Collection[str], **options: Any) -> pd.DataFrame:
    """Read an attached table. Raises ValueError where it lacks one of the columns; options: of `pandas.read_csv`."""
    import pandas as pd

    found: pd.DataFrame = pd.read_csv(io.BytesIO(data), **options)
    lacking = [column for column in columns if column not in found]
    if lacking:
        raise ValueError(f"{name}: expected the columns {', '.join(columns)}, got none named {', '.join(lacking)}")
    return found


def _oysters(data: bytes) -> pd.DataFrame:
    """Read the table of oysters. Raises ValueError for ids that instance images cannot hold."""
    measures = ("height_m", "length_m", "width_m", "volume_m3", *"xyz", "qx", "qy", "qz", "qw")
    types = {"id": "int64"} | dict.fromkeys(measures, "float64")
    found = _table(data, OYSTERS, ("id", *"xyz"), dtype=types)
    if not found["id"].between(0, np.iinfo(np.uint16).max).all():
        raise ValueError(f"{OYSTERS}: expected numbers of oysters from 0 to {np.iinfo(np.uint16).max}")
    return found


def _spans(summary: Summary) -> dict[str, tuple[int, int]]:
    """Times, ns, of the first and last message of each topic that has any: a chunk holds messages of one topic only."""
    found: dict[str, tuple[int, int]] = {}
    for chunk in summary.chunk_indexes:
        for channel in chunk.message_index_offsets:
            topic = summary.channels[channel].topic
            first, last = found.get(topic, (chunk.message_start_time, chunk.message_end_time))
            found[topic] = (min(first, chunk.message_start_time), max(last, chunk.message_end_time))
    return found


class McapSequence(Sequence):
    """A sequence in an MCAP file. Each iterator opens the file anew, so that several may run at once."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise SequenceError(f"{self.path}: no such file; expected a sequence (.mcap) or an EuRoC folder")
        with Reading(self.path) as (file, summary):
            records = read_metadata(file, summary)
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
            self._spans = _spans(summary)
            self.name = self._plain(self.metadata["sequence"], "the sequence")
            document = read_json(self.attachments[CALIBRATION])
            self._calibrate(document)
            if UNCERTAINTY in document:
                self.uncertainty = Uncertainty.from_entry(document[UNCERTAINTY])

    def _plain(self, name: str, what: str) -> str:
        """Return a name if it is plain: exports name files by it, and must not leave their folder."""
        if not is_plain(name):
            raise SequenceError(
                f"{self.path}: name of {what}: expected {PLAIN}, got {name!r:.80}; oysterbench writes no such name: do "
                "not trust the file"
            )
        return name

    def _calibrate(self, document: Mapping[str, Any]) -> None:
        """Set the calibrations of the sensors that the file has: a smaller file still lists those of the whole rig."""
        for block, found in read_calibrations(document).items():
            kind = sensor_kinds()[block]
            here = {name: known for name, known in found.items() if self._sends(self._plain(name, "a sensor"))}
            if not kind.single:
                setattr(self, kind.attribute, here)
            elif here or kind.required:
                setattr(self, kind.attribute, found[block])

    def _sends(self, sensor: str) -> bool:
        """Whether the file has any topic of a sensor."""
        return any(topic == f"/{sensor}" or topic.startswith(f"/{sensor}/") for topic in self.types)

    def truly_calibrated(self) -> Sequence:
        clocks, shown_ns = self._decoded(self._clocks), self._decoded(self._repeats)
        if TRUE_CALIBRATION not in self.attachments and not shown_ns and not any(map(any, clocks.values())):
            return self
        twin = McapSequence(self.path)
        if TRUE_CALIBRATION in self.attachments:
            twin._calibrate(self._decoded(lambda: read_json(self.attachments[TRUE_CALIBRATION])))
        cameras: dict[str, CameraCalibration] = {}
        for name, camera in twin.cameras.items():
            late_s, jitter_s = clocks.get(name, (0.0, 0.0))
            offset_s = round(camera.time_offset_s + late_s, DIGITS)
            jitter_s = math.hypot(camera.time_jitter_s, jitter_s)
            known = {**vars(camera), "time_offset_s": offset_s, "time_jitter_s": jitter_s}
            cameras[name] = TrueCamera(**known, shown_ns=shown_ns.get(name, {}), even=name in clocks and jitter_s > 0)
        twin.cameras, twin.uncertainty = cameras, None
        return twin

    def _clocks(self) -> dict[str, tuple[float, float]]:
        """Camera -> offset and jitter of its clock by the recipe, s, which are in no calibration; empty without a
        recipe."""
        if not {SPLIT_SOURCE, RIG_SOURCE} <= self.attachments.keys():
            return {}
        rig = rig_tables(self.attachments[SPLIT_SOURCE].decode(), self.attachments[RIG_SOURCE].decode(), self.name)
        keys = ("clock_offset_ms", "clock_jitter_ms")
        found = {camera["name"]: [1e-3 * float(camera.get(key, 0.0)) for key in keys] for camera in rig["camera"]}
        return {name: (offset_s, jitter_s) for name, (offset_s, jitter_s) in found.items()}

    def _repeats(self) -> dict[str, dict[int, int]]:
        """Camera -> stamp of each frame that repeats an image -> stamp of the frame whose image it shows."""
        table = self.taken()
        repeats = table[table["stamp_ns"] != table["shown_ns"]]
        found: dict[str, dict[int, int]] = {}
        for camera, stamp_ns, shown_ns in zip(repeats["camera"], repeats["stamp_ns"], repeats["shown_ns"], strict=True):
            found.setdefault(str(camera), {})[int(stamp_ns)] = int(shown_ns)
        return found

    @property
    def duration_s(self) -> float:
        return (self.statistics.message_end_time - self.statistics.message_start_time) * 1e-9

    def contents(self) -> list[tuple[str, str, int]]:
        return [(topic, self.types[topic], count) for topic, count in self.counts.items()]

    def rates(self) -> dict[str, float | None]:
        """Each over the time from the topic's own first message to its last: clocks of sensors may differ."""
        spans_s = {topic: 1e-9 * (last - first) for topic, (first, last) in self._spans.items()}
        return {
            topic: (count - 1) / spans_s[topic] if count > 1 and spans_s.get(topic, 0.0) > 0 else None
            for topic, count in self.counts.items()
        }

    def _measured(self, block: str, name: str, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        kind = sensor_kinds()[block]
        calibrations = self.calibrations(kind)
        if name not in calibrations:
            if kind.single:
                self._lacks(kind.title)
            self._check(name, calibrations, kind.title)
        names, calibration = kind.read_topics(name), calibrations[name]
        if lacking := [topic for topic in names if topic not in self.types]:
            self._lacks(f"{' and '.join(lacking)}: it has some of the topics only")
        return self._decode_all(lambda *data: kind.decode(name, calibration, *data), names, start_ns, end_ns)

    def layer(self, camera: str, layer: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        """Images of a layer, such as `depth` (see `Image`); the recipe's `layers` names those that there are."""
        self._check(camera, self.cameras, "camera")
        if f"/{camera}/{layer}" not in self.types or layer not in LAYERS:
            known = [name for name in LAYERS if f"/{camera}/{name}" in self.types]
            raise SequenceError(
                f"{self.path}: {camera} has no layer {layer!r}; its layers: {', '.join(known) or 'none'}; the rig's "
                "key 'camera.layers' adds more"
            )
        for (data,) in self._messages((f"/{camera}/{layer}",), start_ns, end_ns):
            stamp, pixels = self._decoded(read_layer, data, layer)
            yield Image(stamp, camera, pixels)

    def clouds(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Cloud]:
        self._check(name, self.sonars, "sonar")
        if f"/{name}/cloud" not in self.types:
            raise SequenceError(f"{self.path}: {name} sends no cloud; the rig's key 'sonar.cloud' asks for one")
        return self._decode_all(lambda data: read_cloud(data, name), (f"/{name}/cloud",), start_ns, end_ns)

    def frame(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> pd.DataFrame:
        """Messages of a scalar sensor as a table: indexed by stamp_ns (int64), one column per number, in SI units."""
        import pandas as pd

        tables = self._tables()
        if topic not in tables:
            raise SequenceError(f"{self.path}: topic {topic!r} makes no table; those that do: {', '.join(tables)}")
        stamps, rows = [], []
        for (data,) in self._messages((topic,), start_ns, end_ns):
            message = self._decoded(decode, data, self.types[topic])
            stamps.append(stamp_of(message.header))
            rows.append(self._decoded(tables[topic], message))
        return pd.DataFrame(rows, index=pd.Index(np.array(stamps, dtype=np.int64), name="stamp_ns"))

    def _tables(self) -> dict[str, Callable[[Any], Row]]:
        """Topic -> function that converts its message to a row, for the topics that can be tables."""
        known = {TRUTH: odometry_row, TRUTH_POSE: lambda message: pose_row(message.pose)}
        for name, kind in self.sensors().items():
            known |= {topic_of(name, leaf): row for leaf, row in kind.tables.items()}
        return {topic: known[topic] for topic in self.types if topic in known}

    def truth(self) -> Trajectory:
        truth = self._decoded(read_truth, [data for (data,) in self._messages((TRUTH,))])
        if len(truth) == 0:
            raise NoTruthError(f"{self.path} has no ground truth: no message on {TRUTH}")
        return truth

    def oysters(self) -> pd.DataFrame:
        """Ground truth on the oysters, one row each: id (as in instance images), state, host (the oyster it grows on,
        or 0), height_m, length_m, width_m, volume_m3, and the pose of its umbo in `map`: x, y, z (m), qx, qy, qz,
        qw."""
        if OYSTERS not in self.attachments:
            raise SequenceError(f"{self.path} has no ground truth about oysters: no attachment {OYSTERS}")
        return self._decoded(_oysters, self.attachments[OYSTERS])

    def living(self) -> dict[int, bool]:
        """Whether each oyster is alive, by its id, as in `Sequence`; empty without ground truth on oysters."""
        return super().living() if OYSTERS in self.attachments else {}

    def faults(self) -> pd.DataFrame:
        """Sensor faults that occurred, one row each: start_ns and end_ns (true times), sensor, fault, and value, the
        largest in magnitude, in the unit that the fault's name gives. No rows where there were none."""
        return self._table_of(FAULTS, COLUMNS)

    def taken(self) -> pd.DataFrame:
        """How each frame was truly taken by cameras that adapt or repeat frames, one row each, lost frames included:
        camera, stamp_ns; shown_ns, the stamp of the frame whose image it shows; exposure_ms, gain, and the white
        balance red, green, blue. No rows where no camera does."""
        return self._table_of(FRAMES, ("camera", "stamp_ns", "shown_ns"))

    def steering(self) -> pd.DataFrame:
        """Commands that an expert would give at each image of the front camera, one row each: stamp_ns; yaw and pitch,
        as class numbers; heading_rad, pitch_rad (bow down positive), depth_m and altitude_m of the vehicle; and
        value_Y_P, the oysters that the expert's best plan would gain if it started with classes Y and P."""
        if STEERING not in self.attachments:
            raise SequenceError(f"{self.path} has no ground truth about steering: no attachment {STEERING}")
        return self._decoded(_table, self.attachments[STEERING], STEERING, ("stamp_ns", "yaw", "pitch"))

    def moving(self) -> pd.DataFrame:
        """Everything that moves by itself, one row each: id (as in instance images), class, kind (species or material),
        group (number of its school), size_m (length; width for crabs, radius for the tether). Empty where nothing
        does."""
        return self._table_of(MOVING, ["id", "class", "kind", "group", "size_m"])

    def moving_poses(self) -> pd.DataFrame:
        """Poses of everything that moves by itself, at the rate of the layers, one row each: stamp_ns, id, and the pose
        of its frame in `map` (x to the nose, z to the back): x, y, z (m), qx, qy, qz, qw; for the tether, of its end at
        the stern. Stamps are true times: that of a layer, which its camera's clock gave, is at
        `truly_calibrated().cameras[NAME].taken_ns(stamp)`."""
        return self._table_of(MOVING_POSES, ["stamp_ns", "id", *"xyz", "qx", "qy", "qz", "qw"])

    def _table_of(self, attachment: str, columns: Collection[str]) -> pd.DataFrame:
        """Read a table of ground truth; empty where the file does not have it."""
        import pandas as pd

        if attachment not in self.attachments:
            return pd.DataFrame(columns=list(columns))
        return self._decoded(_table, self.attachments[attachment], attachment, columns)

    def _check(self, name: str, known: Mapping[str, Any], kind: str) -> None:
        if name not in known:
            raise SequenceError(f"{self.path}: no {kind} {name!r}; {kind}s: {', '.join(known) or 'none'}")

    def _decode_all(
        self, read: Callable[..., Any], names: tuple[str, ...], start_ns: int | None, end_ns: int | None
    ) -> Iterator[Any]:
        before_ns = None
        for data in self._messages(names, start_ns, end_ns):
            found = self._decoded(read, *data)
            # Messages come in the order of the file's times; the stamps that count are those in their headers.
            if before_ns is not None and found.stamp_ns < before_ns:
                cause = f"{names[0]}: expected stamps in time order, got {found.stamp_ns} after {before_ns}"
                raise SequenceError(damaged(self.path, cause))
            before_ns = found.stamp_ns
            yield found

    def _messages(
        self, names: tuple[str, ...], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[bytes, ...]]:
        """Yield the data of one message of each topic at a time. The topics are those of one sensor, in step."""
        sources = [read_messages(self.path, [name], start_ns, end_ns) for name in names]
        try:
            for messages in zip(*sources, strict=True):
                yield tuple(message.data for message in messages)
        except ValueError as error:  # one topic has more messages than another
            raise SequenceError(damaged(self.path, f"{', '.join(names)}: {error}")) from None

    def _decoded(self, read: Callable[..., T], *arguments: Any) -> T:
        try:
            return read(*arguments)
        except DAMAGE as error:
            raise SequenceError(damaged(self.path, str(error))) from None
