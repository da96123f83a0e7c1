"""Single oysters of whatever a method predicts, checked; and what is counted and measured of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oysterbench.core.errors import LabelError, MethodError
from oysterbench.counting.measure import measure
from oysterbench.counting.oysters import oysters_of
from oysterbench.counting.scale import PlainScale, QuadratScale
from oysterbench.methods.images import Detections, Segmentation
from tests.helpers.people_pictures import Overlapping

SHAPE = (100, 120)


@pytest.fixture
def squares():
    """(H, W) int: 1 in the middle, 10 x 20 px; 2 at the left edge."""
    numbers = np.zeros(SHAPE, np.int64)
    numbers[40:50, 60:80] = 1
    numbers[20:30, :8] = 2
    return numbers


def found(prediction, threshold=0.5):
    return oysters_of(prediction, "m", SHAPE, threshold)


def test_numbers_give_box_area_centre_hull_and_what_the_edge_cuts(squares):
    first, second = found(Detections("a", np.array([0.9, 0.8]), numbers=squares, live=np.array([0.7, np.nan]))).each
    assert first.box == (60, 40, 20, 10)
    assert (first.area_px, first.score, first.state, first.cut) == (200, 0.9, "live", False)
    assert first.centre == pytest.approx([70, 45])
    assert sorted(map(tuple, first.hull)) == [(60, 40), (60, 50), (80, 40), (80, 50)]
    assert (second.state, second.cut) == ("unknown", True)


def test_an_oyster_below_the_threshold_leaves_no_trace_and_the_others_are_numbered_anew(squares):
    result = found(Detections("a", np.array([0.4, 0.8]), numbers=squares))
    assert [one.number for one in result.each] == [1]
    assert np.array_equal(result.numbers > 0, squares == 2)
    assert len(found(Detections("a", np.array([0.4, 0.8]), numbers=squares), 0.3).each) == 2


def test_what_hangs_together_in_a_mask_is_one_and_its_score_its_mean_probability(squares):
    probability = np.where(squares == 1, 0.8, np.where(squares == 2, 0.6, 0.1))
    assert [one.score for one in found(Segmentation("a", probability=probability)).each] == pytest.approx([0.6, 0.8])
    assert len(found(Segmentation("a", probability=probability), 0.7).each) == 1
    bare = found(Segmentation("a", oyster=squares > 0, novelty=1.5))
    assert [math.isnan(one.score) for one in bare.each] == [True, True]
    assert bare.novelty == 1.5


def test_an_oyster_under_another_is_counted_with_the_whole_of_its_mask(squares):
    class Picture:
        name, pixels = "a", np.zeros((*SHAPE, 3), np.uint8)

    result = found(Overlapping().predict(Picture))
    assert [(one.score, one.area_px) for one in result.each] == [(0.6, 400), (0.9, 2500)]
    assert set(np.unique(result.numbers)) == {0, 2}, "the surest is on top"


def test_boxes_are_counted_but_cover_nothing_that_is_known():
    prediction = Detections("a", np.array([0.9, 0.9]), boxes=np.array([[10, 20, 30, 10], [-5, 0, 10, 10.0]]))
    result = found(prediction)
    assert [one.cut for one in result.each] == [False, True]
    picture, rows = measure(result, "a", "a.jpg", SHAPE, PlainScale(2.0))
    assert (picture.oysters, picture.cover) == (2, None)
    assert (rows[0].length_mm, rows[0].width_mm, rows[0].area_px) == (pytest.approx(60), pytest.approx(20), None)


@pytest.mark.parametrize(
    ("prediction", "said"),
    [
        (Segmentation("a", oyster=np.zeros((2, 3), bool)), "of the image's size, 120 x 100, got 3 x 2"),
        (Detections("a", np.zeros(0), numbers=np.zeros((3, 2), int)), "120 x 100, got 2 x 3"),
        (Detections("a", np.ones(1), masks=np.zeros((1, 2, 2), bool)), "120 x 100, got 2 x 2"),
        (Detections("a", np.ones(1), numbers=np.full(SHAPE, 2)), "a score for each of 2 oysters, got 1"),
        (Detections("a", np.ones(2), boxes=np.ones((1, 4))), "a score for each of 1 oysters, got 2"),
        (Detections("a", np.ones(1), boxes=np.ones((1, 3))), r"expected boxes \(N, 4\)"),
        (Detections("a", np.array([np.nan]), numbers=np.ones(SHAPE, int)), "expected scores"),
        (Detections("a", np.ones(1), numbers=np.ones(SHAPE, int), live=np.array([1.5])), "expected live"),
        (Detections("a", np.ones(1)), "one of them|got none of them"),
        (Segmentation("a", oyster=np.zeros(SHAPE, bool), novelty=math.nan), "expected a novelty"),
        (Segmentation("a", probability=np.full(SHAPE, 2.0)), "expected probabilities from 0 to 1"),
        (Segmentation("a"), "expected one of oyster, probability and classes, got 0"),
    ],
)
def test_what_is_no_answer_is_one_line_that_names_method_and_picture(prediction, said):
    with pytest.raises((MethodError, LabelError), match=rf"method 'm' on a: .*({said})"):
        found(prediction)


def test_a_plain_scale_gives_lengths_area_and_density_in_which_cut_oysters_are_a_half(squares):
    result = found(Detections("a", np.ones(2), numbers=squares, live=np.array([0.9, 0.1])))
    picture, rows = measure(result, "a", "a.jpg", SHAPE, PlainScale(5.0))
    assert picture.area_m2 == pytest.approx(0.5 * 0.6)
    assert (picture.oysters, picture.cut, picture.live, picture.dead) == (2, 1, 1, 1)
    assert picture.per_m2 == pytest.approx(1.5 / 0.3)
    assert (rows[0].length_mm, rows[0].width_mm) == pytest.approx((100, 50))
    assert (picture.measured, picture.length_mm) == (1, pytest.approx(100)), "what is cut has no length of its own"
    assert picture.cover == pytest.approx((200 + 80) / 12000)


def test_in_a_quadrat_counts_what_has_its_middle_inside(squares):
    corners = np.array([[65, 20], [115, 20], [115, 90], [65, 90.0]])
    result = found(Detections("a", np.ones(2), numbers=squares))
    picture, rows = measure(result, "a", "a.jpg", SHAPE, QuadratScale(0.5, corners))
    assert [row.counted for row in rows] == [True, False]
    assert (picture.oysters, picture.cut) == (1, 0)
    assert picture.per_m2 == pytest.approx(1 / 0.25, rel=1e-3)
    assert picture.cover == pytest.approx(150 / 3500, rel=0.03), "of the quadrat, the part of the oyster inside"
    assert rows[1].length_mm is None


def test_in_a_quadrat_an_oyster_that_the_edge_of_the_image_cuts_counts_whole_where_its_middle_is_inside(squares):
    corners = np.array([[2, 2], [118, 2], [118, 98], [2, 98.0]])
    result = found(Detections("a", np.ones(2), numbers=squares))
    picture, _ = measure(result, "a", "a.jpg", SHAPE, QuadratScale(0.5, corners))
    assert (picture.oysters, picture.cut) == (2, 1)
    assert picture.per_m2 == pytest.approx(2 / 0.25)


def test_without_a_scale_there_is_no_density(squares):
    picture, rows = measure(found(Detections("a", np.ones(2), numbers=squares)), "a", "a.jpg", SHAPE, None)
    assert (picture.oysters, picture.area_m2, picture.per_m2, rows[0].length_mm) == (2, None, None, None)


def test_a_novelty_above_one_is_unlike(squares):
    for novelty, unlike in ((1.01, True), (1.0, False), (None, False)):
        result = found(Segmentation("a", oyster=squares > 0, novelty=novelty))
        assert measure(result, "a", "a.jpg", SHAPE, None)[0].unlike is unlike
