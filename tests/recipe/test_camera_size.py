"""Cameras whose ground truth no file could hold are refused before anything is rendered."""

from __future__ import annotations

import re

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.core.mcap import LARGEST_CHUNK
from oysterbench.recipe import parse_split
from oysterbench.recipe.rig import LARGEST_LAYER, LAYER_BYTES
from oysterbench.sensors.camera_messages import LAYERS, PIXELS
from oysterbench.sequence.write import CHUNK_BYTES
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT


def split_with(width, height, layer, rate=2.0):
    rig = TINY_RIG.replace("width = 64", f"width = {width}").replace("height = 48", f"height = {height}")
    rig = rig.replace("layer_rate_hz = 2.0", f"layer_rate_hz = {rate}") + f'layers = ["{layer}"]\n'
    return parse_split(TINY_SPLIT, "tiny.toml", rig_source=rig)


@pytest.mark.parametrize(("layer", "most"), [("normals", 10_835_285), ("flow", 16_252_928), ("depth", 65_011_712)])
def test_a_camera_with_a_layer_that_fits_into_no_chunk_is_refused(layer, most):
    height = most // 8000
    assert split_with(8000, height, layer).rig.camera[0].sent_layers == (layer,)
    assert split_with(8000, height + 1, layer, rate=0.0).rig.camera[0].sent_layers == ()
    with pytest.raises(RecipeError) as refused:
        split_with(8000, height + 1, layer)
    assert re.search(rf"expected at most {most:_} pixels .* '{layer}', .* got 8000 x {height + 1}$", str(refused.value))


def test_bytes_of_a_pixel_are_those_of_its_messages():
    written = {layer: np.dtype(PIXELS[kind][0]).itemsize * PIXELS[kind][1] for layer, kind in LAYERS.items()}
    assert written == LAYER_BYTES
    assert LARGEST_LAYER + CHUNK_BYTES + 100_000 < LARGEST_CHUNK
