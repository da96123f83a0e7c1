"""The standard splits: that they are what the design says, that no two sequences are alike, that all can be built."""

from __future__ import annotations

import itertools
import json
import re

import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import stream
from oysterbench.recipe import as_plain, count, load_split, parse_split, split_names
from oysterbench.report.recipes import sequences_table
from oysterbench.simulation.conditions import conditions
from tests.helpers.paths import DATASETS

TRACKS = {"slam": "slam", "seg": "segmentation", "steer": "steering"}
SPLITS = {
    "slam-mini": (1, 400),
    "slam-train": (10, 26_400),
    "slam-val": (8, 29_600),
    "slam-test": (10, 37_000),
    "slam-stress": (64, 76_800),
    "seg-mini": (2, 40),
    "seg-train": (24, 1_920),
    "seg-val": (8, 480),
    "seg-test": (10, 600),
    "seg-closeup": (16, 96),
    "seg-quadrat": (10, 60),
    "seg-reefview": (10, 60),
    "seg-random": (12, 108),
    "steer-mini": (2, 40),
    "steer-train": (20, 4_000),
    "steer-val": (10, 500),
    "steer-test": (10, 500),
}
"""Name -> sequences, and frames of all cameras."""

SEQUENCES = [
    (name, sequence.name)
    for name in SPLITS
    for sequence in load_split(name).sequence
    if sequence.strength in (0, 3)  # of a disturbance the strongest
]


def frames(split):
    return sum(count(q.duration_s, camera.rate_hz) for q in split.sequence for camera in split.rig.camera)


def test_the_splits_are_those_of_the_design():
    assert set(split_names()) == set(SPLITS)


@pytest.mark.parametrize("name", SPLITS)
def test_a_split_has_its_sequences_and_frames(name):
    split = load_split(name)
    assert split.name == name
    assert split.version == "1.0"
    assert split.track == TRACKS[name.split("-")[0]]
    assert (len(split.sequence), frames(split)) == SPLITS[name]
    kind = name.split("-")[-1]
    if kind == "stress":
        return
    assert [q.name for q in split.sequence] == [f"{kind}-{k + 1:02d}" for k in range(len(split.sequence))]


def test_each_split_has_a_seed_of_its_own():
    seeds = [load_split(name).seed for name in SPLITS]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize("track", TRACKS)
def test_no_two_sequences_of_a_track_are_stated_alike(track):
    """Other seeds aside: two sequences differ in water, light, reef or motion."""
    stated = {}
    for name in SPLITS:
        for sequence in load_split(name).sequence if name.startswith(track) else ():
            if sequence.same_dive_as:
                continue
            table = as_plain(sequence)
            del table["name"], table["duration_s"]
            stated[name, sequence.name] = table
    for one, other in itertools.combinations(stated, 2):
        differing = [
            key for key in ("reef", "water", "light", "path", "site") if stated[one][key] != stated[other][key]
        ]
        assert len(differing) >= 2, f"{one} and {other} differ in {differing} only"


@pytest.mark.parametrize("name", ["slam-train", "slam-val", "slam-test"])
def test_slam_splits_climb_from_calm_and_exactly_calibrated_to_all_at_once(name):
    split = load_split(name)
    rows = [conditions(split, sequence.name) for sequence in split.sequence]
    assert [row["difficulty"] for row in rows] == sorted(row["difficulty"] for row in rows)
    assert {row["difficulty"] for row in rows} == {1, 2, 3, 4, 5}
    calm, *_, hardest = split.sequence
    assert (calm.calibration, calm.life.moves, calm.water.plumes.attenuation) == ("exact", False, 0.0)
    assert (hardest.calibration, hardest.life.moves) == ("poor", True)
    assert hardest.water.plumes.attenuation > 0 < hardest.light.lamps
    secchi = [row["secchi_m"] for row in rows]
    assert max(secchi) > 8 > 2.1 > min(secchi)
    assert {row["light"] for row in rows} >= {"sun", "sun with caustics", "overcast"}
    assert {"lawnmower", "inspection", "loop", "free"} <= {row["path"] for row in rows}
    assert {q.reef.bottom for q in split.sequence} >= {"sand", "mud", "shell"}
    at_rest = [q for q in split.sequence if q.path.rest_s >= 3.0]
    assert len(at_rest) >= len(split.sequence) / 2, "as logs begin"


def test_four_dives_to_compare_on_are_of_real_length():
    assert sum(q.duration_s >= 300.0 for q in load_split("slam-val").sequence) >= 4


