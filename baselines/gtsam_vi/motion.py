"""How much a picture has moved: the measures by which key frames are chosen and rest is known."""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.gtsam_vi.frontend import homogeneous
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.initialisation import View


def parallax(before: Array, after: Array, R_before_after: Array) -> float:
    """Median flow, at depth 1, between rays (N, 2) and (N, 2) that a rotation does not explain."""
    turned = homogeneous(before) @ R_before_after
    flow = after - turned[:, :2] / np.maximum(turned[:, 2:], 0.1)
    return float(np.median(np.linalg.norm(flow, axis=1)))


def at_rest(before: View, after: View, duration: float, model: Model) -> bool:
    """The picture has not moved in `duration` s.

    Judged by the affine flow that fits all tracks: their own noise averages out in it, and motion in any direction
    or about any axis shows.
    """
    settings = model.settings
    shared, in_before, in_after = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
    if len(shared) < settings.init_min_tracks or duration < settings.rest_s:
        return False
    flow = (after.rays[in_after] - before.rays[in_before]) * model.focal
    length = np.linalg.norm(flow, axis=1)
    calm = length <= 3 * np.median(length)
    places = homogeneous(before.rays[in_before][calm])
    fit = places @ np.linalg.lstsq(places, flow[calm], rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(fit**2, axis=1)))) < settings.rest_px
