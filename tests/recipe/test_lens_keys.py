"""Lenses that no picture can be rendered with are refused with the recipe, before anything is rendered."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import parse_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

FOLDED = 'hfov_deg = 60\nlens = "brown-conrady"\ndistortion = [-5.0, 0, 0, 0]'


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("hfov_deg = 97\nport_mm = 10", "'camera.hfov_deg': expected at most 96 behind a flat port.*got 97$"),
        (FOLDED, "'camera.distortion': the lens folds its image over before the edge of 64 x 48 px"),
    ],
)
def test_a_lens_without_a_ray_for_every_pixel_is_refused_with_the_recipe(keys, told):
    with pytest.raises(RecipeError, match=rf"^rig tiny: camera cam_front: key {told}"):
        parse_split(TINY_SPLIT, "tiny.toml", TINY_RIG.replace("hfov_deg = 69.0", keys))


def test_a_lens_with_a_ray_for_every_pixel_is_read():
    mild = FOLDED.replace("-5.0", "-0.1")
    assert parse_split(TINY_SPLIT, "tiny.toml", TINY_RIG.replace("hfov_deg = 69.0", mild)).rig.camera[0].distortion
    parse_split(TINY_SPLIT, "tiny.toml", TINY_RIG.replace("hfov_deg = 69.0", "hfov_deg = 96\nport_mm = 10"))
