"""Writing and reading the messages of a sonar's point cloud, which is ground truth."""

from __future__ import annotations

import numpy as np

from oysterbench.core.measurements import Cloud
from oysterbench.core.ros import POINTS, Message, decode, point_rows, points_bytes, stamp_of
from oysterbench.sensors.kind import link

RETURN = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "class", "instance"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "u1", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 20,
    }
)
"""Layout of a sonar's return as a point: position in the sensor's frame (m), intensity, and class and instance."""


def cloud_message(cloud: Cloud) -> Message:
    """Message with a sonar's labelled returns: fields x, y, z, intensity, class, instance."""
    rows = np.zeros(len(cloud.points), dtype=RETURN)
    for axis, values in zip("xyz", np.reshape(cloud.points, (-1, 3)).T, strict=True):
        rows[axis] = values
    rows["intensity"], rows["class"], rows["instance"] = cloud.intensity, cloud.classes, cloud.instances
    return Message(f"/{cloud.sensor}/cloud", cloud.stamp_ns, points_bytes(cloud.stamp_ns, link(cloud.sensor), rows))


def read_cloud(data: bytes, sensor: str) -> Cloud:
    """Read a cloud from its message."""
    message = decode(data, POINTS)
    stamp, rows = stamp_of(message.header), point_rows(message)
    return Cloud(
        stamp_ns=stamp,
        sensor=sensor,
        points=np.stack([rows[axis] for axis in "xyz"], axis=-1).astype(np.float32),
        intensity=rows["intensity"].astype(np.float32),
        classes=rows["class"].astype(np.uint8),
        instances=rows["instance"].astype(np.uint16),
    )
