"""Map of the oysters along a path, each counted once, for use in a notebook."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.core.names import did_you_mean, instead, nearest
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.mapping import DEPTHS, MapSettings, OysterMap, Seen, build_map, default_depth, read_seen, true_seen
from oysterbench.sequence.types import Sequence

Path_ = str | os.PathLike[str]


def oyster_map(
    sequence: Sequence | Path_,
    trajectory: Trajectory | Path_,
    masks: Path_ | None = None,
    *,
    camera: str | None = None,
    depth: str | None = None,
    **settings: Any,
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
    **settings
        Fields of `oysterbench.mapping.MapSettings`, such as ``cell_m=0.5``.

    Returns
    -------
    OysterMap
        ``total``: counts and densities with intervals; ``grid``: oysters per square metre in cells; ``table()``: a row
        for each oyster, m in the world frame of the trajectory.

    Raises
    ------
    oysterbench.core.errors.TrajectoryError
        The poses do not cover the time of the images.
    oysterbench.core.errors.LabelError
        The masks are not of this camera's images, or none has an oyster.
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
    known = [field.name for field in fields(MapSettings)]
    for name in settings:
        if name not in known:
            raise OptionError(
                f"no setting {name!r} of a map; {did_you_mean(nearest(name, known))}it has {', '.join(known)}"
            )
    chosen = MapSettings(**settings)
    if depth not in (None, *DEPTHS):
        raise OptionError(f"depth: expected one of {', '.join(DEPTHS)}, got {depth!r}")
    opened = sequence if isinstance(sequence, Sequence) else _opened(sequence)
    poses = trajectory if isinstance(trajectory, Trajectory) else read_trajectory(trajectory)
    which = camera or next(iter(opened.cameras), "")
    if which not in opened.cameras:
        there = instead(which, opened.cameras, f"oysterbench info {opened.name}")
        raise SequenceError(f"{opened.name} has no camera {which!r}; {there}")

    def seen() -> Iterable[Seen]:
        if masks is None:
            return true_seen(opened, which)
        return read_seen(Path(masks), opened, which, "auto", chosen.threshold)

    return build_map(opened, poses, seen, which, depth or default_depth(opened, which), chosen)


def _opened(path: Path_) -> Sequence:
    from oysterbench.sequence import open_sequence

    return open_sequence(path)
