"""Reading a sequence file: typed iterators over an MCAP file, with no ROS installed; checksums are checked."""

from __future__ import annotations

import io
import json
import os
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.exceptions import InvalidMagic, McapError
from mcap.reader import McapReader, make_reader
from zstandard import ZstdError

from oysterbench.errors import SequenceError
from oysterbench.samples import Image, ImuSample
from oysterbench.sequence import topics
from oysterbench.sequence.topics import Message
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence
from oysterbench.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd

DAMAGE = (McapError, ZstdError, struct.error, EOFError, LookupError, ValueError, ArithmeticError, MemoryError, OSError)
"""What the libraries underneath raise on bytes that are not what they should be."""

METADATA = "oysterbench"
CALIBRATION = "calibration.json"
OYSTERS = "truth/oysters.csv"


class McapSequence(Sequence):
    """A sequence in an MCAP file. The file is opened anew by each iterator, so that several may run at once."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise SequenceError(f"{self.path}: no such file; expected a sequence (.mcap) or an EuRoC folder")
        with Reading(self.path) as reader:
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise SequenceError(_damaged(self.path, "it has no index"))
            records = {record.name: record.metadata for record in reader.iter_metadata()}
            attachments = {item.name: item.data for item in reader.iter_attachments()}
            if METADATA not in records or CALIBRATION not in attachments:
                raise SequenceError(f"{self.path}: an MCAP file, but not a sequence written by oysterbench")
            self.metadata = records[METADATA]
            self.attachments = attachments
            self.statistics = summary.statistics
            self.counts = {
                channel.topic: summary.statistics.channel_message_counts.get(channel.id, 0)
                for channel in summary.channels.values()
            }
            self.types = {
                channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()
            }
            calibration = json.loads(attachments[CALIBRATION])
            self.name = self.metadata["sequence"]
            self.imu_calibration = inertial_calibration(calibration["imu"])
            self.cameras = {name: camera_calibration(entry) for name, entry in calibration["cameras"].items()}

    @property
    def duration_s(self) -> float:
        return (self.statistics.message_end_time - self.statistics.message_start_time) * 1e-9

    def contents(self) -> list[tuple[str, str, int]]:
        return [(topic, self.types[topic], count) for topic, count in self.counts.items()]

    def images(self, camera: str) -> Iterator[Image]:
        self._check_camera(camera)
        for data in self._messages(f"/{camera}/image"):
            stamp, pixels = self._decoded(topics.read_colour, data)
            yield Image(stamp, camera, pixels)

    def layer(self, camera: str, layer: str) -> Iterator[Image]:
        """Images of a layer, such as `depth` (see `Image`): those that the recipe's `layers` name."""
        self._check_camera(camera)
        if f"/{camera}/{layer}" not in self.types or layer not in topics.LAYERS:
            known = [name for name in topics.LAYERS if f"/{camera}/{name}" in self.types]
            raise SequenceError(
                f"{self.path}: {camera} has no layer {layer!r}; its layers: {', '.join(known) or 'none'}; more can be "
                "asked for with the rig's key 'camera.layers'"
            )
        for data in self._messages(f"/{camera}/{layer}"):
            stamp, pixels = self._decoded(topics.read_layer, data, layer)
            yield Image(stamp, camera, pixels)

    def imu(self) -> Iterator[ImuSample]:
        for data in self._messages(topics.IMU):
            yield self._decoded(topics.read_imu, data)

    def truth(self) -> Trajectory:
        truth = self._decoded(topics.read_truth, list(self._messages(topics.TRUTH)))
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

    def _check_camera(self, camera: str) -> None:
        if camera not in self.cameras:
            raise SequenceError(f"{self.path}: no camera {camera!r}; cameras: {', '.join(self.cameras)}")

    def _messages(self, topic: str) -> Iterator[bytes]:
        for message in read_messages(self.path, [topic]):
            yield message.data

    def _decoded(self, read, *arguments):
        try:
            return read(*arguments)
        except DAMAGE as error:
            raise SequenceError(_damaged(self.path, str(error))) from None


class Reading:
    """A file opened with the MCAP reader; whatever is wrong with its bytes becomes one SequenceError."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> McapReader:
        self._file = open(self.path, "rb")
        try:
            return make_reader(self._file, validate_crcs=True)
        except InvalidMagic:
            self._file.close()
            raise SequenceError(
                f"{self.path}: not an MCAP file; expected a sequence (.mcap) or an EuRoC folder; if it was one, delete "
                "it and render or download it again"
            ) from None
        except DAMAGE as error:
            self._file.close()
            raise SequenceError(_damaged(self.path, str(error) or type(error).__name__)) from None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if isinstance(error, DAMAGE) and not isinstance(error, SequenceError):
            raise SequenceError(_damaged(self.path, str(error) or type(error).__name__)) from None


def read_attachments(path: Path) -> dict[str, bytes]:
    """Attachments by name."""
    with Reading(path) as reader:
        return {item.name: item.data for item in reader.iter_attachments()}


def read_messages(path: Path, names: Iterable[str] | None = None) -> Iterator[Message]:
    """Messages of some topics (all by default) in time order, checksums checked; SequenceError on damage."""
    with Reading(path) as reader:
        for _, channel, message in reader.iter_messages(topics=None if names is None else list(names)):
            yield Message(channel.topic, message.log_time, message.data)


def _damaged(path: Path, cause: str) -> str:
    return (
        f"{path}: truncated or damaged ({cause or 'unreadable'}); expected a whole sequence file; "
        "delete it and render or download it again"
    )


def inertial_calibration(entry: dict[str, Any]) -> ImuCalibration:
    """From an entry of calibration.json."""
    values = {key: float(value) for key, value in entry.items() if key != "T_base_imu"}
    return ImuCalibration(T_base_imu=np.array(entry["T_base_imu"]), **values)


def camera_calibration(entry: dict[str, Any]) -> CameraCalibration:
    """From an entry of calibration.json."""
    return CameraCalibration(
        width=int(entry["width"]),
        height=int(entry["height"]),
        rate_hz=float(entry["rate_hz"]),
        matrix=np.array(entry["matrix"]),
        distortion=np.array(entry["distortion"]),
        T_base_cam=np.array(entry["T_base_cam"]),
        distortion_model=str(entry.get("distortion_model", "plumb_bob")),
    )
