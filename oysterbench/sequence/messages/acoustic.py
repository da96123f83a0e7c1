"""Messages of sonars and altimeters: fan images, pings, clouds, ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.measurements import Cloud, RangeMeasurement, ScanPing, SonarImage
from oysterbench.sequence.messages.points import points_bytes, read_points
from oysterbench.sequence.names import ECHOES, HEAD, RANGE, link
from oysterbench.sequence.wire import Message, decode, encode, header, make, stamp_of

ULTRASOUND = 0
"""sensor_msgs/Range's radiation type; the other one is infrared."""

RETURN = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "class", "instance"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "u1", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 20,
    }
)
"""A sonar's return as a point: place in the sensor's frame (m), amplitude, and what answered."""


def range_message(
    sample: RangeMeasurement, min_range_m: float, max_range_m: float, beam_rad: float, variance: float = 0.0
) -> Message:
    """Range along the altimeter's axis, m, +inf where nothing answers (REP 117); variance in m^2, 0 where unknown."""
    message = make(
        RANGE,
        header=header(sample.stamp_ns, link(sample.sensor)),
        radiation_type=ULTRASOUND,
        field_of_view=beam_rad,
        min_range=min_range_m,
        max_range=max_range_m,
        range=float(sample.range),
        variance=variance,
    )
    return Message(f"/{sample.sensor}/range", sample.stamp_ns, encode(message))


def read_range(data: bytes, sensor: str) -> RangeMeasurement:
    """Range sample from its message, in which the range is a float32."""
    message = decode(data, RANGE)
    return RangeMeasurement(stamp_of(message.header), sensor, float(message.range))


def sonar_message(image: SonarImage) -> Message:
    """A fan's amplitudes as a picture of 16 bits: a row per range bin, near first; a column per beam, left first."""
    data = _echoes(image.stamp_ns, link(image.sensor), image.pixels)
    return Message(f"/{image.sensor}/image", image.stamp_ns, data)


def read_sonar(data: bytes, sensor: str) -> SonarImage:
    """Fan image from its message."""
    stamp, pixels = _read_echoes(data)
    return SonarImage(stamp, sensor, pixels)


def scan_messages(ping: ScanPing) -> list[Message]:
    """A scanning sonar's amplitudes, near first, as a picture of one row; and the angle of its head, rad."""
    head = make(
        HEAD,
        header=header(ping.stamp_ns, link(ping.sensor)),
        name=[f"{ping.sensor}_head"],
        position=np.array([ping.angle], dtype=float),
        velocity=np.array([], dtype=float),
        effort=np.array([], dtype=float),
    )
    return [
        Message(
            f"/{ping.sensor}/ping", ping.stamp_ns, _echoes(ping.stamp_ns, link(ping.sensor), ping.amplitudes[None])
        ),
        Message(f"/{ping.sensor}/head", ping.stamp_ns, encode(head)),
    ]


def read_scan(ping: bytes, head: bytes, sensor: str) -> ScanPing:
    """Ping from its two messages. Raises ValueError where they are not of one stamp."""
    stamp, pixels = _read_echoes(ping)
    joint = decode(head, HEAD)
    if stamp_of(joint.header) != stamp:
        raise ValueError(f"{sensor}'s ping and head at {stamp} are not of one stamp")
    return ScanPing(stamp, sensor, float(joint.position[0]), pixels[0])


def cloud_message(cloud: Cloud) -> Message:
    """A sonar's returns with what they are: fields x, y, z, intensity, class, instance."""
    rows = np.zeros(len(cloud.points), dtype=RETURN)
    for axis, values in zip("xyz", np.reshape(cloud.points, (-1, 3)).T, strict=True):
        rows[axis] = values
    rows["intensity"], rows["class"], rows["instance"] = cloud.intensity, cloud.classes, cloud.instances
    return Message(f"/{cloud.sensor}/cloud", cloud.stamp_ns, points_bytes(cloud.stamp_ns, link(cloud.sensor), rows))


def read_cloud(data: bytes, sensor: str) -> Cloud:
    """Cloud from its message."""
    stamp, rows = read_points(data)
    return Cloud(
        stamp_ns=stamp,
        sensor=sensor,
        points=np.stack([rows[axis] for axis in "xyz"], axis=-1).astype(np.float32),
        intensity=rows["intensity"].astype(np.float32),
        classes=rows["class"].astype(np.uint8),
        instances=rows["instance"].astype(np.uint16),
    )


def _echoes(stamp_ns: int, frame: str, pixels: NDArray[np.uint16]) -> bytes:
    rows = np.ascontiguousarray(pixels, dtype="<u2")
    message = make(
        ECHOES,
        header=header(stamp_ns, frame),
        height=rows.shape[0],
        width=rows.shape[1],
        encoding="mono16",
        is_bigendian=0,
        step=2 * rows.shape[1],
        data=rows.view(np.uint8).ravel(),
    )
    return encode(message)


def _read_echoes(data: bytes) -> tuple[int, NDArray[np.uint16]]:
    message = decode(data, ECHOES)
    if message.encoding != "mono16":
        raise ValueError(f"expected a sonar's picture as mono16, got {message.encoding!r}")
    pixels = np.asarray(message.data).view("<u2").reshape(message.height, message.width)
    return stamp_of(message.header), pixels.astype(np.uint16)