def test_the_stress_split_has_each_disturbance_at_three_strengths_of_the_same_dive():
    calm, *others = load_split("slam-stress").sequence
    assert (calm.name, calm.disturbance, calm.strength) == ("calm", "", 0)
    assert {other.same_dive_as for other in others} == {"calm"}
    strengths: dict[str, list[int]] = {}
    for other in others:
        strengths.setdefault(other.disturbance, []).append(other.strength)
        assert other.name == f"{other.disturbance.lower().replace(' ', '-')}-{other.strength}"
    assert set(map(tuple, strengths.values())) == {(1, 2, 3)}
    text = (DATASETS / "README.md").read_text()
    assert [name for name in strengths if f"| {name} |" not in text] == []


@pytest.mark.parametrize("name", ["seg-train", "seg-val", "seg-test"])
def test_seg_splits_span_the_grid(name):
    split = load_split(name)
    rows = [conditions(split, sequence.name) for sequence in split.sequence]
    assert max(row["secchi_m"] for row in rows) > 8
    assert min(row["secchi_m"] for row in rows) < 2.1
    assert {row["light"] for row in rows} >= {"sun", "overcast", "lamps"}
    assert min(row["oysters_per_m2"] for row in rows) == 0, "pictures without an oyster"
    assert max(row["oysters_per_m2"] for row in rows) > 100
    altitudes = [sequence.path.altitude_m for sequence in split.sequence]
    assert max(altitudes) >= 2 * min(altitudes)


@pytest.mark.parametrize("name", [name for name in SPLITS if name.startswith("seg")])
def test_every_picture_of_a_seg_split_has_its_truth(name):
    for camera in load_split(name).rig.camera:
        assert camera.layer_rate_hz == camera.rate_hz
        assert {"depth", "class", "instance", "visibility"} <= set(camera.sent_layers)


@pytest.mark.parametrize("name", [name for name in SPLITS if name.startswith("steer")])
def test_every_picture_of_a_steer_split_has_its_masks(name):
    (camera,) = load_split(name).rig.camera
    assert camera.layer_rate_hz == camera.rate_hz
    assert set(camera.sent_layers) == {"class", "instance"}
    assert 15 <= camera.pitch_deg <= 25


def test_hidden_slam_sequences_state_no_way_that_could_be_flown_blindly():
    """What the text says of a survey's lines is drawn from ranges, with the salt."""
    for sequence in load_split("slam-test").sequence:
        drawn = {item.key: item.between for item in sequence.drawn}
        assert drawn["path.speed_m_s"][1] > 1.2 * drawn["path.speed_m_s"][0]
        if sequence.path.kind in ("lawnmower", "transect"):
            assert drawn["path.heading_deg"] == (-180, 180)
            assert drawn["path.length_m"][1] > 1.4 * drawn["path.length_m"][0]
        assert not sequence.path.waypoints
        assert not sequence.path.spots_m


@pytest.mark.parametrize("name", [name for name in SPLITS if name != "slam-stress"])
def test_the_readme_tells_of_every_sequence(name):
    text = (DATASETS / "README.md").read_text()
    section = text.split(f"### {name}\n", 1)[1].split("\n### ")[0]
    for sequence in load_split(name).sequence:
        row = next(line for line in section.splitlines() if line.startswith(f"| {sequence.name} "))
        assert (sequence.water.type or sequence.water.jerlov) in row
        assert f"| {sequence.path.kind}" in row


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sequence"), SEQUENCES, ids=lambda value: value)
def test_every_sequence_can_be_built(name, sequence):
    """World and way; those of hidden splits with three salts, as the real one is not here."""
    from oysterbench.simulation.simulated_sequence import build_sequence

    split = load_split(name)
    salts = [stream(1, b"", "salt", k).bytes(32) for k in range(3)] if split.hidden else [b""]
    for salt in salts:
        simulated = build_sequence(split, sequence, salt)
        assert len(simulated.world.instances) < 2**16 - 1
        assert simulated.path.duration_s == simulated.recipe.duration_s


DEFAULTS = """
name = "short"
version = "1.0"
track = "slam"
seed = 1
rig = "bluerov2"
summary = "s"

[defaults]
duration_s = 5.0
water = { type = "1C", snow_per_m3 = 100.0 }
light = { sun_elevation_deg = 50.0, sun_azimuth_deg = 0.0 }

[defaults.reef]
size_m = 10.0
depth_m = 4.0
relief_rms_m = 0.1
oysters = 10

[defaults.path]
kind = "free"
extent_m = 5.0
speed_m_s = 0.3
altitude_m = 1.0

[[sequence]]
name = "a"

[[sequence]]
name = "b"
duration_s = 7.0
water = { type = "7C" }

[sequence.reef]
oysters = 20
"""


