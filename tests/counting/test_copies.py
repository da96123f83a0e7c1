"""Copies are told of, and pictures that only look alike are not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from oysterbench.core.streams import stream
from oysterbench.counting.copies import Copies, thumbnail

SIZE = (480, 640)


def ground(seed: int = 0):
    """(480, 640, 3) of a bottom with detail of all sizes, grey levels around 120."""
    draw = stream(seed, b"", "ground")
    levels = np.zeros(SIZE, np.float32)
    for k in (1, 2, 4, 8, 16):
        coarse = draw.standard_normal((6 * k, 8 * k)).astype(np.float32)
        levels += (40 / k) * np.asarray(cv2.resize(coarse, SIZE[::-1]))
    return levels[..., None] / 2 + np.array([110, 125, 120], np.float32)


def taken(scene, number: int, light: float = 0.0):
    """A picture of it: noise of a camera (2 grey levels), and light that waves change."""
    noise = 2.0 * stream(1, b"", "noise", number).standard_normal(scene.shape)
    return np.clip(np.round(scene * (1 + light) + noise), 0, 255).astype(np.uint8)


def as_jpeg(pixels, quality: int):
    done, data = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return np.ascontiguousarray(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[..., ::-1])


def found(*pictures):
    """Copies among pictures, each with the name of its file."""
    copies = Copies()
    for name, pixels in pictures:
        copies.picture(name, Path(name), pixels.shape[:2], thumbnail(pixels))
    return copies.found


@pytest.mark.parametrize("quality", [85, 90, 95])
def test_a_png_and_a_jpeg_of_one_picture_are_copies(quality):
    pixels = taken(ground(), 0)
    assert found(("a.png", pixels), ("b.JPG", as_jpeg(pixels, quality))) == [("b.JPG", "a.png")]
    assert found(("b.jpeg", as_jpeg(pixels, quality)), ("a.tif", pixels)) == [("a.tif", "b.jpeg")]


def test_frames_of_a_video_that_hovers_are_no_copies():
    """Of one format they are not compared: noise alone may differ."""
    frames = [taken(ground(), k) for k in range(10)]
    assert found(*((f"{k}.png", frame) for k, frame in enumerate(frames))) == []
    assert found(*((f"{k}.jp{'e' * (k % 2)}g", as_jpeg(frame, 90)) for k, frame in enumerate(frames))) == []


def test_frames_in_two_formats_of_a_bottom_that_moves_or_whose_light_does_are_no_copies():
    scene = ground()
    still, lit, moved = taken(scene, 0), taken(scene, 1, light=0.003), taken(np.roll(scene, 2, axis=1), 2)
    assert found(("still.png", still), ("lit.jpg", as_jpeg(lit, 90)), ("moved.tif", moved)) == []


def test_what_shows_nothing_and_what_has_another_size_is_not_compared():
    dark = np.full((*SIZE, 3), 3, np.uint8)
    assert found(("a.png", dark), ("b.jpg", dark)) == []
    pixels = taken(ground(), 0)
    assert found(("a.png", pixels), ("b.jpg", as_jpeg(pixels, 90)[:-8])) == []


def test_each_of_many_pictures_finds_its_own():
    pictures = [(k, taken(ground(k), k)) for k in range(8)]
    files = [(f"{k}.png", pixels) for k, pixels in pictures] + [(f"{k}.jpg", as_jpeg(p, 90)) for k, p in pictures]
    assert found(*files) == [(f"{k}.jpg", f"{k}.png") for k in range(8)]
