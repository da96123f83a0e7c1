"""What gathers, grows and drifts on a reef beside its oysters, and shells of more than one kind."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.scene.instances import CLASS_NUMBERS
from oysterbench.scene.terrain import sample_grid
from oysterbench.scene.variety import vary_colours, vary_proportions
from oysterbench.scene.weeds import BUNCH_M, STRAND_M
from oysterbench.scene.world import World, build_world

RECIPE = load_split("slam-mini").sequence[0]


def built(**changes) -> World:
    base = {"size_m": 4.0, "relief_rms_m": 0.05, "oysters": 500, "stones": 10}
    return build_world(dataclasses.replace(RECIPE, reef=dataclasses.replace(RECIPE.reef, **base | changes)), Streams(9))


@pytest.fixture(scope="module")
def bare() -> World:
    return built()


def test_nothing_new_is_there_unless_it_is_asked_for(bare):
    stated = built(drape=0.0, infill_mm=0.0, turf=0.0, algae_per_m2=0.0, litter_per_m2=0.0, shell_spread=0.0)
    for field in dataclasses.fields(bare.instances):
        assert np.array_equal(getattr(stated.instances, field.name), getattr(bare.instances, field.name))
    assert len(bare.of_class("plant")) == 0
    assert bare.library.count["bunch"] == bare.library.count["strand"] == 0


def test_infill_raises_the_bottom_about_oysters_only_and_never_by_more_than_its_depth(bare):
    filled = built(infill_mm=20.0)
    raised = filled.terrain.heights.astype(float) - bare.terrain.heights
    assert raised.min() >= 0
    assert raised.max() <= 0.020 + 1e-5
    far = np.abs(filled.terrain.coordinates) > 4.0
    assert not raised[np.ix_(far, far)].any()
    umbos = bare.oysters.positions[:, :2].astype(float)
    about = filled.ground_height(*umbos.T) - bare.ground_height(*umbos.T)
    anywhere = np.random.default_rng(0).uniform(-2, 2, (2000, 2))
    there = filled.ground_height(*anywhere.T) - bare.ground_height(*anywhere.T)
    assert np.median(about) > 3 * np.median(there)
    assert np.array_equal(filled.oysters.positions, bare.oysters.positions)


def test_algae_and_litter_come_last_and_move_nothing_else(bare):
    grown = built(algae_per_m2=12.0, litter_per_m2=5.0)
    n = len(bare.instances)
    for field in dataclasses.fields(bare.instances):
        assert np.array_equal(getattr(grown.instances, field.name)[:n], getattr(bare.instances, field.name)), field.name
    added = grown.instances.take(np.arange(n, len(grown.instances)))
    assert len(added) == 12 * 16 + 5 * 16
    assert set(added.classes.tolist()) == {CLASS_NUMBERS["plant"]}


def test_bunches_are_rooted_on_shells_and_stones(bare):
    grown = built(algae_per_m2=12.0)
    bunches = grown.of_class("plant")
    assert bunches.hosts.min() > 0
    assert np.median(bunches.scales) == pytest.approx(np.sqrt(BUNCH_M[0] * BUNCH_M[1]), rel=0.2)
    for row in range(0, len(bunches), 20):
        host = grown.instances.vertices(grown.meshes, int(bunches.hosts[row]) - 1)
        assert np.linalg.norm(host - bunches.positions[row], axis=1).min() < 1e-4


def test_litter_lies_on_what_is_highest(bare):
    strands = built(litter_per_m2=20.0).of_class("plant")
    x, y, z = strands.positions.T.astype(float)
    top = sample_grid(bare.envelope_lines, bare.envelope, x, y)
    assert np.abs(np.median(z - top)) < 0.01
    assert (z > bare.ground_height(x, y) - 0.02).all()
    assert strands.scales.min() >= STRAND_M[0] * 0.999
    assert strands.scales.max() <= STRAND_M[1] * 1.001


def test_shells_of_a_spread_differ_more_in_shape_and_colour(bare):
    varied = built(shell_spread=1.0)
    assert np.array_equal(varied.oysters.scales[:, 0], bare.oysters.scales[:, 0]), "as high as they were"

    def proportions(world):
        table = world.oyster_table()
        live = table[table.state == "live"]
        return np.log(live.height_m / live.length_m)

    assert proportions(varied).std() > 1.2 * proportions(bare).std()
    saturation = [np.ptp(w.oysters.colours, axis=1) / w.oysters.colours.max(axis=1) for w in (varied, bare)]
    assert saturation[0].std() > 1.3 * saturation[1].std()


def test_the_drawn_spread_has_the_stated_deviation():
    generator = Streams(1).generator("variety")
    scales = vary_proportions(np.ones((20_000, 3)), 0.5, generator)
    assert np.all(scales[:, 0] == 1.0)
    assert np.log(scales[:, 1:]).std() == pytest.approx(0.08, rel=0.03)
    grey = np.full((20_000, 3), 0.2)
    tinted = (vary_colours(grey, 1.0, generator) != grey).any(axis=1)
    assert tinted.mean() == pytest.approx(0.65, abs=0.02)


def test_too_many_weeds_are_refused_before_they_are_built():
    with pytest.raises(RecipeError, match=r"'algae_per_m2', .* at most 65535 things together, got 128500"):
        built(size_m=16.0, algae_per_m2=500.0, stones=0)
