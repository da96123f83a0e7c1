"""Smaller sequence files: what they have, and what they say of what they lack."""

from __future__ import annotations

import tomllib
from importlib import resources

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import TF_STATIC
from oysterbench.recipe.rig import read_rig
from oysterbench.sensors.registry import rig_sensors, sensor_kinds
from oysterbench.sequence.cut import cut_to, is_public
from oysterbench.sequence.truth import rig_topics

RIGS = sorted(path.name for path in (resources.files("oysterbench_datasets") / "rigs").iterdir())


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


@pytest.mark.parametrize("name", RIGS)
def test_a_hidden_split_shows_every_measurement_of_every_shipped_rig(name):
    """And nothing else: whatever the sensors are called, a method gets them as on a public split."""
    source = (resources.files("oysterbench_datasets") / "rigs" / name).read_text()
    rig = read_rig(tomllib.loads(source), name)
    measured = {
        f"/{kind.name_of(recipe)}/{leaf}".removesuffix("/") for kind, recipe in rig_sensors(rig) for leaf in kind.leaves
    }
    assert {topic for topic in rig_topics(rig) if is_public(topic)} == {TF_STATIC, *measured}


@pytest.mark.parametrize("block", sorted(sensor_kinds()))
def test_a_sensor_named_like_its_kind_is_shown_in_a_hidden_split(block):
    kind = sensor_kinds()[block]
    assert all(is_public(f"/{block}/{leaf}".removesuffix("/")) for leaf in kind.leaves)
    assert not any(is_public(f"/{block}/{leaf}") for leaf in kind.truth_leaves)


def test_only_topics_of_its_own_are_shown_of_a_sensor_that_a_rig_has_once():
    assert not is_public("/imu/range")
    assert not is_public("/dvl/image")
    assert not is_public("/other/velocity")
