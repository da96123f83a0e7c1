"""Scoring of an estimated trajectory, from files or from memory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from oysterbench.core.errors import OptionError, SequenceError, TrajectoryError
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.core.trajectory import ReadOptions, Trajectory
from oysterbench.core.trajectory.read import euroc_folder
from oysterbench.evaluate.slam import SlamResult, SlamSettings
from oysterbench.evaluate.slam import score as score_poses
from oysterbench.evaluate.slam.inputs import Poses, open_pair
from oysterbench.sequence.types import Sequence

OF_TRUTH = "truth_"
"""Prefix of the options that say how the file of the ground truth is read."""


def score(truth: Poses | Sequence, estimate: Poses, **options: Any) -> SlamResult:
    """Score an estimated trajectory against the ground truth.

    Parameters
    ----------
    truth : path, Trajectory or Sequence
        True poses of the body: a sequence with its ground truth, or its file; a file in TUM, EuRoC, KITTI, CSV, .npz,
        MCAP or rosbag format; poses in memory.
    estimate : path or Trajectory
        Estimated poses. Files are checked for common mistakes (units, quaternion order, frames, clocks), which are
        corrected, reported or refused; poses in memory are taken as they are.
    **options
        Fields of `SlamSettings`, such as ``align="se3"`` (none, origin, se3, posyaw, sim3, scale) or
        ``time_offset_s="estimate"``; and of `ReadOptions`, such as ``quaternion="wxyz"``, for the estimate's file, or
        with the prefix ``truth_``, as in ``truth_unit="mm"``, for that of the ground truth.

    Returns
    -------
    SlamResult
        ``metrics``: plain numbers by key; ``notes``: remarks on them; ``summary()``: a table.

    Raises
    ------
    oysterbench.core.errors.TrajectoryError
        The score would be meaningless: no common time, unreadable poses, or an undetermined alignment.
    oysterbench.core.errors.OptionError
        There is no such option, or it is about a file, and the poses are in memory.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> stamps_ns = (1e9 * t).astype(np.int64)
    >>> positions = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    >>> truth = oysterbench.Trajectory(stamps_ns, positions, level)
    >>> shaken = positions + 0.01 * np.sin(40 * positions)
    >>> result = oysterbench.score(truth, oysterbench.Trajectory(stamps_ns, shaken, level))
    >>> round(result.metrics["ate_rmse_m"], 2), result.metrics["coverage"]
    (0.01, 1.0)
    """
    settings, reading, truth_reading = _sorted_out(options)
    if not isinstance(truth, Sequence):
        _check_poses("truth", truth)
    _check_poses("estimate", estimate)
    if not isinstance(truth, Sequence | Trajectory) and truth_reading.topic is None:
        truth = _sequence_at(truth) or truth
    _check_reading(options, truth, estimate)
    if isinstance(truth, Sequence):
        truth = truth.truth()
    elif not isinstance(truth, Trajectory) and truth_reading.topic is None:
        truth = _poses_in_folder(truth, truth_reading)
    return score_poses(*open_pair(truth, estimate, settings, truth_reading, reading), settings)


def _check_reading(options: Mapping[str, Any], truth: Poses | Sequence, estimate: Poses) -> None:
    """Raise OptionError where an option, other than by its default, says how to read a file, and there is none to be
    read."""
    defaults = {field.name: field.default for field in fields(ReadOptions)}
    for option, value in options.items():
        of_truth = option.startswith(OF_TRUTH)
        poses, role = (truth, "ground truth") if of_truth else (estimate, "estimate")
        name = option.removeprefix(OF_TRUTH)
        if name in defaults and value is not defaults[name] and isinstance(poses, Trajectory | Sequence):
            what = "poses in memory" if isinstance(poses, Trajectory) else "a sequence, which says what its poses are"
            raise OptionError(f"{option}: it says how a file is read, and the {role} is {what}: leave it out")


def _check_poses(role: str, poses: object) -> None:
    """Raise TrajectoryError for anything but the path of a file or a Trajectory."""
    if not isinstance(poses, str | os.PathLike | Trajectory):
        raise TrajectoryError(
            f"{role}: expected the path of a file, or oysterbench.Trajectory(stamps_ns, positions, quaternions) of "
            f"poses in memory, got {type(poses).__module__.partition('.')[0]}.{type(poses).__qualname__}"
        )


def _sequence_at(path: str | os.PathLike[str]) -> Sequence | None:
    """Open the sequence at a path; None where there is none, as for other recordings and files of poses."""
    if not os.fspath(path).endswith(".mcap") and not (Path(path) / "mav0").is_dir():
        return None
    from oysterbench.sequence import open_sequence

    try:
        return open_sequence(path)
    except SequenceError:
        return None


def _poses_in_folder(file: str | os.PathLike[str], options: ReadOptions) -> Poses:
    """True poses of the folder in EuRoC layout to which a file belongs; another file as it is."""
    if (folder := euroc_folder(Path(file))) is None:
        return file
    from oysterbench.sequence.euroc import true_poses

    return true_poses(folder, options)


def _sorted_out(options: Mapping[str, Any]) -> tuple[SlamSettings, ReadOptions, ReadOptions]:
    """Split options into settings of the evaluator, and reading options of the estimate's and the ground truth's file.

    Raises OptionError for an unknown one.
    """
    scoring = {field.name for field in fields(SlamSettings)}
    reading = {field.name for field in fields(ReadOptions)}
    known = [*scoring, *reading, *(f"{OF_TRUTH}{name}" for name in reading)]
    for name in options:
        if name not in known:
            raise OptionError(
                f"score: no option {name!r}; {did_you_mean(nearest(name, known))}expected one of "
                f"{', '.join(sorted(scoring | reading))}"
            )
    of_truth = {name.removeprefix(OF_TRUTH): value for name, value in options.items() if name.startswith(OF_TRUTH)}
    return (
        SlamSettings(**{name: value for name, value in options.items() if name in scoring}),
        ReadOptions(**{name: value for name, value in options.items() if name in reading}),
        ReadOptions(**of_truth),
    )
