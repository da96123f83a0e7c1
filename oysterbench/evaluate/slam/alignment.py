"""Alignment of an estimate to the ground truth, and how well their geometry determines it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import (
    IDENTITY,
    Array,
    Similarity,
    align_origin,
    align_scale,
    align_umeyama,
    align_yaw,
    covariance,
    spread,
)
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_frame, with_scale
from oysterbench.evaluate.slam.association import Association, associate
from oysterbench.evaluate.slam.settings import SCALED, Align, SlamSettings

NARROW = 0.1
"""Spread across a path's main direction over spread along it, below which a rotation may be ill-determined."""
SURE_RAD = np.deg2rad(5.0)
"""A rotation whose uncertainty exceeds this is mentioned in a note."""
GUESS_RAD = 1.0
"""A rotation whose uncertainty exceeds this is a guess: errors are as large as the distances that determine it."""
EXPLAINED = 0.5
"""Share of the true motion: a scaled estimate that explains less was merely shrunk until it does little harm."""
SCALES = (0.01, 100.0)
"""Scales outside this range are mentioned in a note: centimetres, or an estimate that hardly moves."""


@dataclass(frozen=True)
class Alignment:
    """Transform that aligns an estimate to the ground truth, and how well it is determined.

    similarity:      maps the estimate's world frame to the truth's
    singular_values: (3,) m^2, of the covariance of truth and scaled estimate, largest first (se3, sim3);
                     (2,) horizontal, of the truth (posyaw); empty if nothing is fitted
    condition:       square root of the ratio of the largest to the smallest stiffness of the fit against a rotation: 1
                     if all rotations are equally determined, large for a nearly straight path; NaN if none is fitted
    sigma_rad:       uncertainty of the least determined rotation, rad; NaN if none is fitted
    notes:           what is doubtful about the alignment, in sentences
    """

    similarity: Similarity
    singular_values: Array
    condition: float = np.nan
    sigma_rad: float = np.nan
    notes: tuple[str, ...] = ()


def meet(truth: Trajectory, estimate: Trajectory, settings: SlamSettings) -> tuple[Association, Alignment]:
    """Associate an estimate with the truth, and fit the alignment.

    A scale is fitted to the poses of the frame that was estimated, and the lever arm to the body is applied to the
    scaled path: it is in metres, as only that path is. All other alignments are fitted to the poses of the body.
    """
    T = estimate.T_body_estimate if settings.align in SCALED else None
    met = associate(poses_of_frame(truth, T), poses_of_frame(estimate, T), settings)
    fit = fit_alignment(met.truth, met.estimate, settings.align, settings.align_first)
    if T is not None:
        met = associate(truth, with_scale(estimate, fit.similarity.scale), settings)
    return met, fit


def fit_alignment(truth: Trajectory, estimate: Trajectory, align: Align, first: int | None = None) -> Alignment:
    """Fit the alignment to matched poses (N,): to the `first` ones, or to all.

    Raises TrajectoryError where the geometry does not determine it: no motion, a stuck estimate, a straight line (for
    se3, sim3) or a vertical one (for posyaw), exact or with no more than noise across it.
    """
    if align == "none":
        return Alignment(IDENTITY, np.empty(0))
    if align == "origin":
        return Alignment(align_origin(truth.matrices[0], estimate.matrices[0]), np.empty(0))
    p, q = truth.positions[:first], estimate.positions[:first]
    try:
        if align == "scale":
            similarity = align_scale(p, q)
            return Alignment(similarity, np.empty(0), notes=_scale_notes(p, q, similarity.scale))
        if align == "posyaw":
            return _weigh_yaw(p, q, align_yaw(p, q))
        return _weigh_rotation(p, q, align_umeyama(p, q, with_scale=align == "sim3"), align)
    except ValueError as error:
        others = {"posyaw": "origin or none", "scale": "origin or none"}.get(align, "posyaw, origin or none")
        raise TrajectoryError(
            f"estimate cannot be aligned to the truth by {align!r}: {error}; choose another alignment ({others})"
        ) from None


