"""Recipes: every bad value is refused with file, key, value and what is allowed."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import as_plain, load_split, parse_split, split_names, vary_split
from oysterbench.recipe.rig import read_rig, vary_rig
from oysterbench.sensors.imu import ImuRecipe
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT, make_split


def test_every_split_that_comes_with_oysterbench_is_valid():
    names = split_names()
    assert "slam-mini" in names
    for name in names:
        assert load_split(name).name == name


def test_the_mini_split_is_what_its_users_expect():
    split = load_split("slam-mini")
    (sequence,) = split.sequence
    (camera,) = split.rig.camera
    assert sequence.duration_s == 20
    assert sequence.reef.oysters >= 1000
    assert 25 <= camera.pitch_deg <= 35
    assert (camera.rate_hz, split.rig.of(ImuRecipe)[0].rate_hz, split.rig.truth_rate_hz) == (20, 200, 200)


def test_a_recipe_can_be_read_from_a_path(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "bluerov2"'))
    assert load_split(str(path)).rig.name == "bluerov2"


def test_recipes_and_rigs_may_begin_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "small.toml"'), encoding="utf-8-sig")
    (tmp_path / "small.toml").write_text(TINY_RIG, encoding="utf-8-sig")
    assert load_split(str(path)).source.startswith("\nname")


def test_a_rig_may_lie_beside_its_recipe(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TINY_SPLIT.replace('rig = "tiny"', 'rig = "small.toml"'))
    with pytest.raises(RecipeError, match=r"key 'rig': there is no rig 'small\.toml'"):
        load_split(str(path))
    (tmp_path / "small.toml").write_text(TINY_RIG)
    assert load_split(str(path)).rig.name == "tiny"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "depth_m = 3.0",
            "depth_m = -3.0",
            r"tiny\.toml: key 'sequence\.reef\.depth_m': expected 0\.5 to 60, got -3\.0",
        ),
        ('jerlov = "1C"', 'jerlov = "4C"', r"key 'sequence\.water\.jerlov': expected one of I, IA.*got '4C'"),
        ("oysters = 60", "oysters = 6.5", r"key 'sequence\.reef\.oysters': expected a whole number .*got 6\.5"),
        ("oysters = 60", "oysters = true", r"expected a whole number .*got True"),
        ("oysters = 60", "", r"'reef\.oysters', 'reef\.density_per_m2': expected exactly one of them, got neither"),
        ("oysters = 60", "oysters = 60\ndensity_per_m2 = 9", r"expected exactly one of them, got oysters and density"),
        ("oysters = 60", "density_per_m2 = -1", r"'sequence\.reef\.density_per_m2': expected 0 to 1000, got -1"),
        ("oysters = 60", 'oysters = 60\nbottom = "tar"', r"expected one of sand, mud, gravel, shell, got 'tar'"),
        ("oysters = 60", "oysters = 60\nsilt = 1.5", r"'sequence\.reef\.silt': expected 0 to 1, got 1\.5"),
        (
            "oysters = 60",
            "oyster = 60",
            r"unknown key 'sequence\.reef\.oyster'; did you mean oysters or .*known keys here: size_m",
        ),
        ("altitude_m = 0.9", "altitude_m = 3.0", r"the vehicle would leave the water.*got 3"),
        ("radius_m = 1.0", "radius_m = 2.4", r"the path leaves the reef; expected at most 1\.88.*got 2\.4"),
        ('track = "slam"', 'track = "swim"', r"key 'track': expected one of slam, segmentation, steering, got 'swim'"),
        ("seed = 5", 'seed = "five"', r"key 'seed': expected a whole number .*got 'five'"),
        ("seed = 5", "seed = nan", r"expected a whole number .*got nan"),
        ("depth_m = 3.0", "depth_m = nan", r"expected 0\.5 to 60, got nan"),
        ('name = "tiny-01"', 'name = "../x"', r"key 'sequence\.name': expected at most 100 of letters.*got '\.\./x'"),
        ('name = "tiny"', 'name = "r\u00e9cif"', r"key 'name': expected .*\(a to z, no accents\), got 'r\u00e9cif'"),
        (
            'name = "tiny-01"',
            f'name = "{"x" * 300}"',
            r"key 'sequence\.name': expected at most 100 of letters.*got 'x+$",
        ),
        (
            'version = "1.0"',
            'version = "../../../x"',
            r"key 'version': expected a letter or digit.*got '\.\./\.\./\.\./x'",
        ),
        ("[[sequence]]", "[sequence]", r"key 'sequence': expected a list of tables, \[\[sequence\]\], got one table$"),
        ("duration_s = 2.5", 'duration_s = 2.5\nsame_dive_as = "zz"', r"which this split does not have; got 'zz'"),
        ("[sequence.water]", "[sequence.wine]", r"unknown key 'sequence\.wine'"),
        ('rig = "tiny"', "rig = 3", r"key 'rig': expected the name of a file in datasets/rigs.*got 3"),
        ("seed = 5", "seed = = 5", r"not valid TOML"),
    ],
)
def test_a_bad_value_is_named(old, new, message):
    assert old in TINY_SPLIT
    with pytest.raises(RecipeError) as caught:
        make_split(TINY_SPLIT.replace(old, new))
    assert re.search(message, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


def test_layers_come_at_a_divisor_of_the_camera_rate():
    with pytest.raises(RecipeError, match="expected a divisor of rate_hz = 10"):
        parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG.replace("layer_rate_hz = 2.0", "layer_rate_hz = 3.0"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("max_range_m = 65.6", r"'camera\.max_range_m': expected at most 65\.5 beside the layer 'depth'.*got 65\.6"),
        ('layers = ["depth", "class", "depth"]', r"'camera\.layers': expected each layer once, got \['depth', 'class'"),
    ],
)
def test_layers_are_refused_that_a_file_cannot_hold(lines, message):
    with pytest.raises(RecipeError, match=message):
        parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG + lines)


def test_without_its_depth_a_camera_may_see_farther():
    rig = TINY_RIG + 'max_range_m = 100.0\nlayers = ["class"]'
    assert parse_split(TINY_SPLIT, "tiny.toml", rig_source=rig).rig.camera[0].max_range_m == 100.0


def test_an_unknown_split_and_rig_are_named_with_what_is_known():
    with pytest.raises(
        RecipeError, match=r"unknown split 'slam-maxi'; did you mean slam-mini or .*`oysterbench splits`"
    ):
        load_split("slam-maxi")
    with pytest.raises(RecipeError, match="there is no rig 'tiny'"):
        parse_split(TINY_SPLIT, "tiny.toml")
    with pytest.raises(RecipeError, match=r"absent\.toml: no such recipe"):
        load_split("absent.toml")


def test_of_many_sequences_those_alike_are_named_and_where_the_others_are():
    with pytest.raises(RecipeError) as caught:
        load_split("slam-stress").find_sequence("dusk-4")
    assert str(caught.value) == (
        "split slam-stress has no sequence 'dusk-4'; did you mean dusk-3 or dusk-2 or dusk-1? "
        "`oysterbench splits slam-stress` lists all 64"
    )
    with pytest.raises(RecipeError, match=r"no sequence '\?'; `oysterbench splits slam-stress` lists all 64$"):
        load_split("slam-stress").find_sequence("?")
    one = TINY_SPLIT[TINY_SPLIT.index("[[sequence]]") :]
    many = make_split(TINY_SPLIT + "".join(one.replace("tiny-01", f"tiny-{k:02}") for k in range(2, 12)))
    with pytest.raises(RecipeError, match=r"`oysterbench splits RECIPE\.toml` lists all 11$"):
        many.find_sequence("tiny-12")
    few = make_split(TINY_SPLIT + one.replace("tiny-01", "tiny-02"))
    with pytest.raises(RecipeError, match=r"no sequence 'tiny-12'; it has tiny-01, tiny-02$"):
        few.find_sequence("tiny-12")


def test_the_digest_follows_values_and_not_comments(tiny_split):
    assert make_split(TINY_SPLIT + "# a remark\n").digest() == tiny_split.digest()
    assert make_split(TINY_SPLIT.replace("seed = 5", "seed = 6")).digest() != tiny_split.digest()


def test_a_recipe_becomes_plain_values(tiny_split):
    plain = as_plain(tiny_split)
    assert plain["sequence"][0]["reef"]["oysters"] == 60
    assert plain["rig"]["camera"][0]["position_m"] == [0.18, 0.0, 0.0]


def test_a_split_can_be_varied_and_the_new_values_are_checked(tiny_split):
    varied = vary_split(tiny_split, {"water.jerlov": "5C", "camera.pitch_deg": 80.0, "duration_s": 1.0}, "gallery.toml")
    assert varied.sequence[0].water.jerlov == "5C"
    assert varied.sequence[0].duration_s == 1.0
    assert varied.rig.camera[0].pitch_deg == 80.0
    assert vary_split(tiny_split, {}, "same").sequence == tiny_split.sequence
    with pytest.raises(RecipeError, match=r"gallery\.toml: key 'reef\.depth_m': expected 0\.5 to 60, got -1"):
        vary_split(tiny_split, {"reef.depth_m": -1}, "gallery.toml")
    with pytest.raises(RecipeError, match=r"unknown key 'wine\.type'"):
        vary_split(tiny_split, {"wine.type": "red"}, "gallery.toml")


def test_lamps_can_be_varied_too(tiny_split):
    lit = parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG + "[[lamp]]\nintensity_cd = 100.0\n")
    assert vary_split(lit, {"lamp.intensity_cd": 5.0}, "gallery.toml").rig.lamp[0].intensity_cd == 5.0


def test_a_key_at_its_default_changes_no_digest(tiny_split):
    assert make_split(TINY_SPLIT.replace("oysters = 60", "oysters = 60\nsilt = 0.5")).digest() == tiny_split.digest()
    assert make_split(TINY_SPLIT.replace("oysters = 60", "oysters = 60\nsilt = 0.6")).digest() != tiny_split.digest()


def test_an_unknown_layer_is_named():
    with pytest.raises(RecipeError, match=r"key 'camera\.layers': expected one of depth, class.*got 'heat'"):
        parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG + 'layers = ["depth", "heat"]\n')


@pytest.mark.parametrize(("name", "message"), [("cam_front", "is taken"), ("dvl", "is taken"), ("my sonar", "letter")])
def test_a_sensor_name_is_good_for_topics_and_given_once(name, message):
    rig = TINY_RIG + f'[[sonar]]\nname = "{name}"\nrate_hz = 2.0\n'
    with pytest.raises(RecipeError, match=rf"rig tiny: key 'sonar\.name': .*{message}"):
        parse_split(TINY_SPLIT, "tiny.toml", rig_source=rig)


@pytest.mark.parametrize("key", ["sonar", "scanner", "altimeter", "dvl"])
def test_a_reach_that_ends_before_it_begins_is_refused(key):
    head = f"[{key}]\n" if key == "dvl" else f'[[{key}]]\nname = "ears"\nrate_hz = 2.0\n'
    rig = TINY_RIG + head + "min_range_m = 4.0\nmax_range_m = 3.0\n"
    with pytest.raises(RecipeError, match=rf"key '{key}\.max_range_m': expected more than min_range_m = 4, got 3"):
        parse_split(TINY_SPLIT, "tiny.toml", rig_source=rig)


PATH = TINY_SPLIT[TINY_SPLIT.index("[sequence.path]") :]
SHARED = "speed_m_s = 0.3\naltitude_m = 0.9\n"


def with_path(text):
    return make_split(TINY_SPLIT.replace(PATH, f"[sequence.path]\n{SHARED}{text}\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kind = "spiral"', r"'sequence\.path\.kind': expected one of loop, lawnmower.*got 'spiral'"),
        ('kind = "loop"', r"sequence tiny-01: missing key 'path\.radius_m', which kind = 'loop' needs"),
        ('kind = "waypoints"', r"missing key 'path\.waypoints', which kind = 'waypoints' needs"),
        (
            'kind = "waypoints"\nwaypoints = [[0, 0], [2.4, 0]]',
            r"'path\.waypoints': the path leaves the reef.*got 2\.4, 0",
        ),
        ('kind = "waypoints"\nwaypoints = [[0]]', r"expected \[x, y\], \[x, y, altitude\] or .*got \[0\.0\]"),
        ('kind = "waypoints"\nwaypoints = [[0, 0, -1]]', r"expected altitudes above 0 and up to 20, got -1"),
        ('kind = "waypoints"\nwaypoints = [0, 0]', r"'sequence\.path\.waypoints': expected a list, got 0"),
        (
            'kind = "lawnmower"\nlength_m = 3\nwidth_m = 3\nspacing_m = 0',
            r"'sequence\.path\.spacing_m': expected 0\.05 to 100, got 0",
        ),
        (
            'kind = "lawnmower"\nlength_m = 4\nwidth_m = 3\nspacing_m = 0.8',
            r"'path\.length_m': the path leaves the reef; expected x and y within -2\.38 and 2\.38.*got 2\.4, 1\.5",
        ),
        (
            'kind = "lawnmower"\nlength_m = 3\nwidth_m = 4\nspacing_m = 0.8\ncross = true',
            r"'path\.length_m': the path leaves the reef; .*got 1\.5, 2\.4",
        ),
        (
            'kind = "transect"\nlength_m = 4\nheading_deg = 45\ncentre_m = [1.0, 0.0]',
            r"the path leaves the reef.*got 2\.41, 1\.41",
        ),
        ('kind = "transect"\nlength_m = 3\nlook = "inward"', r"'path\.look': kind = 'transect' does not read it"),
        ('kind = "loop"\nradius_m = 1\nturn_rate_deg_s = 9', r"'path\.turn_rate_deg_s': kind = 'loop' does not read"),
        ('kind = "orbit"\nradius_m = 2\ncentre_m = [0.5, 0]', r"'path\.radius_m': .*expected at most 1\.88 .*got 2"),
        ('kind = "orbit"\nradius_m = 1\nrings = 2', r"missing key 'path\.spacing_m', which rings = 2 need"),
        (
            'kind = "orbit"\nradius_m = 1\nrings = 3\nspacing_m = 0.8',
            r"'path\.radius_m': the path leaves the reef; expected at most 0\.78",
        ),
        ('kind = "orbit"\nradius_m = 1\nlook = "up"', r"'sequence\.path\.look': expected one of along, inward"),
        ('kind = "inspection"\nstand_off_m = 3', r"'path\.stand_off_m': the path leaves the reef.*at most 2\.38"),
        ('kind = "inspection"\nspots_m = [[2.0, 0.0]]', r"'path\.stand_off_m': .*expected at most 0\.38.*got 0\.8"),
        ('kind = "inspection"\nspots_m = [[1.0]]', r"'path\.spots_m': expected pairs \[x, y\], got \[1\.0\]"),
        ('kind = "free"\nextent_m = 5', r"'path\.extent_m': the path leaves the reef; expected at most 4\.76"),
        ('kind = "free"\nextent_m = 4\nlift = 1', r"'sequence\.path\.lift': expected true or false, got 1"),
    ],
)
def test_a_bad_key_of_a_path_is_named(text, message):
    with pytest.raises(RecipeError) as caught:
        with_path(text)
    assert re.search(message, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


def rigged(changes):
    return make_split(TINY_SPLIT.replace("duration_s", f"rig = {changes}\nduration_s", 1))


def test_a_sequence_can_have_values_of_its_rig_otherwise(tiny_split):
    split = rigged("{ camera = { shutter_ms = 15.0 } }")
    assert {camera.shutter_ms for camera in split.rig_of(split.sequence[0]).camera} == {15.0}
    assert {camera.shutter_ms for camera in split.rig.camera} == {0.0}
    assert split.digest() != tiny_split.digest()
    assert hash(split) != hash(tiny_split)


def test_a_changed_grade_brings_its_values_along(tiny_split):
    split = rigged('{ imu = { grade = "high" } }')
    graded = split.rig_of(split.sequence[0]).of(ImuRecipe)[0]
    assert graded.gyro_noise_density < tiny_split.rig.of(ImuRecipe)[0].gyro_noise_density


def test_a_changed_grade_keeps_nothing_of_the_one_before(tiny_split):
    first = rigged('{ imu = { grade = "mems" } }')
    plain = as_plain(first.rig_of(first.sequence[0]))
    changed = vary_rig(read_rig(plain, "here"), {"imu": {"grade": "high"}}, "here").of(ImuRecipe)[0]
    split = rigged('{ imu = { grade = "high" } }')
    assert changed == split.rig_of(split.sequence[0]).of(ImuRecipe)[0]
    assert (changed.gyro_turn_on, changed.gyro_range, changed.accel_step) == (0.0, None, 0.0)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            "{ camera = { shutter_ms = -1.0 } }",
            r"tiny-01: rig tiny: key 'camera\.shutter_ms': expected 0 to 200, got -1",
        ),
        ("{ dvl = { rate_hz = 5.0 } }", r"key 'rig\.dvl': rig tiny has no such block; it has .*camera"),
        ('{ camera = { name = "other" } }', r"key 'rig\.camera': expected a table of keys of \[camera\], without name"),
        ("{ camera = 3 }", r"key 'rig\.camera': expected a table"),
        ("7", r"key 'sequence.rig': expected a table, got 7"),
    ],
)
def test_changes_of_a_rig_are_checked_as_a_rig_is(changes, told):
    with pytest.raises(RecipeError, match=told):
        rigged(changes)


def test_a_dive_can_be_had_again_with_one_thing_otherwise():
    split = make_split(TINY_SPLIT)
    base = split.sequence[0]
    again = dataclasses.replace(base, name="tiny-02", same_dive_as="tiny-01", disturbance="snow", strength=2)
    both = dataclasses.replace(split, sequence=(base, again))
    one, two = (build_sequence(both, name, b"") for name in ("tiny-01", "tiny-02"))
    assert np.array_equal(one.path.position.c, two.path.position.c)
    assert np.array_equal(one.world.instances.positions, two.world.instances.positions)
    with pytest.raises(RecipeError, match="tiny-03"):
        build_sequence(both, "tiny-03", b"")
    assert build_sequence(both, "tiny-02", b"") is two, "a wrong name costs nobody the one that was built"


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        (
            'same_dive_as = "other"',
            "key 'same_dive_as': expected another sequence that is a dive of its own, which this split does not have",
        ),
        ("strength = 2", "keys 'disturbance', 'strength': expected both or neither, got '' of strength 2"),
        ('disturbance = "snow"\nstrength = 4', "key 'sequence.strength': expected 0 to 3, got 4"),
        ("difficulty = 6", "key 'sequence.difficulty': expected 1 to 5, got 6"),
    ],
)
def test_a_difficulty_and_a_disturbance_are_checked(keys, told):
    with pytest.raises(RecipeError, match=told):
        make_split(TINY_SPLIT.replace("duration_s", f"{keys}\nduration_s", 1))


def test_a_key_of_defaults_that_a_kind_of_path_does_not_read_is_told_where_it_belongs():
    text = TINY_SPLIT.replace('kind = "loop"\nradius_m = 1.0', 'kind = "transect"\nlength_m = 2.0')
    with pytest.raises(RecipeError, match=r"'path\.radius_m': kind = .*A key in \[defaults\] is a key of every"):
        make_split(text.replace("[[sequence]]", "[defaults]\npath = { radius_m = 1.0 }\n\n[[sequence]]"))
