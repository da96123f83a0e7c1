"""The relief of reefs: zero where it is flat, known where it is known, and the published one on a dense reef."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.recipe import ReefRecipe, load_split
from oysterbench.scene.canopy import measure_relief
from oysterbench.scene.world import World, build_world
from oysterbench.streams import Streams

RECIPE = load_split("slam-mini").sequence[0]
DENSE = ReefRecipe(
    size_m=4.0,
    depth_m=3.0,
    relief_rms_m=0.02,
    density_per_m2=600.0,
    oyster_size_mm=40.0,
    clump_size=4.0,
    patchiness=0.0,
    valve_share=0.03,
    bottom="shell",
)


def world(reef: ReefRecipe) -> World:
    return build_world(dataclasses.replace(RECIPE, reef=reef), Streams(3))


def test_flat_bare_bottom_has_no_relief() -> None:
    relief = measure_relief(world(dataclasses.replace(DENSE, relief_rms_m=0.0, density_per_m2=0.0)))
    assert relief.rugosity == pytest.approx(1.0, abs=1e-9)
    assert relief.cover == 0.0
    assert np.isnan(relief.canopy_height_m)


def test_dense_reef_has_the_published_relief() -> None:
    """Canopy 3.6 to 4.9 cm, sigma 1.4 to 2.0 cm, rugosity 1.28 (one year) to 1.56 (four years) on restored reefs."""
    reef = world(DENSE)
    quadrats = [measure_relief(reef, (x, y)) for x in (-0.8, 0.8) for y in (-0.8, 0.8)]
    assert 0.036 <= np.mean([q.canopy_height_m for q in quadrats]) <= 0.049
    assert 0.014 <= np.mean([q.sigma_m for q in quadrats]) <= 0.020
    assert 1.28 <= np.mean([q.rugosity for q in quadrats]) <= 1.56


def test_more_oysters_cover_and_roughen_more() -> None:
    sparse, dense = (
        measure_relief(world(dataclasses.replace(DENSE, density_per_m2=density)), side_m=2.0) for density in (30, 300)
    )
    assert sparse.cover < dense.cover
    assert sparse.rugosity < dense.rugosity
