"""A dive among things that move, as its file tells of it: who, where, which pixels, and nothing of it to methods."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.recipe import CLASSES, parse_split
from oysterbench.sequence.cut import PUBLIC_ATTACHMENTS
from oysterbench.simulation.generate import generate_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

LAYERS = ("depth", "class", "instance", "dynamic", "flow")
RIG = TINY_RIG + f"layers = {list(LAYERS)}\n".replace("'", '"')
LIFE = """
[sequence.life]
schools = 1
school_size = 8
school_fish_cm = 8.0
fish = 2
crabs = 4
debris = 6
tether = true
sway = 1.0
surge_m = 0.1
"""
TEXT = TINY_SPLIT.replace("stones = 5\n", "stones = 5\nplant_cover = 0.1\n") + LIFE


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    split = parse_split(TEXT, "living.toml", RIG)
    return generate_split(split, tmp_path_factory.mktemp("alone"))["tiny-01"]


@pytest.fixture(scope="module")
def sequence(path):
    return oysterbench.open(path)


@pytest.mark.slow
def test_two_workers_make_the_same_bytes(path, tmp_path):
    split = parse_split(TEXT, "living.toml", RIG)
    other = generate_split(split, tmp_path, workers=2)["tiny-01"]
    assert hashlib.sha256(other.read_bytes()).digest() == hashlib.sha256(path.read_bytes()).digest()


def test_who_moves_is_told_once_and_where_at_each_stamp_of_the_layers(sequence):
    who, where = sequence.moving(), sequence.moving_poses()
    assert who["class"].value_counts().to_dict() == {"fish": 10, "debris": 6, "crab": 4, "tether": 1}
    assert who["id"].is_unique
    stamps = [image.stamp_ns for image in sequence.layer("cam_front", "instance")]
    assert sorted(where["stamp_ns"].unique()) == stamps
    assert all(set(rows["id"]) == set(who["id"]) for _, rows in where.groupby("stamp_ns"))
    assert np.allclose(np.linalg.norm(where[["qx", "qy", "qz", "qw"]], axis=1), 1, atol=1e-5)


def test_instances_of_what_moves_are_seen_where_they_are(sequence):
    """Every fish that is seen lies within its length of its place, by depth and pixel."""
    who, where = sequence.moving().set_index("id"), sequence.moving_poses().set_index(["stamp_ns", "id"])
    camera, truth = sequence.cameras["cam_front"], sequence.truth()
    planes = zip(*(sequence.layer("cam_front", name) for name in LAYERS), strict=True)
    seen = 0
    for depth, classes, instance, dynamic, flow in planes:
        assert np.all(dynamic.pixels[np.isin(classes.pixels, [8, 9, 10, 11, 4, 6])] == 1)
        assert np.all(dynamic.pixels[np.isin(classes.pixels, [0, 1, 2, 3])] == 0)
        assert np.array_equal(np.isnan(flow.pixels[..., 0]), classes.pixels == 0)
        k = int(np.searchsorted(truth.stamps_ns, depth.stamp_ns))
        T = truth.matrices[k] @ camera.T_base_cam
        for number in np.unique(instance.pixels):
            if number not in who.index or who.loc[number, "class"] not in ("fish", "crab", "debris"):
                continue
            rows, columns = np.nonzero(instance.pixels == number)
            z = depth.pixels[rows, columns]
            x = (columns - camera.matrix[0, 2]) / camera.matrix[0, 0] * z
            y = (rows - camera.matrix[1, 2]) / camera.matrix[1, 1] * z
            points = np.column_stack([x, y, z]) @ T[:3, :3].T + T[:3, 3]
            place = where.loc[(depth.stamp_ns, number), ["x", "y", "z"]].to_numpy(dtype=float)
            assert np.linalg.norm(points - place, axis=1).max() < 0.75 * who.loc[number, "size_m"] + 0.01
            assert CLASSES[int(classes.pixels[rows[0], columns[0]])] == who.loc[number, "class"]
            seen += 1
    assert seen > 5


def test_what_moves_is_no_oyster(sequence):
    assert set(sequence.moving()["id"]).isdisjoint(sequence.oysters()["id"])


def test_methods_are_told_nothing_of_it(sequence):
    method = sequence.for_method()
    for call in (method.moving, method.moving_poses):
        with pytest.raises(MethodError, match="may not see the ground truth"):
            call()
    topics = [topic for topic, _, _ in method.contents()]
    assert not any(topic.endswith(("dynamic", "flow")) for topic in topics)
    assert not any("moving" in name for name in PUBLIC_ATTACHMENTS)


def test_a_dive_without_life_says_so(tmp_path):
    split = parse_split(TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 1.0"), "still.toml", TINY_RIG)
    sequence = oysterbench.open(generate_split(split, tmp_path)["tiny-01"])
    assert sequence.moving().empty
    assert sequence.moving_poses().empty
    assert b"fish" not in sequence.attachments["classes.json"]


def test_reefs_for_steering_have_no_life():
    text = TEXT.replace('track = "slam"', 'track = "steering"')
    with pytest.raises(RecipeError, match=r"key 'sequence.life': expected nothing that moves|steering"):
        parse_split(text, "steer.toml", RIG)
