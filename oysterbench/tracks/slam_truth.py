"""Ground truth of the SLAM track, given as a sequence, a folder in EuRoC layout, or a file of poses."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory import ReadOptions, Trajectory
from oysterbench.core.trajectory.read import euroc_folder
from oysterbench.sequence import open_sequence
from oysterbench.sequence.euroc import true_poses
from oysterbench.tracks.slam_options import check_not_read


def true_poses_of(place: Path, options: ReadOptions | None) -> Path | Trajectory:
    """Ground truth of an oysterbench sequence, if the file is one and no topic is requested, or of a folder in EuRoC
    layout, also by the file that it is in there, which options may say how to read; else the file itself.

    Raises OptionError where options say how to read a file in place of the sequence, SequenceError or TrajectoryError
    where the folder has no ground truth, or one that cannot be read.
    """
    if options is not None and options.topic is not None:
        return place
    if (place / "mav0").is_dir():
        check_not_read(options)
        return true_poses(place)
    if (folder := euroc_folder(place)) is not None:
        return true_poses(folder, options)
    if place.suffix == ".mcap" or place.is_dir():
        with suppress(SequenceError):
            truth = open_sequence(place).truth()
            check_not_read(options)
            return truth
    return place


def truth_digest(truth: Trajectory) -> str:
    """SHA-256 of stamps and poses, which shows whether two results refer to the same ground truth."""
    text = hashlib.sha256()
    for array in (truth.stamps_ns, truth.positions, truth.quaternions):
        text.update(array.tobytes())
    return text.hexdigest()
