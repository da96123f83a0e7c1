"""Clock offset between an estimate and the ground truth, found from how fast each of them moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, rotation_angle
from oysterbench.core.trajectory import Trajectory

MIN_STEP_S = 0.05
"""Speeds are averaged over this time or the longer of the median steps: noise falls with it, lag grows with it."""
MIN_OVERLAP = 0.5
"""Share of the shorter trajectory that must overlap the other one at an offset to be tried."""
MIN_CORRELATION = 0.6
"""If the best correlation is below this, the two do not move alike at any offset."""
MIN_LEAD = 0.02
"""Difference in correlation by which the best offset must exceed any other that is not adjacent to it."""
MAX_SAMPLES = 2**20


@dataclass(frozen=True)
class Offset:
    """Time offset to add to the estimate's stamps.

    offset_s:    s
    sigma_s:     its standard deviation, s, from how sharply the fit of the speeds peaks there
    correlation: of the two speeds at the offset, -1 to 1
    signal:      which speed was compared
    """

    offset_s: float
    sigma_s: float
    correlation: float
    signal: str


def estimate_offset(truth: Trajectory, estimate: Trajectory) -> Offset:
    """Find the offset at which the speeds of truth and estimate agree best.

    Neither angular nor linear speed depends on the choice of the world frame, and angular speed not on that of the body
    frame either. Each is sampled evenly, correlated at all offsets with enough overlap, and refined between the
    samples; the one with the smaller uncertainty is used. Raises TrajectoryError where both fail.
    """
    step_s = max(MIN_STEP_S, _median_step(truth), _median_step(estimate))
    step_s = max(step_s, _duration(truth) / MAX_SAMPLES, _duration(estimate) / MAX_SAMPLES)
    found, failures = [], []
    for signal in ("angular speed", "speed"):
        try:
            found.append(fit_offset(_speed(truth, step_s, signal), _speed(estimate, step_s, signal), step_s, signal))
        except ValueError as error:
            failures.append(f"by {signal} {error}")
    if not found:
        raise TrajectoryError(
            f"the time offset of the estimate cannot be found: {'; '.join(failures)}; give it in seconds"
        )
    best = min(found, key=lambda offset: offset.sigma_s)
    begins_s = float(int(truth.stamps_ns[0]) - int(estimate.stamps_ns[0])) * 1e-9
    return Offset(best.offset_s + begins_s, best.sigma_s, best.correlation, best.signal)


def shift(trajectory: Trajectory, offset_s: float) -> Trajectory:
    """Return the trajectory with offset_s added to its stamps, rounded to the nanosecond."""
    if offset_s == 0.0:
        return trajectory
    return replace(trajectory, stamps_ns=trajectory.stamps_ns + round(offset_s * 1e9))


def _median_step(trajectory: Trajectory) -> float:
    return float(np.median(np.diff(trajectory.stamps_ns))) * 1e-9


def _duration(trajectory: Trajectory) -> float:
    return float(trajectory.stamps_ns[-1] - trajectory.stamps_ns[0]) * 1e-9


def _speed(trajectory: Trajectory, step_s: float, signal: str) -> Array:
    """Mean speed (K,) in rad/s or m/s over each interval of step_s from the first stamp on."""
    count = int(_duration(trajectory) / step_s) + 1
    stamps_ns = trajectory.stamps_ns[0] + np.round(np.arange(count) * step_s * 1e9).astype(np.int64)
    poses = trajectory.at(np.minimum(stamps_ns, trajectory.stamps_ns[-1]))
    if signal == "speed":
        return np.asarray(np.linalg.norm(np.diff(poses.positions, axis=0), axis=1) / step_s)
    return rotation_angle(poses.quaternions[:-1], poses.quaternions[1:]) / step_s


def fit_offset(truth: Array, estimate: Array, step_s: float, signal: str) -> Offset:
    """Find the offset between the first stamps of two evenly sampled speeds (K,), (L,), with step_s between samples.

    Raises ValueError where there are too few samples, too little variation or correlation, or no distinct maximum.
    """
    shortest = min(len(truth), len(estimate))
    if shortest < 8:
        raise ValueError(f"there are {shortest} samples, at least 8 are needed")
    if np.std(truth) <= 1e-6 * np.abs(truth).max() or np.std(estimate) <= 1e-6 * np.abs(estimate).max():
        raise ValueError("nothing varies")
    lags, correlation = _correlations(truth, estimate, max(8, int(MIN_OVERLAP * shortest)))
    peak = int(np.argmax(correlation))
    best = float(correlation[peak])
    if best < MIN_CORRELATION:
        raise ValueError(f"the best correlation is {best:.2f}, at least {MIN_CORRELATION} is needed")
    rival = _rival(correlation, peak)
    if best - rival < MIN_LEAD:
        raise ValueError(f"two offsets fit equally well (correlations {best:.3f} and {rival:.3f}): the motion repeats")
    lag, sigma = _refine(truth, estimate, int(lags[peak]))
    return Offset(lag * step_s, sigma * step_s, best, signal)


def _correlations(truth: Array, estimate: Array, least: int) -> tuple[NDArray[np.int64], Array]:
    """Lags with `least` or more overlapping samples, and there Pearson's correlation of truth[k + lag], estimate[k]."""
    a, b = truth - truth.mean(), estimate - estimate.mean()
    one_a, one_b = np.ones_like(a), np.ones_like(b)
    count, sum_a, sum_b, squares_a, squares_b, products = (
        _correlated(x, y) for x, y in ((one_a, one_b), (a, one_b), (one_a, b), (a * a, one_b), (one_a, b * b), (a, b))
    )
    lags = np.arange(-len(b) + 1, len(a))
    kept = count > least - 0.5
    n, sum_a, sum_b = count[kept], sum_a[kept], sum_b[kept]
    spread_a = np.maximum(squares_a[kept] - sum_a**2 / n, 1e-9 * np.vdot(a, a))
    spread_b = np.maximum(squares_b[kept] - sum_b**2 / n, 1e-9 * np.vdot(b, b))
    return lags[kept], (products[kept] - sum_a * sum_b / n) / np.sqrt(spread_a * spread_b)