def _weigh_rotation(truth: Array, estimate: Array, fit: Similarity, align: Align) -> Alignment:
    """Assess how well matched points (N, 3) determine a fitted rotation.

    A rotation by a small angle about the k-th principal axis costs N (d_i + d_j) / 2 angle^2, with d the singular
    values of the covariance of the points (the Hessian of Umeyama's cost at its optimum). An error of r across the main
    direction thus leaves the rotation about it uncertain by r / sqrt(d_2 + d_3). As errors of a trajectory are
    correlated over time, this is not divided by the root of their number.

    Raises ValueError where the path is nearly straight and the rotation about it is a guess.
    """
    fitted = fit.apply(estimate)
    u, d, vt = np.linalg.svd(covariance(truth, fitted))
    d[2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    stiffness = max(d[1] + d[2], 0.0)
    across = np.einsum("ni,ij->nj", fitted - truth, u[:, 1:])
    error_m = float(np.sqrt(np.mean(across**2)))
    sigma = _ratio(error_m, np.sqrt(stiffness))
    notes: tuple[str, ...] = ()
    variances = np.linalg.eigvalsh(covariance(truth, truth))[::-1]
    width_m, length_m = np.sqrt(max(variances[1] + variances[2], 0.0)), np.sqrt(variances[0])
    if width_m < NARROW * length_m and sigma > SURE_RAD:
        line = (
            f"the true path is nearly a straight line (it spreads {width_m:.3g} m across it, {length_m:.3g} m along "
            f"it) and the estimate errs by {error_m:.3g} m across it"
        )
        if sigma > GUESS_RAD:
            raise ValueError(f"{line}: the rotation about the line is a guess")
        notes = (
            f"{line}: the rotation about the line, and the rotation errors with it, are uncertain by "
            f"{np.rad2deg(sigma):.0f} deg; posyaw and origin do not depend on it",
        )
    elif sigma > GUESS_RAD:
        notes = (_guess(error_m, float(np.sqrt(stiffness)), sigma, "rotation"),)
    if align == "sim3":
        notes += _scale_notes(truth, estimate, fit.scale)
    return Alignment(fit, d, float(np.sqrt(_ratio(d[0] + d[1], stiffness))), sigma, notes)


def _weigh_yaw(truth: Array, estimate: Array, fit: Similarity) -> Alignment:
    """Assess how well matched points (N, 3) determine a fitted yaw: its uncertainty is r / sqrt(c), for an error of r.

    A rotation by a small angle about z costs N c / 2 angle^2, with c the mean product of the horizontal points.
    Raises ValueError where the path is nearly vertical and the yaw is a guess.
    """
    fitted = fit.apply(estimate)
    stiffness = max(float(np.trace(covariance(truth[:, :2], fitted[:, :2]))), 0.0)
    error_m = float(np.sqrt(np.mean((fitted - truth)[:, :2] ** 2)))
    sigma = _ratio(error_m, np.sqrt(stiffness))
    singular = np.asarray(np.linalg.eigvalsh(covariance(truth[:, :2], truth[:, :2]))[::-1], dtype=float)
    total_m, level_m = spread(truth), spread(truth[:, :2])
    notes: tuple[str, ...] = ()
    if level_m < NARROW * total_m and sigma > SURE_RAD:
        vertical = (
            f"the true path is nearly vertical (it spreads {level_m:.3g} m horizontally, {total_m:.3g} m in "
            f"all) and the estimate errs by {error_m:.3g} m horizontally"
        )
        if sigma > GUESS_RAD:
            raise ValueError(f"{vertical}: yaw is a guess")
        notes = (f"{vertical}: yaw is uncertain by {np.rad2deg(sigma):.0f} deg; origin does not depend on it",)
    elif sigma > GUESS_RAD:
        notes = (_guess(error_m, float(np.sqrt(stiffness)), sigma, "yaw"),)
    return Alignment(fit, singular, total_m / level_m, sigma, notes)


def _guess(error_m: float, common_m: float, sigma_rad: float, turn: str) -> str:
    """Note on a rotation left undetermined by errors as large as the motion, whatever the shape of the path."""
    uncertain = f"{np.rad2deg(sigma_rad):.0f} deg" if sigma_rad < np.pi else "any angle"
    return (
        f"over the poses used for alignment, the estimate errs by {error_m:.3g} m and has "
        f"{common_m:.3g} m of motion in common with the ground truth: its {turn} is a guess, uncertain by {uncertain}"
    )


def _scale_notes(truth: Array, estimate: Array, scale: float) -> tuple[str, ...]:
    """Notes on what is doubtful about a scale fitted to matched points (N, 3); the estimate's are not yet scaled."""
    explained = (scale * spread(estimate) / spread(truth)) ** 2
    if explained < EXPLAINED:
        return (
            f"scaled by {scale:.3g}, the estimate explains {max(explained, 0.0):.0%} of the true motion: it has "
            "hardly any motion in common with it; scaling merely shrinks such an estimate until it does little harm",
        )
    if not SCALES[0] <= scale <= SCALES[1]:
        return (f"the alignment scales the estimate by {scale:.3g}: is it in another unit than m, or stuck?",)
    return ()


def _ratio(value: float, by: float) -> float:
    """value / by; for by <= 0, infinite if value is positive, else 0."""
    if by > 0:
        return float(value / by)
    return float("inf") if value > 0 else 0.0
