"""The map that the GTSAM baselines leave: landmarks where the ground is, in its colours, in the path's own frame."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oysterbench.core.geometry import align_yaw
from oysterbench_baselines.gtsam_vi import GtsamVi
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks
from oysterbench_baselines.gtsam_vi.mapping import Palette
from tests.baselines.test_gtsam_vi import FlatBottom, position_error
from tests.helpers import synthetic_dive as dive


@pytest.mark.slow
def test_landmarks_lie_on_the_ground_and_have_its_colours():
    sequence = FlatBottom(7.0)
    truth = sequence.truth()
    result = GtsamVi().run(sequence.for_method())
    found = result.map
    assert found is not None
    assert len(found.landmarks) > 150
    assert len(found.keyframes) == result.info["keyframes"]
    # Key frames are poses of the very path.
    np.testing.assert_allclose(
        found.keyframes.positions, result.trajectory.at(found.keyframes.stamps_ns).positions, atol=1e-3
    )
    assert position_error(truth, found.keyframes) < 0.01 * truth.path_length
    known = truth.at(result.trajectory.stamps_ns)
    points = align_yaw(known.positions, result.trajectory.positions).apply(found.landmarks)
    assert np.quantile(np.abs(points[:, 2] + 4.0), 0.9) < 0.04
    # Texels of 1 cm, the first at x = y = -7 m.
    texture = cv2.blur(sequence._texture, (3, 3))
    inside = np.abs(points[:, :2]).max(axis=1) < 6.9  # the texture's border makes corners, too
    columns, rows = np.round((points[inside, :2] + 7.0) / 0.01).astype(int).T
    assert np.all(found.colours == found.colours[:, :1])
    assert np.corrcoef(texture[rows, columns], found.colours[inside, 0])[0, 1] > 0.7
    # No key frame counts twice, and a landmark has at least as many as made it one.
    assert found.observations.min() >= 3
    assert found.observations.max() <= len(found.keyframes)


def test_a_track_has_the_mean_colour_of_the_key_frames_that_saw_it():
    palette = Palette()
    assert not palette
    for level in (10, 30):
        picture = np.zeros((40, 60, 3), dtype=np.uint8)
        picture[:, :30], picture[:, 30:] = (level, 0, 100), (0, 50, level)
        ids = np.array([7, 3]) if level == 10 else np.array([3, 9])
        palette.add(picture, FeatureTracks(ids, np.array([[10.0, 5.0], [59.4, 39.4]]), np.zeros((2, 2))))
    np.testing.assert_array_equal(palette.of(np.array([3, 7, 9])), [[15, 25, 55], [10, 0, 100], [0, 50, 30]])


def test_a_grey_camera_gives_greys():
    palette = Palette()
    palette.add(np.full((20, 20), 77, np.uint8), FeatureTracks(np.array([1]), np.array([[4.0, 4.0]]), np.zeros((1, 2))))
    np.testing.assert_array_equal(palette.of(np.array([1])), [[77, 77, 77]])


def test_there_is_no_map_where_nothing_was_found():
    result = GtsamVi().run(FlatBottom(0.4).for_method())
    assert result.map is None
    assert len(result.trajectory) == round(0.4 * dive.camera_calibration().rate_hz)


def test_a_landmark_too_weakly_known_costs_the_covariances_and_not_the_path(monkeypatch):
    def unsolvable(*given):
        raise RuntimeError("Indeterminate linear system detected")

    monkeypatch.setattr("oysterbench_baselines.gtsam_vi.smoothing.pose_covariances", unsolvable)
    sequence = FlatBottom(5.0)
    result = GtsamVi().run(sequence.for_method())
    assert result.trajectory.covariances is None
    assert result.info["covariances_failed"] == 1
    assert len(result.trajectory) > 40
    assert position_error(sequence.truth(), result.trajectory) < 0.01
