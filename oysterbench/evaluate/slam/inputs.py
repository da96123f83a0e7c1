"""Reading a truth and an estimate for scoring: what is certain is corrected and noted, what is doubtful is refused."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import NoStampsError, TrajectoryError
from oysterbench.core.trajectory import ReadOptions, Trajectory, read_trajectory
from oysterbench.evaluate.slam.diagnose import Finding, diagnose
from oysterbench.evaluate.slam.settings import SCALED, SlamSettings
from oysterbench.evaluate.slam.time_offset import estimate_offset, shift

KITTI_STEP_NS = 100_000_000
"""Interval, ns, between the poses of files without times: KITTI's cameras run at 10 Hz (Geiger et al. 2012)."""

DECIDED_BY = {
    "time-unit": ("time_unit",),
    "length-unit": ("unit",),
    "quaternion-order": ("quaternion",),
    "inverted": ("direction",),
    "frame": ("frame", "T_body_estimate"),
    "turned": ("frame", "T_body_estimate"),
}
"""Cause of a finding -> options of the estimate, any of which shows that the user has decided it."""


Poses = str | os.PathLike[str] | Trajectory
"""A trajectory, or the path of its file."""


def open_pair(
    truth: Poses,
    estimate: Poses,
    settings: SlamSettings,
    truth_options: ReadOptions | None = None,
    estimate_options: ReadOptions | None = None,
) -> tuple[Trajectory, Trajectory]:
    """Return the two trajectories, read from files by `read_pair`; those in memory are taken as they are."""
    if not isinstance(estimate, Trajectory):
        scaled = settings.align in SCALED
        return read_pair(truth, estimate, truth_options, estimate_options, settings.time_offset_s, scaled)
    return truth if isinstance(truth, Trajectory) else read_trajectory(truth, truth_options), estimate


def read_pair(
    truth_path: Poses,
    estimate_path: str | os.PathLike[str],
    truth_options: ReadOptions | None = None,
    estimate_options: ReadOptions | None = None,
    time_offset_s: float | Literal["estimate"] = 0.0,
    any_scale: bool = False,
) -> tuple[Trajectory, Trajectory]:
    """Read the two trajectories, with the decisions taken in their `notes`.

    A truth that is already a trajectory is taken as it is. A KITTI file without times takes the truth's stamps, one to
    one; two such files are matched by index, KITTI_STEP_NS apart. time_offset_s is what the scoring will add to the
    estimate's stamps; any_scale says whether it will fit a scale, so that no scale is wrong. Raises TrajectoryError
    naming the file, the cause and the option that decides it.
    """
    options = estimate_options or ReadOptions()
    truth_options = truth_options or ReadOptions()
    try:
        truth = truth_path if isinstance(truth_path, Trajectory) else read_trajectory(truth_path, truth_options)
    except NoStampsError as missing:
        assert not isinstance(truth_path, Trajectory)
        truth = read_trajectory(truth_path, truth_options, times=_by_index(estimate_path, options, missing))
        step = f"{KITTI_STEP_NS * 1e-9:g} s apart, as in KITTI; per-second metrics depend on it"
        truth = replace(truth, notes=(*truth.notes, f"neither file has times: poses meet by index, taken as {step}"))
    if options.times is None:
        options = replace(options, times=truth.stamps_ns)
    estimate = read_trajectory(estimate_path, options)
    for finding in _findings(truth, estimate, time_offset_s):
        if _decided(finding, options, truth_options, any_scale):
            continue
        if finding.severity == "refuse":
            of_truth = finding.cause == "truth-length-unit"
            name = estimate_path if not of_truth else "truth" if isinstance(truth_path, Trajectory) else truth_path
            decide = " Decide by" if finding.sentence.endswith("?") else "; decide by"
            raise TrajectoryError(f"{name}: {finding.sentence}{decide} {finding.decide}")
        if finding.severity == "certain":
            options = replace(options, **finding.changes)
            notes = estimate.notes
            estimate = read_trajectory(estimate_path, options)
            estimate = replace(estimate, notes=tuple(dict.fromkeys((*notes, *estimate.notes))))
            note = f"{Path(estimate_path).name}: {finding.sentence}; read accordingly ({finding.decide})"
        else:
            note = str(finding)
        estimate = replace(estimate, notes=(*estimate.notes, note))
    return truth, estimate


def _by_index(estimate_path: str | os.PathLike[str], options: ReadOptions, missing: NoStampsError) -> NDArray[np.int64]:
    """Stamps (N,), ns, for a truth without times whose estimate has none either; raises `missing` if it has some."""
    if options.times is None:
        try:
            read_trajectory(estimate_path, options)
        except NoStampsError as other:
            if other.poses == missing.poses:
                return np.arange(missing.poses, dtype=np.int64) * KITTI_STEP_NS
            raise TrajectoryError(
                f"{estimate_path}: expected as many poses as the truth has, {missing.poses}, since neither file has "
                f"times, got {other.poses}; give a file with one time per line, used for both (--times FILE), or "
                "all poses"
            ) from None
    raise missing


def _findings(truth: Trajectory, estimate: Trajectory, time_offset_s: float | Literal["estimate"]) -> list[Finding]:
    try:
        offset_s = estimate_offset(truth, estimate).offset_s if time_offset_s == "estimate" else float(time_offset_s)
    except TrajectoryError:
        return []  # no offset, so nothing can be compared; the scoring will report why
    return diagnose(truth, shift(estimate, offset_s))


def _decided(finding: Finding, options: ReadOptions, truth_options: ReadOptions, any_scale: bool) -> bool:
    if finding.cause in ("length-unit", "truth-length-unit") and any_scale:
        return True
    if finding.cause == "truth-length-unit":
        return truth_options.unit is not None
    return any(getattr(options, key) is not None for key in DECIDED_BY.get(finding.cause, ()))
