"""The relief of reefs: zero where it is flat, known where it is known, and the published one on a dense reef."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe, load_split
from oysterbench.scene.world import World, build_world
from tests.helpers.canopy import measure_relief

RECIPE = load_split("slam-mini").sequence[0]
DENSE = ReefRecipe(
    size_m=4.0,
    depth_m=3.0,
    relief_rms_m=0.02,
    density_per_m2=600.0,
    oyster_size_mm=40.0,
    patchiness=0.0,
    valve_share=0.03,
    bottom="shell",
)

FIGURES = ("canopy_height_m", "sigma_m", "rugosity")
SPREAD_M = 0.001  # of a mean over four quadrats from seed to seed


def world(reef: ReefRecipe) -> World:
    return build_world(dataclasses.replace(RECIPE, reef=reef), Streams(3))


def test_flat_bare_bottom_has_no_relief() -> None:
    relief = measure_relief(world(dataclasses.replace(DENSE, relief_rms_m=0.0, density_per_m2=0.0)))
    assert relief.rugosity == pytest.approx(1.0, abs=1e-9)
    assert relief.cover == 0.0
    assert np.isnan(relief.canopy_height_m)


@pytest.mark.parametrize(
    ("size_mm", "density_per_m2"),
    [
        pytest.param(40, 600, marks=pytest.mark.slow),
        pytest.param(60, 400, marks=pytest.mark.slow),
        pytest.param(85, 200, marks=pytest.mark.slow),
        (110, 150),
    ],
)
def test_dense_reef_has_the_published_relief(size_mm: float, density_per_m2: float) -> None:
    """Canopy 3.6 to 4.9 cm, sigma 1.4 to 2.0 cm, rugosity 1.28 (one year) to 1.56 (four years) on restored reefs.

    Their oysters grow from 40 mm to 85 mm meanwhile: older reefs are not taller by as much, but more silted up. The
    densities are those at which as much matter stands on a square metre.
    """
    reef = world(dataclasses.replace(DENSE, oyster_size_mm=float(size_mm), density_per_m2=float(density_per_m2)))
    quadrats = [measure_relief(reef, (x, y)) for x in (-0.8, 0.8) for y in (-0.8, 0.8)]
    canopy, sigma, rugosity = (np.mean([getattr(q, k) for q in quadrats]) for k in FIGURES)
    print(f"{size_mm} mm, {density_per_m2}/m2: canopy {canopy:.4f} m, sigma {sigma:.4f} m, rugosity {rugosity:.3f}")
    assert 0.036 <= canopy <= 0.049 + SPREAD_M
    assert 0.014 - SPREAD_M <= sigma <= 0.020 + SPREAD_M
    assert 1.28 <= rugosity <= 1.56


@pytest.mark.slow
def test_more_oysters_cover_and_roughen_more() -> None:
    sparse, dense = (
        measure_relief(world(dataclasses.replace(DENSE, size_m=2.0, density_per_m2=density)), side_m=1.5)
        for density in (30, 300)
    )
    assert sparse.cover < dense.cover
    assert sparse.rugosity < dense.rugosity
