"""Parts of maps, each against what is known of it by formula."""

from __future__ import annotations

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from scipy.stats import poisson

from oysterbench.evaluate.density.restoration import restoration_class
from oysterbench.evaluate.exact import count_interval
from oysterbench.mapping.cover import Cover, raster_around
from oysterbench.mapping.depth import carried_on, fit_plane
from oysterbench.mapping.grid import Oyster, live_range, live_share, make_grid, total
from oysterbench.mapping.intervals import clumping, doubt_variance
from oysterbench.mapping.settings import MapSettings
from oysterbench.report.figures import figure_style, new_figure, png_of, svg_of
from oysterbench.scene.clump import clump_centres, clump_sizes


@pytest.mark.parametrize("count", [0, 1, 7, 60])
def test_the_interval_of_a_poisson_count_is_the_exact_one(count):
    low, high = count_interval(count, count)
    if count:
        assert poisson.sf(count - 1, low) == pytest.approx(0.025, rel=1e-6)
    else:
        assert low == 0
    assert poisson.cdf(count, high) == pytest.approx(0.025, rel=1e-6)


def test_what_scatters_more_has_a_wider_interval():
    assert count_interval(40, 160)[0] < count_interval(40, 40)[0] < 40 < count_interval(40, 40)[1]
    assert count_interval(40, 160)[1] > count_interval(40, 40)[1]


def test_clumping_is_found_again():
    generator = np.random.default_rng(1)
    areas = generator.uniform(0.5, 1.0, 20000)
    counts = generator.poisson(generator.gamma(2.0, 20.0 / 2.0, 20000) * areas)
    assert clumping(counts, areas) == pytest.approx(0.5, abs=0.03)
    assert clumping(generator.poisson(20.0 * areas), areas) < 0.01
    assert np.isnan(clumping(counts[:2], areas[:2]))


def test_doubts_add_their_variances():
    found = doubt_variance(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.5, 0.0]), np.array([1.0, 1.0, 0.8]))
    assert found.tolist() == pytest.approx([0.25, 0.25, 0.16])


def test_classes_begin_at_fifteen_and_fifty():
    assert restoration_class(np.array([0.0, 14.9, 15.0, 49.9, 50.0, np.nan])).tolist() == [0, 0, 1, 1, 2, -1]


def test_those_of_unknown_state_are_shared_as_the_known_are():
    oysters = [Oyster(np.zeros(3), state, 1) for state in ("live", "live", "live", "dead", "unknown")]
    assert live_share(oysters) == 0.75
    assert live_range(oysters) == pytest.approx((0.194, 0.994), abs=1e-3)  # Clopper & Pearson, 3 of 4
    assert live_share(oysters[-1:]) == 1.0
    assert live_range(oysters[-1:]) == (1.0, 1.0), "all are counted, as live or dead"


@pytest.mark.parametrize("told", ["live", "dead"])
def test_labels_of_one_state_alone_say_nothing_of_the_others(told):
    oysters = [Oyster(np.zeros(3), state, 1) for state in [told] * 20 + ["unknown"] * 480]
    assert live_share(oysters) == 1.0
    assert live_range(oysters) == (0.0, 1.0)


def mapped(places, states, window_m, cell_m=1.0):
    """Grid and totals of oysters at places (N, 2) m on a completely seen square from (0, 0)."""
    settings = MapSettings(cell_m=cell_m, raster_m=0.1)
    raster = raster_around(np.array([[0.05, 0.05], [window_m - 0.05] * 2]), 0.0, 0.1, cell_m)
    cover = Cover(raster)
    cover.views[:] = 1
    oysters = [Oyster(np.append(place, 0.0), state, 5) for place, state in zip(places, states, strict=True)]
    grid = make_grid(oysters, cover, settings, 0.001)
    return grid, total(oysters, grid, 0.001, 100)


def test_few_known_states_leave_densities_and_classes_uncertain():
    generator = np.random.default_rng(0)
    places = generator.uniform(0.0, 7.0, (980, 2))
    states = ["unknown"] * 976 + ["live"] * 3 + ["dead"]
    few, found = mapped(places, states, 7.0)
    assert found.live_per_m2 == pytest.approx(15.0, abs=0.1)
    assert found.low_per_m2 < 0.2 * 20
    assert found.high_per_m2 > 0.99 * 20
    assert not few.sure.any()
    dead_only, found = mapped(places, ["unknown"] * 960 + ["dead"] * 20, 7.0)
    assert (found.live_per_m2, found.low_per_m2) == (pytest.approx(960 / 49), 0.0)
    assert not dead_only.sure[dead_only.density >= 15.0].any()


