"""The start of the window: when to look for one, and whether what is found will do."""

from __future__ import annotations

import numpy as np
from gtsam.symbol_shorthand import X

from oysterbench_baselines.gtsam_vi.covariance import joint_covariance
from oysterbench_baselines.gtsam_vi.graph import Bundle, Model, adjust
from oysterbench_baselines.gtsam_vi.initialisation import View, closed_form_start
from oysterbench_baselines.gtsam_vi.settings import Settings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, states_of


def is_metric(stretch: list[Keyframe], settings: Settings) -> bool:
    """Whether two cameras tell the scale."""
    return _seen_twice(stretch[-1].view) >= settings.init_min_tracks


def is_worth_a_try(stretch: list[Keyframe], settings: Settings) -> bool:
    """Enough tracks, key frames and time; of one camera, time in motion."""
    metric = is_metric(stretch, settings)
    if metric:
        least, least_s = settings.init_stereo_keyframes, settings.init_stereo_s
    else:
        least, least_s = settings.init_min_keyframes, settings.init_min_s
    elapsed = sum(k.segment.duration for k in stretch[1:] if metric or not k.at_rest)
    if len(stretch) < least or elapsed < least_s:
        return False
    counts = np.unique(np.concatenate([k.view.sights()[0] for k in stretch]), return_counts=True)[1]
    return np.count_nonzero(counts >= settings.min_views) >= settings.init_min_tracks


def find_start(model: Model, stretch: list[Keyframe], anchor: State | None, max_scale_sigma: float) -> Bundle | None:
    """The adjusted stretch, its first key frame at the anchor; None where it does not fit or its scale is uncertain."""
    settings = model.settings
    start = closed_form_start(
        [k.view for k in stretch],
        [k.segment for k in stretch[1:]],
        model.T_imu_cams,
        model.imu.gravity,
        model.gyro_turn_on,
        model.accel_turn_on,
        settings.pixel_sigma_px / model.focal,
    )
    try:
        bundle = adjust(model, stretch, states_of(start, anchor), settings.init_gates_px)
    except RuntimeError:  # GTSAM: the system of equations cannot be solved
        return None
    if len(bundle.landmarks) < settings.init_min_tracks:
        return None
    if not np.median(bundle.errors_px) <= settings.init_max_error_px:
        return None
    if not is_metric(stretch, settings) and not scale_sigma(bundle, stretch) <= max_scale_sigma:
        return None
    return bundle


def _seen_twice(view: View) -> int:
    """Number of tracks that both cameras see."""
    return 0 if view.right is None else int(np.isfinite(view.right[:, 0]).sum())


def scale_sigma(bundle: Bundle, keyframes: list[Keyframe]) -> float:
    """Relative 1-sigma uncertainty of scale: of the longest way from the first key frame, along it."""
    poses = [bundle.values.atPose3(X(k.index)) for k in keyframes]
    offsets = np.array([pose.translation() for pose in poses]) - poses[0].translation()
    far = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    length = float(np.linalg.norm(offsets[far]))
    if length < 1e-3:
        return float("inf")
    try:
        covariance = joint_covariance(bundle.graph, bundle.values, [X(keyframes[0].index), X(keyframes[far].index)])
    except RuntimeError:
        return float("inf")
    along = offsets[far] / length
    # GTSAM states the translation in the axes of the pose itself, after the rotation.
    slope = np.zeros(12)
    slope[3:6] = -poses[0].rotation().matrix().T @ along
    slope[9:12] = poses[far].rotation().matrix().T @ along
    return float(np.sqrt(slope @ covariance @ slope)) / length
