"""A sequence and a trajectory in, a coloured cloud out."""

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

SOURCES = ("pictures", "echoes")
"""What a cloud is made of: depths between pictures at known poses, or ranges of DVL, altimeters and imaging sonars."""


def build_cloud(
    sequence: Sequence,
    trajectory: Trajectory,
    source: str = "pictures",
    cameras: Several[str] = (),
    settings: CloudSettings | None = None,
    watch: Watch = unwatched,
) -> PointCloud:
    """The cloud, in the world frame of the trajectory, whose poses are those of base_link at any stamps.

    cameras: that are looked through; the first one by default, and its partner where the two see the same. watch: told
    of each picture or echo that was looked at, sensor by sensor. Only measurements are used, as a method sees them.
    SequenceError where there is nothing to make a cloud of, TrajectoryError where the trajectory is of another time
    than the sequence.
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
    if source == "pictures":
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
