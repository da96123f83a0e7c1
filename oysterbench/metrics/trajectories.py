"""Metrics of trajectories, each a function of the true and the estimated poses.

truth, estimate: poses (`oysterbench.Trajectory`), or files of them. settings: fields of `SlamSettings`, such as
`align="se3"`; by default translation and yaw are fitted, which are free where gravity is known. A metric is NaN where
there is no sample: `oysterbench.score(truth, estimate).reasons` says why. For several metrics of one pair, that is
faster as well.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Literal

from oysterbench.core.errors import OptionError
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.evaluate.slam import SlamSettings, score
from oysterbench.evaluate.slam.inputs import Poses, open_pair

Unit = Literal["s", "m", "deg", "frames"]


def ate(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Absolute trajectory error: root mean square distance of aligned positions, m (Sturm et al. 2012, eq. 5).

    Parameters
    ----------
    truth, estimate : Trajectory or path
        Poses of the body.
    **settings
        Fields of `oysterbench.SlamSettings`, such as ``align="se3"``.

    Returns
    -------
    float
        m, over the truth stamps that the estimate covers; see `coverage` for how many these are.

    Raises
    ------
    oysterbench.core.errors.TrajectoryError
        The two do not overlap in time, or their motion does not determine the alignment.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> line = np.stack([t, 0 * t, 0 * t], axis=1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), line, level)
    >>> off = oysterbench.Trajectory(truth.stamps_ns, line + [0, 0, 0.3], level)
    >>> round(oysterbench.metrics.ate(truth, off, align="none"), 6)
    0.3
    """
    return _metric(truth, estimate, "ate_rmse_m", settings)


def ate_rotation(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Root mean square angle between true and aligned estimated attitudes, deg; parameters as for `ate`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    >>> level, tilted = np.array([0, 0, 0, 1.0]), np.array([np.sin(0.05), 0, 0, np.cos(0.05)])
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), circle, np.tile(level, (100, 1)))
    >>> leaning = oysterbench.Trajectory(truth.stamps_ns, circle, np.tile(tilted, (100, 1)))
    >>> round(oysterbench.metrics.ate_rotation(truth, leaning), 3)         # 0.1 rad
    5.73
    """
    return _metric(truth, estimate, "ate_rotation_rmse_deg", settings)


def rpe(truth: Poses, estimate: Poses, delta: float = 1.0, unit: Unit = "s", **settings: Any) -> float:
    """Relative pose error: root mean square translation of the relative motions' errors, m (Sturm et al. 2012, eq. 2).

    Parameters
    ----------
    truth, estimate : Trajectory or path
        Poses of the body.
    delta : float
        Distance between the two poses of a pair.
    unit : {"s", "m", "deg", "frames"}
        Unit of delta: time, true path length, true angle turned, or number of matched poses.
    **settings
        Fields of `oysterbench.SlamSettings`, such as ``rpe_pairs="consecutive"``.

    Returns
    -------
    float
        m; NaN if no two poses are that far apart.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), np.stack([t, 0 * t, 0 * t], axis=1), level)
    >>> longer = oysterbench.Trajectory(truth.stamps_ns, 1.02 * truth.positions, level)
    >>> round(oysterbench.metrics.rpe(truth, longer), 6), round(oysterbench.metrics.rpe(truth, longer, 50, "frames"), 6)
    (0.02, 0.1)
    """
    return _relative(truth, estimate, delta, unit, "translation_rmse_m", settings)


def rpe_rotation(truth: Poses, estimate: Poses, delta: float = 1.0, unit: Unit = "s", **settings: Any) -> float:
    """Relative pose error: root mean square angle of the relative motions' errors, deg; parameters as for `rpe`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    >>> turning = np.stack([0 * t, 0 * t, np.sin(0.005 * t), np.cos(0.005 * t)], axis=1)    # 0.01 rad/s
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), circle, np.tile([0, 0, 0, 1.0], (100, 1)))
    >>> drifting = oysterbench.Trajectory(truth.stamps_ns, circle, turning)
    >>> round(oysterbench.metrics.rpe_rotation(truth, drifting), 3)
    0.573
    """
    return _relative(truth, estimate, delta, unit, "rotation_rmse_deg", settings)


def drift(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Mean relative translation error over segments, % of their length (Geiger et al. 2012); parameters as for `ate`.

    Segments have lengths of 10, 20, 30, 40 and 50 % of the true path, or those given by `subpath_m`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), np.stack([t, 0 * t, 0 * t], axis=1), level)
    >>> longer = oysterbench.Trajectory(truth.stamps_ns, 1.02 * truth.positions, level)
    >>> round(oysterbench.metrics.drift(truth, longer), 1)
    2.0
    """
    return _metric(truth, estimate, "subpath_translation_percent", settings)


