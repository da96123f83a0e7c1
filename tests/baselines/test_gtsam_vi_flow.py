"""The front end's prediction of where tracks go on to, and how far it searches from there."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench_baselines.gtsam_vi import GtsamViSettings, frontend
from oysterbench_baselines.gtsam_vi.flow import Flow, fit_flow
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd
from tests.helpers import synthetic_dive as dive

SETTINGS = GtsamViSettings().frontend
STEP_S = 0.05


def strip(width: int = 1100) -> np.ndarray:
    """A bottom that is wider than an image."""
    noise = np.random.default_rng(0).normal(size=(480, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5) * 3 + cv2.GaussianBlur(noise, (0, 0), 5) * 5
    return np.clip(110 + 40 * smooth, 0, 255).astype(np.uint8)


def test_the_fit_of_the_flow_leaves_out_what_moves_otherwise():
    generator = np.random.default_rng(1)
    rays, fit = generator.uniform(-0.6, 0.6, (60, 2)), np.array([[2.0, 0.3], [-0.1, 1.5], [8.0, -3.0]])
    flow = np.column_stack([rays, np.ones(60)]) @ fit
    flow[:6] += [25.0, 10.0]  # a fish
    np.testing.assert_allclose(fit_flow(rays, flow), fit, atol=1e-9)


def test_the_flow_goes_on_at_its_speed():
    rays = np.random.default_rng(2).uniform(-0.6, 0.6, (40, 2))
    flow = Flow.of(rays, np.tile([6.0, -2.0], (40, 1)), np.tile([0.3, 0.4], (40, 1)), 0.95, 0.1)
    np.testing.assert_allclose(flow.after(rays, 0.2), np.tile([12.0, -4.0], (40, 1)), atol=1e-9)
    assert np.isclose(flow.error_px, 0.5)
    few = Flow.of(rays[:5], np.ones((5, 2)), np.ones((5, 2)), 1.0, 0.1)
    assert not few.after(rays, 0.2).any()
    assert few.error_px == np.inf


def levels_of_search(monkeypatch, places: list[int]) -> tuple[list[int], list[float]]:
    """Pyramid levels of each search, and share of the tracks that come through from frame to frame, as the camera looks
    at these columns of the bottom."""
    levels: list[int] = []
    kept: list[float] = []
    follow = frontend.follow

    def noted(before, after, pixels, guess, settings):
        levels.append(settings.flow_levels)
        return follow(before, after, pixels, guess, settings)

    monkeypatch.setattr(frontend, "follow", noted)
    front_end, bottom = FrontEnd(dive.camera_calibration(), SETTINGS), strip()
    tracks = None
    for before, place in zip([0, *places], places, strict=False):
        now = front_end.track(bottom[:, place : place + 640], np.eye(3), STEP_S)
        if tracks is not None:
            _, a, b = np.intersect1d(tracks.ids, now.ids, return_indices=True)
            off = now.pixels[b] - tracks.pixels[a] - np.array([before - place, 0.0])
            kept.append(float((np.linalg.norm(off, axis=1) < 0.5).sum() / len(tracks.ids)))
        tracks = now
    return levels, kept


def test_a_steady_flow_is_searched_for_where_it_goes_on(monkeypatch):
    levels, kept = levels_of_search(monkeypatch, list(range(0, 48, 8)))
    assert levels == [3, 3, 1, 1, 1]  # the first has nothing to go on from, the second has seen no prediction come true
    assert min(kept) > 0.85


def test_a_sudden_stop_is_searched_for_again_from_where_the_gyroscope_expects_it(monkeypatch):
    levels, kept = levels_of_search(monkeypatch, [0, 14, 28, 42, 56, 56, 56])
    assert levels == [3, 3, 1, 1, 1, 3, 3]
    assert min(kept) > 0.9
