"""Detection of a clock offset from the errors of a scored estimate: reported, but never corrected unasked."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_frame
from oysterbench.evaluate.slam.alignment import meet
from oysterbench.evaluate.slam.settings import SCALED, SlamSettings
from oysterbench.evaluate.slam.time_offset import estimate_offset, shift

MIN_SHARE = 0.25
"""Share of the squared errors that a lag must explain before an offset is estimated, which takes longer."""
MIN_SIGMAS = 5.0
"""Number of standard deviations by which an offset must differ from zero."""
LEAST_POSES, MOST_POSES = 20, 5000
"""Minimum and approximate maximum number of poses examined."""
MIN_GAIN = 0.2
"""Share of the ATE that correcting the clock must remove."""


def time_offset_notes(
    truth: Trajectory, estimate: Trajectory, matched: Trajectory, aligned: Trajectory, settings: SlamSettings
) -> list[str]:
    """Note that the estimate's stamps are off, if that accounts for much of the ATE; else an empty list.

    matched, aligned: matched true and aligned estimated poses (N,). A lag shows as an error along the velocity, as
    p(t - d) - p(t) = -d v to first order; where that explains much of what no alignment could remove, the offset is
    estimated by `estimate_offset`.
    """
    if _share(matched, aligned) < MIN_SHARE:
        return []
    fixed = estimate.T_body_estimate if settings.align in SCALED else None
    try:
        offset = estimate_offset(poses_of_frame(truth, fixed), poses_of_frame(estimate, fixed))
        if abs(offset.offset_s) < MIN_SIGMAS * offset.sigma_s:
            return []
        met, fit = meet(truth, shift(estimate, offset.offset_s), settings)
    except TrajectoryError:
        return []
    now = _rms(aligned.positions - matched.positions)
    mended = _rms(fit.similarity.apply(met.estimate.positions) - met.truth.positions)
    if mended > (1.0 - MIN_GAIN) * now:
        return []
    side = "late" if offset.offset_s < 0 else "early"
    return [
        f"the estimate's timestamps seem to be {abs(offset.offset_s):.3f} s {side}: corrected, the ATE would be "
        f"{mended:.3g} m instead of {now:.3g} m; --time-offset estimate (time_offset_s='estimate') corrects it"
    ]


def _share(matched: Trajectory, aligned: Trajectory) -> float:
    """Share (0 to 1) of the squared position errors, less what an alignment could remove, that a lag explains."""
    if len(matched.stamps_ns) < LEAST_POSES:
        return 0.0
    seconds = (matched.stamps_ns - matched.stamps_ns[0]) * 1e-9
    thin = slice(None, None, 1 + len(seconds) // MOST_POSES)
    velocity = np.gradient(matched.positions, seconds, axis=0)[thin]
    error = (aligned.positions - matched.positions)[thin]
    velocity, error = _unaligned(matched.positions[thin], velocity, error)
    squares = float(np.vdot(velocity, velocity) * np.vdot(error, error))
    return float(np.vdot(velocity, error)) ** 2 / squares if squares > 0 else 0.0


def _unaligned(positions: Array, *fields: Array) -> list[Array]:
    """Vectors (N, 3) at positions (N, 3), less the part due to a small translation, rotation and change of scale."""
    centred = positions - positions.mean(axis=0)
    moved = [np.broadcast_to(axis, centred.shape) for axis in np.eye(3)]
    turned = [np.cross(axis, centred) for axis in np.eye(3)]
    basis = np.stack([*moved, *turned, centred], axis=-1).reshape(-1, 7)
    flat = np.stack([field.ravel() for field in fields], axis=1)
    rest = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
    return [column.reshape(-1, 3) for column in rest.T]


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