@pytest.mark.parametrize("patchiness", [0.0, 0.8])
def test_intervals_hold_the_density_of_patchy_reefs_whatever_the_cells(patchiness):
    """Oysters of a reef of 24 m as the renderer sets them, of which a window of 8 m is seen."""
    generator, reefs, side = np.random.default_rng(7), 40, 24.0
    holds, widths = 0, []
    for _ in range(reefs):
        sizes = clump_sizes(round(20.0 * side**2), 7.0, generator)
        centres = np.repeat(clump_centres(len(sizes), side, 0.2, patchiness, generator), sizes, axis=0)
        places = centres + generator.normal(0.0, 0.06, centres.shape) - generator.uniform(-side / 2, side / 2 - 8.0, 2)
        places = places[((places > 0.0) & (places < 8.0)).all(axis=1)]
        found, finer = (mapped(places, ["live"] * len(places), 8.0, cell_m)[1] for cell_m in (1.0, 0.5))
        assert (finer.low_per_m2, finer.high_per_m2) == pytest.approx((found.low_per_m2, found.high_per_m2))
        assert (found.of_reef, found.block_m) == (True, 3.0)
        holds += found.low_per_m2 <= 20.0 <= found.high_per_m2
        widths.append(found.high_per_m2 - found.low_per_m2)
    assert holds >= 0.9 * reefs
    # The density of such windows scatters by 1.6 and 4.4 per m^2, which makes perfect intervals 6.3 and 17.2 wide.
    assert np.mean(widths) < 1.35 * (6.3 if patchiness == 0.0 else 17.2)


def test_of_little_ground_the_interval_is_of_what_was_seen_alone():
    places = np.random.default_rng(1).uniform(0.0, 3.0, (180, 2))
    _, found = mapped(places, ["live"] * 180, 3.0)
    assert not found.of_reef
    assert found.low_per_m2 == pytest.approx(20.0, rel=0.01)
    assert found.high_per_m2 == pytest.approx(20.0, rel=0.01)


def test_depths_are_carried_over_holes_as_on_a_plane():
    v, u = np.mgrid[:60, :80].astype(float)
    inverse = 0.6 + 0.002 * u + 0.003 * v
    holed = 1.0 / inverse
    holed[20:26, 30:36] = np.nan
    filled = carried_on(holed)
    assert np.isfinite(filled).all()
    assert np.abs(filled * inverse - 1.0)[20:26, 30:36].max() < 0.02
    assert np.allclose(filled[~np.isnan(holed)], holed[~np.isnan(holed)], rtol=1e-6)
    assert np.isnan(carried_on(np.full((60, 80), np.nan))).all()


def test_depths_are_carried_beyond_the_edge_as_on_a_plane():
    v, u = np.mgrid[:60, :80].astype(float)
    inverse = 0.6 + 0.004 * u + 0.003 * v
    depth = np.where(u < 12, np.nan, 1.0 / inverse)
    depth[30:34, 40:44] = 0.3  # something near, by which the plane is not led astray
    assert np.abs(carried_on(depth) * inverse - 1.0)[:, :12].max() < 0.03


def test_few_depths_make_no_plane():
    depth = np.full((60, 80), np.nan)
    depth[30, 40:60] = np.linspace(1.0, 2.0, 20)
    filled = carried_on(depth)
    assert np.nanmin(filled) > 0.9
    assert np.nanmax(filled) < 2.1


def test_a_plane_is_found_through_echoes_with_some_from_fish():
    generator = np.random.default_rng(2)
    points = generator.uniform(-2, 2, (80, 3))
    points[:, 2] = 0.1 * points[:, 0] - 0.05 * points[:, 1] - 3.0
    points[::16, 2] += 0.8
    a, b, c = fit_plane(points)
    assert (a, b) == pytest.approx((0.1, -0.05), abs=0.03)
    assert c == pytest.approx(-3.0, abs=0.05)


def test_a_figure_is_the_same_each_time_as_page_and_as_picture():
    def made():
        with figure_style():
            figure = new_figure("a & b", 4.0, 3.0)
            figure.subplots(2, 1)[0].plot([0, 1], [0, 2], label="m\N{SUPERSCRIPT TWO} < $3$")
            figure.legend(loc="outside lower left")
        return figure

    once = made()
    pixels = cv2.imdecode(np.frombuffer(png_of(once), np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (432, 576, 3)
    assert pixels.min() < 128
    svg = svg_of(once)
    assert "a &amp; b" in svg
    assert svg == svg_of(once) == svg_of(made())
    ElementTree.fromstring(svg)
