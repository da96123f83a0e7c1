"""Scores of maps of oysters, against numbers made by hand."""

from __future__ import annotations

import math

import pytest

from oysterbench.evaluate.density.metrics import DENSITY
from oysterbench.evaluate.density.scoring import Cell, MapCount, TrueCount, score_density
from oysterbench.evaluate.metrics import find_metric

TRUTH = TrueCount(
    {(0, 0): Cell(1.0, 10.0), (1, 0): Cell(0.5, 10.0), (2, 0): Cell(1.0, 60.0), (3, 0): Cell(1.0, 0.0)},
    shown=100,
    live=80,
    hidden=25,
    area_m2=4.0,
)


def mapped(cells, count=110.0, live=76.0, owners=(1, 1, 2, 0), found=(1, 2, 3)) -> MapCount:
    return MapCount(cells, count, live, count - 5, count + 5, owners, frozenset(found))


def test_a_map_like_the_truth_has_no_error():
    score = score_density(TRUTH, mapped(TRUTH.cells, 100.0, 80.0, tuple(range(1, 101)), range(1, 101)))
    metrics = score.metrics
    assert metrics["map_score"] == metrics["right_class"] == metrics["coverage"] == metrics["count_within"] == 1
    assert metrics["cell_mae_per_m2"] == metrics["count_error_percent"] == metrics["twice_percent"] == 0
    assert metrics["hidden_percent"] == pytest.approx(20.0)
    assert metrics["density_truth_live_per_m2"] == 20.0
    assert not score.reasons


def test_errors_are_those_of_cells_and_of_the_whole():
    cells = {(0, 0): Cell(1.0, 16.0), (1, 0): Cell(1.0, 17.0), (2, 0): Cell(1.0, 60.0), (9, 9): Cell(1.0, 500.0)}
    metrics = score_density(TRUTH, mapped(cells)).metrics
    assert metrics["coverage"] == 0.75
    assert metrics["cell_mae_per_m2"] == pytest.approx((6 + 3 + 0) / 3)
    assert metrics["cell_bias_per_m2"] == pytest.approx((6 - 3 + 0) / 3)
    assert metrics["map_score"] == pytest.approx((10 + 0.5 * 17 + 60) / (16 + 0.5 * 20 + 60))
    assert metrics["right_class"] == 0.5  # the first is above 15 on the map, the last has no number
    assert metrics["count_error_percent"] == pytest.approx(10.0)
    assert metrics["live_error_percent"] == pytest.approx(-5.0)
    assert metrics["count_within"] == 0
    assert metrics["twice_percent"] == pytest.approx(1.0)
    assert metrics["lost_percent"] == pytest.approx(1.0)


def test_the_score_is_what_the_maps_have_in_common():
    """On a patchy reef an empty map is right in most cells, and shows nothing of what there is."""
    patchy = TrueCount({(k, 0): Cell(1.0, 60.0 if k < 4 else 0.0) for k in range(20)}, 240, 240, 0, 20.0)

    def scored(per_m2_of):
        cells = {at: Cell(0.5, 0.5 * per_m2_of(at[0], cell.per_m2)) for at, cell in patchy.cells.items()}
        return score_density(patchy, mapped(cells)).metrics["map_score"]

    assert scored(lambda k, true: 0.0) == 0.0
    assert scored(lambda k, true: 0.5 * true) == scored(lambda k, true: 2.0 * true) == 0.5
    assert scored(lambda k, true: true if k % 2 else 0.0) == 0.5
    assert scored(lambda k, true: 12.0) == pytest.approx(4 * 12 / (4 * 60 + 16 * 12))
    half = {at: cell for at, cell in patchy.cells.items() if at[0] in (0, 1)}
    assert score_density(patchy, mapped(half)).metrics["map_score"] == 0.5


def test_on_bare_ground_a_map_is_as_good_as_what_it_covers():
    bare = TrueCount({(k, 0): Cell(1.0, 0.0) for k in range(4)}, 0, 0, 0, 4.0)
    whole, part = bare.cells, {(0, 0): Cell(1.0, 0.0)}
    scores = [score_density(bare, mapped(cells, 0.0, 0.0, (), ())).metrics["map_score"] for cells in (whole, part, {})]
    assert scores == [1.0, 0.25, 0.0]
    assert score_density(bare, mapped({(0, 0): Cell(1.0, 1.0)})).metrics["map_score"] == 0.0


def test_nothing_to_score_by_is_said():
    nothing = TrueCount({}, 0, 0, 0, 0.0)
    score = score_density(nothing, mapped({}, 0.0, 0.0, (), ()))
    assert math.isnan(score.metrics["count_error_percent"])
    assert score.reasons["count_error_percent"] == "no image shows an oyster"
    assert score.reasons["map_score"] == "no cell was seen enough to have a number"


def test_every_metric_that_is_measured_is_defined():
    score = score_density(TRUTH, mapped(TRUTH.cells))
    assert set(score.metrics) == set(DENSITY)
    assert all(find_metric(key) is DENSITY[key] for key in DENSITY if key != "coverage")
