"""Building a coloured point cloud from a sequence and a trajectory."""

from __future__ import annotations

from collections.abc import Sequence as Several

import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory import Trajectory
from oysterbench.mapping.cloud import PointCloud, thinned, without_outliers
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.echoes import UNSEEN, coloured, heard_points
from oysterbench.mapping.pictures import seen_points
from oysterbench.mapping.views import PoseInterpolator, Watch, check_time, unwatched
from oysterbench.sequence.types import Sequence

SOURCES = ("images", "echoes")
"""Sources of a cloud: depth from images at known poses, or ranges of DVL, altimeters and imaging sonars."""


def build_cloud(
    sequence: Sequence,
    trajectory: Trajectory,
    source: str = "images",
    cameras: Several[str] = (),
    settings: CloudSettings | None = None,
    watch: Watch = unwatched,
) -> PointCloud:
    """Build the cloud in the world frame of the trajectory, which has poses of base_link at any stamps.

    cameras: the cameras to use; by default the first one, with its stereo partner if the two overlap. watch: called
    with the stamp of each image or echo that was processed, sensor by sensor. Only measurements that a method may see
    are used. Raises SequenceError where there is nothing to make a cloud from, TrajectoryError where the trajectory
    does not overlap with the sequence in time.
    """
    settings = settings or CloudSettings()
    sequence = sequence.for_method()
    chosen = list(dict.fromkeys(cameras)) or list(sequence.cameras)[:1]
    for name in chosen:
        if name not in sequence.cameras:
            raise SequenceError(
                f"{sequence.name} has no camera {name!r}; its cameras: {', '.join(sequence.cameras) or 'none'}"
            )
    poses = PoseInterpolator(trajectory, settings.max_gap_s)
    check_time(sequence, trajectory)
    if source == "images":
        if not chosen:
            raise SequenceError(f"{sequence.name} has no camera to make a cloud from; use its echoes: --from")
        parts = (part for name in chosen for part in seen_points(sequence, name, poses, settings, watch))
        return without_outliers(thinned(parts, settings.voxel_m), settings)
    if source != "echoes":
        raise SequenceError(f"source of a cloud: expected one of {', '.join(SOURCES)}, got {source!r}")
    if not (sequence.dvl_calibration or sequence.altimeters or sequence.sonars):
        raise SequenceError(f"{sequence.name} has neither DVL, altimeter nor imaging sonar: there are no echoes")
    heard = heard_points(sequence, poses, settings, watch)
    cloud = thinned(((points, np.full(points.shape, UNSEEN, dtype=np.uint8)) for points in heard), settings.voxel_m)
    return coloured(without_outliers(cloud, settings), sequence, chosen, poses, settings, watch)
