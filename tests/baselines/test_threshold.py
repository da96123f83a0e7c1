"""The rule of colour on pictures of any size."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench_baselines.threshold.method import WIDEST, ColourSettings, probability


def test_a_large_picture_is_blurred_no_longer_than_a_small_one_and_gets_the_same_answer(monkeypatch):
    small = np.full((200, WIDEST, 3), 60, np.uint8)
    cv2.circle(small, (300, 100), 40, (220, 210, 180), -1)
    expected = probability(small, ColourSettings()) > 0.5
    large = cv2.resize(small, (3 * WIDEST, 600), interpolation=cv2.INTER_NEAREST)
    widths, blur = [], cv2.GaussianBlur

    def watched(pixels, *arguments, **options):
        widths.append(pixels.shape[1])
        return blur(pixels, *arguments, **options)

    monkeypatch.setattr("cv2.GaussianBlur", watched)
    found = probability(large, ColourSettings())
    assert set(widths) == {WIDEST}
    assert found.shape == large.shape[:2]
    assert np.mean((found[1::3, 1::3] > 0.5) != expected) < 0.005
    assert expected.mean() > 0.02
