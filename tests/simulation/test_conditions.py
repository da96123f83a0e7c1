"""The conditions of a sequence are those of its recipe, and every one of them has a heading."""

from __future__ import annotations

import pytest

from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.recipe import load_split
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.tiny import TINY_SPLIT, make_split


def of(**changes: tuple[str, str]):
    text = TINY_SPLIT
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return conditions(make_split(text), "tiny-01")


STRESSED = 'difficulty = 3\ndisturbance = "blur"\nstrength = 2\ncalibration = "good"\n'


def test_conditions_are_named_and_every_class_is_text():
    varied = 'jerlov = "1C"\nlayer = { factor = 2.0 }\nplumes = { attenuation = 5.0 }'
    found = of(stressed=("duration_s", f"{STRESSED}duration_s"), water=('jerlov = "1C"', varied))
    assert found.keys() == CONDITIONS.keys()
    assert all(isinstance(found[key], str) for key in STRATA if key != "difficulty")
    assert (found["difficulty"], found["disturbance"], found["strength"]) == (3, "blur", 2)
    assert (found["path"], found["motion"]) == ("loop", "loop, calm")
    assert found["oysters_per_m2"] == pytest.approx(60 / 25)
    assert found["altitude_m"] == 0.9


def test_what_a_split_does_not_state_is_no_condition():
    stated = {"difficulty", "disturbance", "strength", "calibration", "layer_factor", "silt_per_m"}
    assert not stated & of().keys()


def test_water_is_classed_by_the_depth_at_which_a_disc_vanishes():
    classes = {}
    for secchi in (0.6, 2.0, 8.0):
        found = of(water=('jerlov = "1C"', f'jerlov = "1C"\nsecchi_m = {secchi}'))
        assert found["secchi_m"] == pytest.approx(secchi, rel=1e-3)
        classes[secchi] = found["water"]
    assert classes == {0.6: "turbid", 2.0: "murky", 8.0: "clear"}


@pytest.mark.parametrize(
    ("line", "light"),
    [
        ("wind_m_s = 0.0", "sun"),
        ("wind_m_s = 4.0", "sun with caustics"),
        ("sky_fraction = 0.9", "overcast"),
        ("daylight = 0.0", "dark"),
    ],
)
def test_light_is_classed_by_what_casts_shadows(line, light):
    assert of(light=("sun_elevation_deg = 50.0", f"sun_elevation_deg = 50.0\n{line}"))["light"] == light


def test_a_dense_reef_and_a_disturbed_vehicle_are_told_from_others():
    assert of()["density"] == "sparse"
    assert of(reef=("oysters = 60", "oysters = 600"))["density"] == "dense"
    assert of(reef=("oysters = 60", "oysters = 6"))["density"] == "bare"
    surge = of(site=("[sequence.path]", "[sequence.site]\nwave_height_m = 0.4\n\n[sequence.path]"))
    assert surge["motion"] == "loop, disturbed"


DRAWN = """
[[sequence.drawn]]
key = "path.speed_m_s"
between = [0.2, 0.4]

[[sequence.drawn]]
key = "reef.oysters"
between = [20, 24]

[sequence.path]"""


def test_conditions_of_a_public_split_are_of_the_values_that_it_draws():
    """They are those of the dive that is rendered, not those that the recipe states and replaces."""
    split = make_split(TINY_SPLIT.replace("\n[sequence.path]", DRAWN).replace("[20, 24]", "[200, 900]"))
    found, dive = conditions(split, "tiny-01"), build_sequence(split, "tiny-01", b"").recipe
    assert 200 <= dive.reef.oysters <= 900
    assert dive.path.speed_m_s != split.sequence[0].path.speed_m_s
    assert found["speed_m_s"] == round(dive.path.speed_m_s, 3)
    assert found["oysters_per_m2"] == round(dive.reef.oyster_count / 25, 3)
    assert found["density"] == ("dense" if dive.reef.oyster_count >= 375 else "sparse")


def test_what_a_hidden_split_draws_is_no_condition():
    """The recipe's own values are not those of the dive; a class that all values are in is known."""
    text = TINY_SPLIT.replace("\n[sequence.path]", DRAWN)
    stated = conditions(make_split(text), "tiny-01")
    known = conditions(make_split(f"hidden = true\n{text}"), "tiny-01")
    assert stated.keys() - known.keys() == {"speed_m_s", "oysters_per_m2"}
    assert known == {**{key: stated[key] for key in known}, "density": "bare"}


def test_a_class_that_drawn_values_leave_in_one_corner_of_their_ranges_is_no_condition():
    """20 oysters on 4.6 m are a bare reef, as 24 on 5 m are; 24 on 4.6 m are more than one on a square metre."""
    text = TINY_SPLIT.replace("\n[sequence.path]", DRAWN)
    text = text.replace("path.speed_m_s", "reef.size_m").replace("[0.2, 0.4]", "[4.6, 5.0]")
    found = conditions(make_split(f"hidden = true\n{text}"), "tiny-01")
    assert not {"density", "oysters_per_m2"} & found.keys()


@pytest.mark.parametrize("name", ["slam-test", "seg-test", "steer-test"])
def test_conditions_of_a_hidden_split_are_those_that_its_recipe_tells_truly(name):
    split = load_split(name)
    for sequence in split.sequence:
        known, drawn = conditions(split, sequence.name), {one.key for one in sequence.drawn}
        assert {"water", "light", "density", "motion", "duration_s"} <= known.keys()
        assert ("speed_m_s" in known) == ("path.speed_m_s" not in drawn)
        assert ("altitude_m" in known) == ("path.altitude_m" not in drawn)
