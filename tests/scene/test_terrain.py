"""The bare seabed: the relief that was asked for, one surface without seams."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.terrain import SKIRT_M, build_terrain

REEF = ReefRecipe(size_m=5.0, depth_m=3.0, relief_rms_m=0.08, oysters=0)


def terrain(**changes):
    return build_terrain(dataclasses.replace(REEF, **changes), Streams(2).generator("terrain"))


def test_relief_has_the_recipes_rms_and_mean_depth() -> None:
    square = terrain().square
    assert square.mean() == pytest.approx(-3.0, abs=0.01)
    assert square.std() == pytest.approx(0.08, rel=0.05)


def test_no_relief_is_a_plane() -> None:
    assert np.all(terrain(relief_rms_m=0.0).heights == -3.0)


def test_seabed_goes_far_past_the_reef() -> None:
    lines = terrain().coordinates
    assert lines[0] < -SKIRT_M
    assert lines[-1] > SKIRT_M
    assert np.all(np.diff(lines) > 0)


def test_skirt_continues_the_square_without_a_step() -> None:
    ground = terrain()
    edge = 2.5
    along = np.linspace(-2, 2, 50)
    inside, outside = ground.height(edge - 0.01, along), ground.height(edge + 0.01, along)
    assert np.abs(inside - outside).max() < 0.03


def test_height_is_the_mesh_at_its_vertices() -> None:
    ground = terrain()
    vertices = ground.mesh().vertices[::997].astype(float)
    assert ground.height(vertices[:, 0], vertices[:, 1]) == pytest.approx(vertices[:, 2], abs=1e-5)


def test_square_and_skirt_together_are_the_mesh() -> None:
    ground = terrain()
    cells = len(ground.square) - 1
    assert len(ground.skirt().faces) + 2 * cells**2 == len(ground.mesh().faces)


def test_steepest_bounds_every_slope() -> None:
    ground = terrain()
    step = ground.coordinates[ground.rim + 1] - ground.coordinates[ground.rim]
    slope = np.hypot(*np.gradient(ground.square.astype(float), step))
    assert ground.steepest() >= slope.max()


def test_sand_has_ripples_that_run_one_way_with_defects_and_mud_has_hardly_any() -> None:
    def ripples(bottom: str) -> np.ndarray:
        square = terrain(bottom=bottom, relief_rms_m=0.1).square.astype(float)
        spectrum = np.fft.fft2(square - square.mean())
        k = np.hypot(*np.meshgrid(*[np.fft.fftfreq(len(square), 5.0 / len(square))] * 2))
        return np.where((k > 5) & (k < 10), np.abs(spectrum) ** 2, 0.0)

    sand, mud = ripples("sand"), ripples("mud")
    assert sand.sum() > 10 * mud.sum()
    k_x, k_y = np.meshgrid(*[np.fft.fftfreq(len(sand))] * 2)
    angle = np.arctan2(k_y, k_x)
    resultant = np.abs((sand * np.exp(2j * angle)).sum()) / sand.sum()
    assert 0.6 < resultant < 0.99  # directional, but no sine sheet
