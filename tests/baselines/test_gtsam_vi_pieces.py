"""A path adjusted piece by piece: the same path, and the same covariances, of which no more than a piece is held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench_baselines.gtsam_vi.bundle import Views
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.pieces import Piecewise, parts_of
from oysterbench_baselines.gtsam_vi.settings import SmoothingSettings
from tests.baselines.test_gtsam_vi import estimate
from tests.helpers import synthetic_dive as dive


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    return estimate(dive.make_dive(0, duration_s=10.0, most=50))


def in_pieces(estimator: Estimator, size: int) -> None:
    estimator.model.settings = replace(estimator.model.settings, smoothing=SmoothingSettings(piece_keyframes=size))


def test_pieces_are_about_as_large_as_wanted_and_a_short_path_is_one():
    assert parts_of(399, 200) == [range(399)]
    assert parts_of(400, 200) == [range(200), range(200, 400)]
    for count in (3, 401, 599, 1290, 3871, 10_001):
        parts = parts_of(count, 200)
        assert [n for part in parts for n in part] == list(range(count))
        assert len(parts) == 1 or all(200 <= len(part) <= 300 for part in parts)


def test_what_is_smoothed_piece_by_piece_is_what_is_smoothed_as_one(estimator):
    in_pieces(estimator, 1000)
    whole = estimator.smoothed()
    in_pieces(estimator, 7)
    pieces = estimator.smoothed()
    assert "smoothing_failed" not in estimator.info
    np.testing.assert_allclose(pieces.positions, whole.positions, atol=1e-6)
    scale = np.sqrt(np.einsum("nii->ni", whole.covariances))
    difference = (pieces.covariances - whole.covariances) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(difference).max() < 1e-7


def test_a_step_to_where_nothing_can_be_solved_is_halved(estimator, monkeypatch):
    in_pieces(estimator, 7)
    usual, system, calls = estimator.smoothed(), Piecewise.system, []

    def now_and_then(path, values, times=1.0):
        calls.append(times)
        if len(calls) == 2:  # the first step of all
            raise RuntimeError("Indeterminate linear system detected while working near variable l44574")
        return system(path, values, times)

    monkeypatch.setattr(Piecewise, "system", now_and_then)
    halved = estimator.smoothed()
    assert "smoothing_failed" not in estimator.info
    np.testing.assert_allclose(halved.positions, usual.positions, atol=1e-4)


def test_a_piece_shares_the_ends_of_it_however_long_the_path_is(estimator):
    keyframes, model = estimator.keyframes, estimator.model
    states, views = [keyframe.estimate for keyframe in keyframes], Views.of(keyframes, 3)

    def path(count: int) -> Piecewise:
        parts = [range(n, n + 5) for n in range(0, count, 5)]
        seen = views.of_tracks(np.unique(np.concatenate([k.observations.ids for k in keyframes[:count]])))
        own = seen.row < count
        seen = Views(seen.row[own], seen.track[own], seen.rays[own], seen.camera[own])
        return Piecewise.of(model, model.rig, keyframes[:count], parts, seen, states[:count], 9.0)

    short, long = path(10), path(5 * (len(keyframes) // 5))
    assert len(long.parts) > len(short.parts)
    sizes = [long.graph(p).size() for p in range(len(long.parts))]
    assert sum(sizes) > 1.5 * max(sizes)
    # What a piece shares are poses that its own last landmarks reach, and the states at its ends: no landmark.
    for shared in long.shared:
        assert {chr(key >> 56) for key in shared} <= {"x", "v", "b"}
        assert len(shared) < 3 * 2 * 5
