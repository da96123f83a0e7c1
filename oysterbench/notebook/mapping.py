"""Map of the oysters along a path, each counted once, for use in a notebook."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.core.names import did_you_mean, instead, nearest
from oysterbench.core.trajectory import ReadOptions, Trajectory, read_trajectory
from oysterbench.mapping import DEPTHS, MapSettings, OysterMap, Seen, build_map, default_depth, read_seen, true_seen
from oysterbench.mapping.views import check_time, check_upright
from oysterbench.sequence.types import Sequence

Path_ = str | os.PathLike[str]


def oyster_map(
    sequence: Sequence | Path_,
    trajectory: Trajectory | Path_,
    masks: Path_ | None = None,
    *,
    camera: str | None = None,
    depth: str | None = None,
    **options: Any,
) -> OysterMap:
    """Map the oysters in a sequence's images to the ground, and count each once.

    Parameters
    ----------
    sequence : Sequence or path
        Sequence with the images.
    trajectory : Trajectory or path
        Poses of the vehicle (base_link), at any stamps.
    masks : path, optional
        Masks of the oysters in the images: a folder, .npz or COCO file, as read by `oysterbench map --masks`; by
        default the ground truth of a rendered sequence.
    camera : str, optional
        Camera that took the images; the first by default.
    depth : str, optional
        Source of depths: stereo, motion, plane, or layer, which is the ground truth; by default the best that the
        sequence allows without ground truth.
    **options
        Fields of `oysterbench.mapping.MapSettings`, such as ``cell_m=0.5``, and of
        `oysterbench.core.trajectory.ReadOptions`, such as ``quaternion="wxyz"``, for the trajectory's file.

    Returns
    -------
    OysterMap
        ``total``: counts and densities with intervals; ``grid``: oysters per square metre in cells; ``table()``: a row
        for each oyster, m in the world frame of the trajectory.

    Raises
    ------
    oysterbench.core.errors.TrajectoryError
        The poses do not cover the time of the images, or by them the vehicle would not be upright.
    oysterbench.core.errors.LabelError
        The masks are not of this camera's images.
    oysterbench.core.errors.SequenceError
        There is no such camera, or depths cannot be obtained.

    Examples
    --------
    >>> import oysterbench
    >>> sequence = oysterbench.open("mini-01.mcap")
    >>> oysterbench.oyster_map(sequence, sequence.truth(), depth="layer")
    <OysterMap of hand-made: 8 oysters on 2.7 m², 4 live, 4 dead>
    >>> oysterbench.oyster_map(sequence, sequence.truth(), camera="cam_up")
    Traceback (most recent call last):
    ...
    oysterbench.core.errors.SequenceError: hand-made has no camera 'cam_up'; it has cam_left, cam_right
    """
    known, reading = ([field.name for field in fields(of)] for of in (MapSettings, ReadOptions))
    for name in options:
        if name not in (*known, *reading):
            raise OptionError(
                f"no setting {name!r} of a map; {did_you_mean(nearest(name, [*known, *reading]))}it has "
                f"{', '.join(known)}; for reading the trajectory's file, {', '.join(reading)}"
            )
        if name in reading and isinstance(trajectory, Trajectory):
            raise OptionError(
                f"{name}: it says how a file is read, and the trajectory is poses in memory: leave it out"
            )
    chosen = MapSettings(**{name: value for name, value in options.items() if name in known})
    read = ReadOptions(**{name: value for name, value in options.items() if name in reading})
    if depth not in (None, *DEPTHS):
        raise OptionError(f"depth: expected one of {', '.join(DEPTHS)}, got {depth!r}")
    opened = sequence if isinstance(sequence, Sequence) else _opened(sequence)
    poses = trajectory if isinstance(trajectory, Trajectory) else read_trajectory(trajectory, read)
    which = camera or next(iter(opened.cameras), "")
    if which not in opened.cameras:
        there = instead(which, opened.cameras, f"oysterbench info {opened.name}")
        raise SequenceError(f"{opened.name} has no camera {which!r}; {there}")
    check_time(opened, poses)
    check_upright(opened, poses)

    def seen() -> Iterable[Seen]:
        if masks is None:
            return true_seen(opened, which)
        return read_seen(Path(masks), opened, which, "auto", chosen.threshold)

    return build_map(opened, poses, seen, which, depth or default_depth(opened, which), chosen)


def _opened(path: Path_) -> Sequence:
    from oysterbench.sequence import open_sequence

    return open_sequence(path)
