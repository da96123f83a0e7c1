"""Whether an estimate's clock is off, told from the errors of a scored one: said, and never mended unasked."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_frame
from oysterbench.evaluate.slam.alignment import meet
from oysterbench.evaluate.slam.clock import estimate_offset, shift
from oysterbench.evaluate.slam.settings import SCALED, SlamSettings

MIN_SHARE = 0.25
"""Of the squared errors: what one lag must explain before an offset is sought, which takes longer."""
MIN_SIGMAS = 5.0
"""By which an offset must differ from none."""
MIN_GAIN = 0.2
"""Of the ATE: what mending the clock must take away."""


def lag_notes(
    truth: Trajectory, estimate: Trajectory, matched: Trajectory, aligned: Trajectory, settings: SlamSettings
) -> list[str]:
    """A note where the estimate's stamps are off and that costs much of the ATE; else nothing.

    matched, aligned: matched true and aligned estimated poses (N,). A lag shows as an error along the velocity, as
    p(t - d) - p(t) = -d v to first order; where that explains much, the offset is sought by `estimate_offset`.
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
        f"the estimate's stamps seem to be {abs(offset.offset_s):.3f} s {side}: without that the ATE were "
        f"{mended:.3g} m instead of {now:.3g} m; --time-offset estimate (time_offset_s='estimate') mends it"
    ]


def _share(matched: Trajectory, aligned: Trajectory) -> float:
    """Share (0 to 1) of the squared position errors that a lag explains."""
    if len(matched.stamps_ns) < 3:
        return 0.0
    seconds = (matched.stamps_ns - matched.stamps_ns[0]) * 1e-9
    velocity = np.gradient(matched.positions, seconds, axis=0)
    error = aligned.positions - matched.positions
    velocity, error = velocity - velocity.mean(axis=0), error - error.mean(axis=0)
    squares = float(np.vdot(velocity, velocity) * np.vdot(error, error))
    return float(np.vdot(velocity, error)) ** 2 / squares if squares > 0 else 0.0


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
