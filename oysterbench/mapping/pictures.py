"""Point clouds from a camera's images along a trajectory: from stereo pairs if the rig has them, else from motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.sweep import DepthMap, agreeing, sweep
from oysterbench.mapping.views import Pinhole, PoseInterpolator, View, Watch, frames, partner, unwatched
from oysterbench.sequence.types import Sequence

FIRST_DISTANCE_M = 1.0  # initial guess of the scene's distance


def seen_points(
    sequence: Sequence, camera: str, poses: PoseInterpolator, settings: CloudSettings, watch: Watch = unwatched
) -> Iterator[tuple[Array, NDArray[np.uint8]]]:
    """Yield points (N, 3) m in the world frame and their colours (N, 3) uint8, view by view.

    A point is kept if the view before or the view after has it at the same place.
    """
    latest: list[DepthMap] = []
    for depths in depth_maps(sequence, camera, poses, settings, watch):
        latest = [*latest[-2:], depths]
        if len(latest) > 1:
            middle = latest[-2]
            yield agreeing(middle, [each for each in latest if each is not middle], settings.agreement).points()
    if len(latest) > 1:
        yield agreeing(latest[-1], latest[-2:-1], settings.agreement).points()


def depth_maps(
    sequence: Sequence, camera: str, poses: PoseInterpolator, settings: CloudSettings, watch: Watch = unwatched
) -> Iterator[DepthMap]:
    """Yield the depth maps of views along a trajectory."""
    other = partner(sequence, camera, settings)
    pinhole = Pinhole(camera, sequence.cameras[camera], settings.width_px)
    second = None if other is None else Pinhole(other, sequence.cameras[other], settings.width_px)
    distance_m = FIRST_DISTANCE_M
    views: list[View] = []
    moved = 0
    for image, partner_image in frames(sequence, camera, other, settings):
        watch(image.stamp_ns)
        T_world_base = poses.taking(sequence.cameras[camera], image.stamp_ns)
        if T_world_base is None:
            views.clear()  # the motion across a gap is unknown
            continue
        place = (T_world_base @ pinhole.T_base_cam)[:3, 3]
        if views and float(np.linalg.norm(place - views[-1].T_world_cam[:3, 3])) < settings.step_share * distance_m:
            continue
        views.append(pinhole.view(image, T_world_base))
        moved += 1
        if moved % settings.every:
            continue
        if second is not None and partner_image is not None:
            sources = [second.view(partner_image, T_world_base)]
            found = sweep(views[-1], sources, settings)
            views = views[-1:]
        else:
            views = views[-5:]
            if len(views) < 5:
                continue
            found = sweep(views[2], [views[0], views[4]], settings)
        known = found.depth[np.isfinite(found.depth)]
        if len(known) > 100:
            distance_m = float(np.median(known))
        yield found
