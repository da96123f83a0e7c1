"""What a sequence file says of itself is about the sequence as it was rendered, with its drawn values."""

from __future__ import annotations

import json

import pytest

import oysterbench
from oysterbench.core.errors import RecipeError
from oysterbench.recipe import CLASSES, REEF_CLASSES, load_split, parse_split, split_names
from oysterbench.sensors.pressure import density
from oysterbench.sequence.write import pack
from oysterbench.simulation.assembly import assemble
from oysterbench.simulation.jobs import Job
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

PATH = "\n[sequence.path]"
SALT = b"a salt"


def drawing(key, low, high, split=TINY_SPLIT):
    """A split, on a rig with a pressure sensor, whose dive draws one value."""
    drawn = f'\n[[sequence.drawn]]\nkey = "{key}"\nbetween = [{low}, {high}]\n'
    return parse_split(split.replace(PATH, drawn + PATH), "tiny.toml", rig_source=TINY_RIG + "[pressure]\n")


def assembled(split, folder):
    """The file of the split's dive, of which nothing was measured."""
    (folder / Job("tiny-01").part).write_bytes(pack([], {}, {"oysters.csv": b""}))
    path = folder / "tiny-01.mcap"
    assemble(split, split.sequence[0], folder, path, "digest", SALT, ["/imu", "/pressure"])
    return oysterbench.open(path)


def test_a_calibration_is_that_of_the_drawn_water(tmp_path):
    split = drawing("site.salinity_ppt", 35.0, 40.0)
    drawn = split.drawn(split.sequence[0], SALT)
    assert density(drawn.site) != density(split.sequence[0].site)
    assert assembled(split, tmp_path).pressure_calibration.density == pytest.approx(density(drawn.site), abs=1e-3)


def test_classes_are_those_of_the_drawn_life(tmp_path):
    classes = assembled(drawing("life.fish", 2, 4), tmp_path).attachments["classes.json"]
    assert json.loads(classes) == {str(number): name for number, name in CLASSES.items()}


def test_a_dive_that_draws_nothing_of_the_water_or_of_life_is_what_it_states(tmp_path):
    sequence = assembled(drawing("path.speed_m_s", 0.2, 0.4), tmp_path)
    site = drawing("path.speed_m_s", 0.2, 0.4).sequence[0].site
    assert sequence.pressure_calibration.density == pytest.approx(density(site), abs=1e-3)
    assert json.loads(sequence.attachments["classes.json"]) == {str(k): name for k, name in REEF_CLASSES.items()}


@pytest.mark.parametrize("name", split_names())
def test_calibration_and_classes_of_released_splits_do_not_depend_on_the_draw(name):
    """All that `calibrate_rig` and the list of classes depend on, besides the streams, is stated."""
    split = load_split(name)
    for stated in split.sequence:
        drawn = split.drawn(stated, SALT)
        assert split.rig_of(drawn) == split.rig_of(stated)
        assert drawn.life.moves == stated.life.moves
        assert (drawn.site, drawn.calibration) == (stated.site, stated.calibration)


def test_reefs_for_steering_draw_no_life():
    task = "[steering]\nyaw_deg = [30, 0, -30]\npitch_deg = [-15, 0, 15]\naltitude_m = [0.5, 1.5]\n\n[[sequence]]"
    steering = TINY_SPLIT.replace('track = "slam"', 'track = "steering"').replace("[[sequence]]", task)
    assert drawing("path.speed_m_s", 0.2, 0.4, steering).steering is not None
    with pytest.raises(RecipeError, match=r"key 'sequence\.life': expected nothing that moves"):
        drawing("life.fish", 0, 4, steering)
