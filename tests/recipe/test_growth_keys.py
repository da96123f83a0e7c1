"""What lies and grows on reefs, and what cameras make of pictures: off by default, and asked for by the seg splits."""

from __future__ import annotations

import dataclasses

import pytest

from oysterbench.recipe import CameraRecipe, load_split, split_names
from oysterbench.recipe.drawn import draw
from oysterbench.recipe.scene import LightRecipe, ReefRecipe

REEF = ("drape", "infill_mm", "turf", "fouling", "grit", "burrows", "algae_per_m2", "litter_per_m2", "shell_spread")
CAMERA = ("softness_px", "denoising", "sharpening", "contrast", "saturation")


def defaults(kind):
    return {field.name: field.default for field in dataclasses.fields(kind)}


@pytest.mark.parametrize("name", [name for name in split_names() if not name.startswith("seg-")])
def test_splits_of_other_tracks_have_none_of_it(name):
    split = load_split(name)
    for sequence in split.sequence:
        assert all(getattr(sequence.reef, key) == defaults(ReefRecipe)[key] for key in REEF)
        assert sequence.light.shade == defaults(LightRecipe)["shade"] == 0
        for camera in split.rig_of(sequence).camera:
            assert all(getattr(camera, key) == defaults(CameraRecipe)[key] for key in CAMERA)


@pytest.mark.parametrize("name", [name for name in split_names() if name.startswith("seg-")])
def test_every_seg_split_has_reefs_with_turf_and_cameras_that_process(name):
    split = load_split(name)
    assert all(sequence.reef.turf > 0 and sequence.reef.shell_spread > 0 for sequence in split.sequence)
    for sequence in split.sequence:
        assert all(camera.softness_px > 0 and camera.sharpening > 0 for camera in split.rig_of(sequence).camera)
    assert len({sequence.reef.turf for sequence in split.sequence}) > 1 or all(q.drawn for q in split.sequence)


@pytest.mark.parametrize("name", ["seg-closeup", "seg-reefview", "seg-quadrat", "seg-random"])
def test_what_is_drawn_of_growth_spans_a_range_in_each_sequence(name):
    for sequence in load_split(name).sequence:
        few, many = (draw(sequence, lambda key, end=end: end, name) for end in (0.0, 1.0))
        assert many.reef.turf >= few.reef.turf + 0.3
        assert many.reef.fouling >= few.reef.fouling + 0.5
        assert many.light.shade >= few.light.shade + 0.3
