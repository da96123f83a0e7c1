"""Parts of maps, each against what is known of it by formula."""

from __future__ import annotations

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from scipy.stats import poisson

from oysterbench.evaluate.density.restoration import restoration_class
from oysterbench.evaluate.exact import count_interval
from oysterbench.mapping.depth import carried_on, fit_plane
from oysterbench.mapping.grid import Oyster, live_share
from oysterbench.mapping.intervals import clumping, doubt_variance
from oysterbench.report.figures import figure_style, new_figure, png_of, svg_of


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
    assert live_share(oysters[-1:]) == 1.0


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
