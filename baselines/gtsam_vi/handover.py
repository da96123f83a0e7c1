"""Handover from window to filter at a keyframe: the estimate of the last state, and its covariance."""

from __future__ import annotations

import numpy as np
from gtsam.symbol_shorthand import B, V, X

from oysterbench_baselines.common.filter import CORE, InvariantFilter
from oysterbench_baselines.gtsam_vi.covariance import filter_covariance, filter_slopes, set_state
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.states import Keyframe
from oysterbench_baselines.gtsam_vi.window import Window


def correct_filter(filter: InvariantFilter, window: Window, keyframe: Keyframe, model: Model) -> None:
    """Reset the filter to the window's estimate of the last keyframe, with its covariance where there is one."""
    model.aiding.forget_intervals()
    k, shared = keyframe.index, model.aiding.shared_states()
    state = keyframe.estimate
    set_state(filter, model.at_stamp(keyframe, state))
    try:
        values, joint = window.joint([X(k), V(k), B(k), *shared])
    except RuntimeError:  # GTSAM: the system of equations cannot be solved
        return
    slopes = filter_slopes(state, k, len(filter.covariance))
    for key, (rows, unit) in shared.items():
        slopes[key] = np.zeros((len(filter.covariance), len(unit)))
        slopes[key][rows] = np.diag(unit)
    covariance = filter_covariance(joint, slopes)
    if covariance is None:
        return
    for key, (rows, unit) in shared.items():
        filter.extra[rows.start - CORE : rows.stop - CORE] = unit * values.atVector(key)
    unshared = np.setdiff1d(np.arange(len(covariance)), np.flatnonzero(np.hstack(list(slopes.values())).any(axis=1)))
    covariance[np.ix_(unshared, unshared)] = filter.covariance[np.ix_(unshared, unshared)]
    filter.covariance = covariance
