"""Point clouds from echoes along a trajectory: ranges of DVL beams and altimeters, and imaging sonar fans."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import SonarImage
from oysterbench.mapping.cloud import PointCloud
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.views import Pinhole, PoseInterpolator, Watch, unwatched
from oysterbench.sequence.types import Sequence, SonarCalibration

UNSEEN = 128  # grey level of points that no camera saw

Echo = tuple[int, Array, Array]
"""Stamp, ns; points (N, 3) m in the sensor frame; pose of the sensor on the vehicle, T_base_sensor (4, 4)."""


def heard_points(
    sequence: Sequence, poses: PoseInterpolator, settings: CloudSettings, watch: Watch = unwatched
) -> Iterator[Array]:
    """Yield points (N, 3) m in the world frame, sample by sample, where the pose is known; none beyond `echo_far_m`."""
    for stamp_ns, points, T_base_sensor in chain(range_echoes(sequence), _pings(sequence, settings)):
        watch(stamp_ns)
        T_world_base = poses.at(stamp_ns)
        points = points[np.linalg.norm(points, axis=1) <= settings.echo_far_m]
        if T_world_base is not None and len(points):
            T = T_world_base @ T_base_sensor
            yield points @ T[:3, :3].T + T[:3, 3]


def range_echoes(sequence: Sequence) -> Iterator[Echo]:
    """Yield the echoes of DVL beams and altimeters, sensor by sensor."""
    if sequence.dvl_calibration is not None:
        for beams in sequence.dvl():
            hits = (beams.beam_directions * beams.beam_ranges[:, None])[beams.beam_valid]
            yield beams.stamp_ns, hits, sequence.dvl_calibration.T_base_sensor
    for name, altimeter in sequence.altimeters.items():
        for echo in sequence.ranges(name):
            if np.isfinite(echo.range):
                yield echo.stamp_ns, np.array([[echo.range, 0.0, 0.0]]), altimeter.T_base_sensor


def _pings(sequence: Sequence, settings: CloudSettings) -> Iterator[Echo]:
    for name, sonar in sequence.sonars.items():
        points_of = _fan(sonar, settings)
        for ping in sequence.sonar(name):
            yield ping.stamp_ns, points_of(ping), sonar.T_base_sensor


def _fan(sonar: SonarCalibration, settings: CloudSettings) -> Callable[[SonarImage], Array]:
    """Return a function of a ping that gives points (N, 3) m in the sonar's frame, on the leading edge of each echo.

    A fan does not measure elevation. Seen from above, the first echo of the bottom comes from the fan's lower edge,
    half of its vertical aperture below its middle; what rises from the bottom is heard earlier, and so lies higher.
    """
    elevation = -sonar.vfov_rad / 2.0
    directions = np.column_stack(
        [
            np.cos(elevation) * np.cos(sonar.azimuths_rad),
            np.cos(elevation) * np.sin(sonar.azimuths_rad),
            np.full(sonar.beams, np.sin(elevation)),
        ]
    )

    def points(ping: SonarImage) -> Array:
        heard = ping.pixels.astype(float)
        heard[sonar.ranges_m < settings.near_m] = 0.0
        strongest = heard.max(axis=0)
        first = np.argmax(heard >= settings.echo_share * strongest, axis=0)
        clear = strongest > settings.min_echo * np.maximum(np.median(heard, axis=0), 1.0)
        return np.asarray(directions[clear] * sonar.ranges_m[first[clear], None])

    return points


def coloured(
    cloud: PointCloud,
    sequence: Sequence,
    cameras: list[str],
    poses: PoseInterpolator,
    settings: CloudSettings,
    watch: Watch = unwatched,
) -> PointCloud:
    """Colour each point from the frame that sees it from the smallest distance; grey where none does.

    Occlusion is ignored: points from echoes are too sparse to hide what lies behind them.
    """
    colours = np.full((len(cloud), 3), UNSEEN, dtype=np.uint8)
    nearest = np.full(len(cloud), settings.far_m)
    for camera in cameras:
        pinhole = Pinhole(camera, sequence.cameras[camera], settings.width_px)
        last_ns = -(2**62)
        for image in sequence.images(camera):
            watch(image.stamp_ns)
            T_world_base = poses.taking(sequence.cameras[camera], image.stamp_ns)
            if T_world_base is None or image.stamp_ns - last_ns < settings.colour_every_s * 1e9:
                continue
            last_ns = image.stamp_ns
            view = pinhole.view(image, T_world_base)
            T_cam_world = invert(view.T_world_cam)
            seen = cloud.points @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
            closer = (seen[:, 2] > settings.near_m) & (seen[:, 2] < nearest)
            rows = np.flatnonzero(closer)
            u, v = _pixels(seen[rows], view.matrix)
            height, width = view.grey.shape
            shown = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            rows = rows[shown]
            colours[rows] = view.colours[v[shown], u[shown]]
            nearest[rows] = seen[rows, 2]
    return PointCloud(cloud.points, colours, cloud.observations)


def _pixels(points: Array, matrix: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Project points (N, 3) in front of the camera to columns and rows (N,)."""
    projected = points @ matrix.T
    columns, rows = np.rint(projected[:, :2] / projected[:, 2:]).astype(np.int64).T
    return columns, rows
