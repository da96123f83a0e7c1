"""Oysters on the ground along a path, each once, from what is at hand in a notebook."""

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
    """Lay the oysters of a sequence's pictures on the ground, and count each once.

    Parameters
    ----------
    sequence : Sequence or path
        Whose pictures they are.
    trajectory : Trajectory or path
        Poses of the vehicle (base_link), at any stamps.
    masks : path, optional
        Where there are oysters in the pictures: a folder, .npz or COCO file, as `oysterbench map --masks` reads them;
        the truth of a rendered sequence by default.
    camera : str, optional
        Which took the pictures; the first by default.
    depth : str, optional
        Where depths come from: stereo, motion, plane, or layer, which is the truth; what the sequence allows without
        the truth by default.
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
        The poses are of another time than the pictures.
    oysterbench.core.errors.LabelError
        The masks are not of this camera's pictures, or no oyster is in any.
    oysterbench.core.errors.SequenceError
        There is no such camera, or no depth can be had.

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