def _correlated(x: Array, y: Array) -> Array:
    """Sums of x[k + lag] y[k] over k at all lags, bit for bit those of scipy.signal.correlate with method "fft", which
    takes half a second to import."""
    fft = scipy.fft
    length = len(x) + len(y) - 1
    padded = fft.next_fast_len(length, real=True)
    return np.asarray(fft.irfft(fft.rfft(x, padded) * fft.rfft(y[::-1], padded), padded)[:length])


def _rival(correlation: Array, peak: int) -> float:
    """Highest correlation at any local maximum other than the peak; -1 if there is none."""
    inner = correlation[1:-1]
    hills = 1 + np.flatnonzero((inner >= correlation[:-2]) & (inner >= correlation[2:]))
    ends = [k for k in (0, len(correlation) - 1) if abs(k - peak) > 1]
    others = [k for k in (*hills.tolist(), *ends) if abs(k - peak) > 1]
    return max((float(correlation[k]) for k in others), default=-1.0)


def _refine(truth: Array, estimate: Array, lag: int) -> tuple[float, float]:
    """Lag with the smallest residuals of a linear fit between the two speeds, and its standard deviation, in samples.

    The deviation is that of least squares, sqrt(s^2 / sum(v'^2)), with s the standard deviation of the residuals and v'
    the slope, where the number of independent residuals follows from their correlation from one sample to the next.
    """
    from scipy.optimize import minimize_scalar  # here, as it takes a third of a second to import, seldom needed

    index = np.arange(max(1, 1 - lag), min(len(estimate) - 1, len(truth) - 1 - lag))
    known = np.arange(len(truth))

    def residuals(at: float) -> Array:
        there = np.interp(index + at, known, truth)
        here = estimate[index]
        there, here = there - there.mean(), here - here.mean()
        return np.asarray(there - here * (np.vdot(here, there) / max(np.vdot(here, here), 1e-300)))

    best = minimize_scalar(
        lambda at: float(np.mean(residuals(at) ** 2)),
        bounds=(lag - 1.0, lag + 1.0),
        method="bounded",
        options={"xatol": 1e-5},
    )
    rest = residuals(best.x)
    slope = np.gradient(truth)[np.clip(np.round(index + best.x).astype(int), 0, len(truth) - 1)]
    variance = float(np.mean(rest**2))
    kept = float(np.mean(rest[1:] * rest[:-1]) / variance) if variance > 0 else 0.0
    inflation = (1.0 + min(max(kept, 0.0), 0.99)) / (1.0 - min(max(kept, 0.0), 0.99))
    return float(best.x), float(np.sqrt(inflation * variance / max(np.vdot(slope, slope), 1e-300)))
