"""Motion of a camera while it takes one image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe


@dataclass(frozen=True)
class Passage:
    """Poses T_map_cam (4, 4) during an image whose middle row is exposed around the pose of the image.

    rows (H + 2, 4, 4): at the middle of the exposure of each row, and of one row beyond the first and the last; None
    if all rows are exposed at once. ends (2, 4, 4): when the shutter opens and closes for the middle row; None if it
    is open for an instant only. shutter_s: how long it is open.
    """

    rows: Array | None = None
    ends: Array | None = None
    shutter_s: float = 0.0


STILL = Passage()


@dataclass(frozen=True)
class Moment:
    """An image to come: its time, the poses (4, 4) of camera and vehicle then, and the camera's motion during it."""

    time_s: float
    T_map_cam: Array
    T_map_base: Array
    passage: Passage = STILL


def row_times(camera: CameraRecipe) -> Array:
    """Exposure times (H + 2,) of rows -1 to H, s from the middle of the image: each readout_ms / H after the last."""
    rows = np.arange(-1, camera.height + 1)
    return np.asarray((rows - (camera.height - 1) / 2) * (camera.readout_ms * 1e-3 / camera.height))


def passage(camera: CameraRecipe, shutter_s: float, poses: Callable[[Array], list[Array]]) -> Passage:
    """Build a camera's passage; poses: function that returns T_map_cam (4, 4) at times (N,) s from the middle of the
    image."""
    rows = np.array(poses(row_times(camera))) if camera.readout_ms else None
    ends = np.array(poses(np.array([-0.5, 0.5]) * shutter_s)) if shutter_s else None
    return Passage(rows, ends, shutter_s)