def velocity_error(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Root mean square error of the mean velocity over `velocity_step_s`, m/s; parameters as for `ate`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), np.stack([t, 0 * t, 0 * t], axis=1), level)
    >>> faster = oysterbench.Trajectory(truth.stamps_ns, 1.02 * truth.positions, level)
    >>> round(oysterbench.metrics.velocity_error(truth, faster), 6)
    0.02
    """
    return _metric(truth, estimate, "velocity_rmse_m_per_s", settings)


def scale_error(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Median error of the scale of segments, %; parameters as for `ate`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), np.stack([t, 0 * t, 0 * t], axis=1), level)
    >>> longer = oysterbench.Trajectory(truth.stamps_ns, 1.02 * truth.positions, level)
    >>> round(oysterbench.metrics.scale_error(truth, longer), 6)
    2.0
    """
    return _metric(truth, estimate, "subpath_scale_error_percent", settings)


def coverage(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Share (0 to 1) of the truth stamps that the estimate covers; parameters as for `ate`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), circle, np.tile([0, 0, 0, 1.0], (100, 1)))
    >>> oysterbench.metrics.coverage(truth, truth.select(slice(0, 75)))
    0.75
    """
    return _metric(truth, estimate, "coverage", settings)


def trajectory_score(truth: Poses, estimate: Poses, **settings: Any) -> float:
    """Score that ranks methods (0 to 1): the mean over all truth stamps of 1 / (1 + e / e0), 0 where there is no
    estimate, with e the position error and e0 1 % of the true path; parameters as for `ate`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> t = np.arange(0, 10, 0.1)
    >>> circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    >>> truth = oysterbench.Trajectory((1e9 * t).astype(np.int64), circle, np.tile([0, 0, 0, 1.0], (100, 1)))
    >>> round(oysterbench.metrics.trajectory_score(truth, truth.select(slice(0, 75))), 6)
    0.75
    """
    return _metric(truth, estimate, "score", settings)


def _relative(truth: Poses, estimate: Poses, delta: float, unit: str, what: str, settings: dict[str, Any]) -> float:
    if unit not in ("s", "m", "deg", "frames"):
        raise OptionError(f"unit: expected one of s, m, deg, frames, got {unit!r}")
    if unit == "frames":
        return _metric(truth, estimate, f"rpe_{round(delta)}frames_{what}", {**settings, "rpe_frames": round(delta)})
    return _metric(truth, estimate, f"rpe_{delta:g}{unit}_{what}", {**settings, f"rpe_delta_{unit}": float(delta)})


def _metric(truth: Poses, estimate: Poses, key: str, settings: dict[str, Any]) -> float:
    known = [field.name for field in fields(SlamSettings)]
    for name in settings:
        if name not in known:
            meant = did_you_mean(nearest(name, known))
            raise OptionError(f"no setting {name!r} of the evaluator; {meant}it has {', '.join(known)}")
    chosen = SlamSettings(**settings)
    return float(score(*open_pair(truth, estimate, chosen), chosen).metrics[key])
