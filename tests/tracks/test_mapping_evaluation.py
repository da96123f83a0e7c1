"""Along which path a map is made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench.core.geometry import transform
from oysterbench.core.trajectory.frames import poses_of_body, poses_of_frame, scaled
from oysterbench.tracks.mapping_evaluation import aligned
from tests.helpers.dives import survey


@pytest.mark.parametrize("scale", [0.1, 3.0])
def test_a_map_is_made_along_the_aligned_path_of_a_camera_without_scale(scale):
    truth, place = survey(), transform(np.eye(3), np.array([0.4, 0.0, -0.1]))
    camera = replace(poses_of_frame(truth, place), T_body_estimate=None)
    path = aligned(truth, poses_of_body(scaled(camera, scale), place), "sim3")
    np.testing.assert_allclose(path.positions, truth.positions, rtol=0, atol=1e-9)