def test_a_sequence_states_what_differs_from_the_defaults():
    a, b = parse_split(DEFAULTS, "short.toml").sequence
    assert (a.duration_s, b.duration_s) == (5.0, 7.0)
    assert (a.water.type, b.water.type) == ("1C", "7C")
    assert b.water.snow_per_m3 == 100.0, "the rest of a table stays"
    assert (a.reef.oysters, b.reef.oysters, b.reef.size_m) == (10, 20, 10.0)


def test_defaults_change_no_digest():
    """Written out or shared, the same values make the same bytes."""
    split = parse_split(DEFAULTS, "short.toml")
    written = DEFAULTS.replace("[defaults]\n", "[defaults]\nsite = { temperature_c = 20.0 }\n")
    assert parse_split(written, "short.toml").digest() == split.digest()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[defaults]\n", "[defaults]\nname = 'x'\n", "key 'defaults': expected a table of keys of a sequence"),
        ("snow_per_m3 = 100.0", "snow_per_m3 = -1.0", r"key 'sequence\.water\.snow_per_m3': expected 0 to 50000"),
        ("relief_rms_m", "relief", r"unknown key 'sequence\.reef\.relief'"),
        ('name = "a"\n', 'name = "a"\ndrawn = [{ key = "path.speed", between = [0.1, 0.2] }]\n', "key 'drawn'"),
        ('name = "a"\n', 'name = "a"\ndrawn = [{ key = "path.kind", between = [0.1, 0.2] }]\n', "key 'drawn'"),
        ('name = "a"\n', 'name = "a"\ndrawn = [{ key = "path.speed_m_s", between = [0.3, 0.2] }]\n', "key 'drawn'"),
        (
            'name = "a"\n',
            'name = "a"\ndrawn = [{ key = "path.extent_m", between = [4.0, 40.0] }]\n',
            r"sequence a: key 'path\.extent_m': the path leaves the reef",
        ),
    ],
)
def test_bad_defaults_and_draws_are_named(old, new, message):
    assert old in DEFAULTS
    with pytest.raises(RecipeError, match=message) as raised:
        parse_split(DEFAULTS.replace(old, new), "short.toml")
    assert "short.toml" in str(raised.value)


def test_the_sequences_of_a_split_are_listed_with_what_they_are_like_and_take():
    shown = json.loads(CliRunner().invoke(main, ["splits", "slam-val", "--json"], catch_exceptions=False).stdout)
    assert [row["sequence"] for row in shown["sequences"]] == [q.name for q in load_split("slam-val").sequence]
    assert all(row["cpu_estimated_s"] > 60 for row in shown["sequences"])
    assert all(row["secchi_m"] > 0 for row in shown["sequences"])


def test_an_unknown_split_to_list_is_named():
    found = CliRunner().invoke(main, ["splits", "slam-maxi"])
    assert found.exit_code != 0
    assert "slam-maxi" in str(found.exception) + found.output


@pytest.mark.parametrize(
    ("name", "told"), [("slam-mini", r"about \d+\.\d minutes on"), ("slam-val", r"\d+\.\d hours on")]
)
def test_the_time_of_rendering_is_told_in_a_unit_that_suits_it(name, told):
    assert re.search(told, sequences_table(load_split(name)).notes[0])


def test_a_recipe_that_rendering_would_refuse_for_its_cameras_is_not_listed(tmp_path):
    rig = (DATASETS / "rigs" / "survey-stereo.toml").read_text()
    for folder, text in ((tmp_path / "outside", rig), (tmp_path / "inside", _at_the_middle(rig))):
        folder.mkdir()
        (folder / "mine.toml").write_text(text.replace('name = "survey-stereo"', 'name = "mine"'))
        recipe = (DATASETS / "splits" / "slam-mini.toml").read_text()
        named = recipe.replace('rig = "bluerov2"', 'rig = "mine.toml"').replace('name = "slam-mini"', 'name = "reef"')
        (folder / "reef.toml").write_text(named)
    done = CliRunner().invoke(main, ["splits", str(tmp_path / "outside" / "reef.toml")])
    assert done.exit_code == 0, done.stderr
    failed = CliRunner().invoke(main, ["splits", str(tmp_path / "inside" / "reef.toml")])
    assert failed.exit_code == 1
    assert "split reef: sequence mini-01: camera cam_left: key 'camera.position_m': expected a place" in failed.stderr


def _at_the_middle(rig):
    """A rig whose first camera sits in the middle of the vehicle."""
    before, name, after = rig.partition("[[camera]]")
    return before + name + re.sub(r"position_m = .*", "position_m = [0.0, 0.0, 0.0]", after, count=1)
