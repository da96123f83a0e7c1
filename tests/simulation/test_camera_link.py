"""Cameras that adapt, repeat and pass a video link: files are the same however they are made."""

from __future__ import annotations

import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.recipe import load_split, vary_split
from oysterbench.simulation.generate import generate_split

SPLIT = vary_split(
    load_split("slam-mini"),
    {
        "duration_s": 2.0,
        "reef.oysters": 100,
        "reef.size_m": 6.0,
        "light.daylight": 0.01,
        "camera.width": 96,
        "camera.height": 64,
        "camera.rate_hz": 4.0,
        "camera.layer_rate_hz": 0.0,
        "camera.auto_exposure": True,
        "camera.auto_balance": True,
        "camera.readout_ms": 20.0,
        "camera.repeats": 0.3,
        "camera.video_mbit_s": 0.05,
        "camera.aperture_mm": 2.0,
        "camera.port_spots": 5,
        "camera.hot_pixels": 300.0,
    },
    "test",
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return generate_split(SPLIT, tmp_path_factory.mktemp("link"))[SPLIT.sequence[0].name]


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_number_of_workers(path, tmp_path):
    (other,) = generate_split(SPLIT, tmp_path, workers=2).values()
    assert other.read_bytes() == path.read_bytes()


def test_the_truth_says_how_frames_were_taken(path):
    sequence = oysterbench.open(path)
    images = list(sequence.images("cam_front"))
    assert sequence.cameras["cam_front"].readout_s == 0.02
    taken = sequence.taken()
    with pytest.raises(MethodError, match="taken"):
        sequence.for_method().taken()
    assert taken["stamp_ns"].tolist() == [image.stamp_ns for image in images]
    assert taken["exposure_ms"].between(0.05, 25.0).all()
    by_stamp = {image.stamp_ns: image.pixels for image in images}
    for stamp, shown in zip(taken["stamp_ns"], taken["shown_ns"], strict=True):
        assert (by_stamp[stamp] == by_stamp[shown]).all()
