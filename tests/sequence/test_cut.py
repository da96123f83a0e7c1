"""Smaller sequence files: what they have, and what they say of what they lack."""

from __future__ import annotations

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.sequence.cut import cut_to


def test_a_smaller_file_has_the_sensors_of_its_topics_and_no_others(dive_file, tmp_path):
    """Though it has the calibration of the whole rig."""
    whole = oysterbench.open(dive_file)
    cut_to(tmp_path / "some.mcap", dive_file, ["/cam_left/image", "/dvl/velocity", "/truth/odometry"])
    some = oysterbench.open(tmp_path / "some.mcap")
    assert list(some.cameras) == ["cam_left"]
    assert len(whole.cameras) > 1
    assert some.sonars == {}
    assert some.pressure_calibration is None
    assert len(list(some.images("cam_left"))) == len(list(whole.images("cam_left")))
    for read, why in (
        (lambda: some.images("cam_right"), "no camera 'cam_right'; cameras: cam_left"),
        (lambda: some.imu(), "has no /imu: it has some of the topics only"),
        (lambda: some.dvl(), "has no /dvl/beams and /dvl/altitude: it has some of the topics only"),
        (lambda: some.pressure(), "has no pressure"),
    ):
        with pytest.raises(SequenceError, match=why):
            read()
