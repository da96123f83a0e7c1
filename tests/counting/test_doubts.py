"""Doubts in all counts: a scale in another unit, a method that takes anything for oysters."""

from __future__ import annotations

import math
import re

import pytest

from oysterbench.counting.doubts import doubts
from oysterbench.counting.measure import PictureCount


def picture(novelty=None, **values):
    known = {"width": 640, "height": 480, "oysters": 3, "cut": 0, "live": 0, "dead": 0, "cover": 0.1, "area_m2": None}
    return PictureCount("a", "a.jpg", novelty=novelty, **known | values)


def said(length_mm=math.nan, scale="", **values):
    return list(doubts("m", [picture(**values)], length_mm, scale))


@pytest.mark.parametrize("length_mm", [5.0, 25.0, 172.0, 400.0, math.nan])
def test_lengths_that_oysters_have_are_no_doubt(length_mm):
    assert said(length_mm, "plain", novelty=0.5) == []


@pytest.mark.parametrize(
    ("length_mm", "scale", "text"),
    [
        (94800.0, "plain", "94800 mm, where 5 to 400 mm are .*--mm-per-px takes millimetres per pixel"),
        (6082.0, "altitude", "6082 mm, .*--altitude takes metres"),
        (0.0948, "quadrat", "0.095 mm, .*--quadrat takes metres"),
    ],
)
def test_lengths_that_no_oyster_has_are_a_doubt_in_the_unit_of_the_scale(length_mm, scale, text):
    (only,) = said(length_mm, scale, novelty=0.5)
    assert re.search(text, only), only
    assert "touch" not in only


def test_lengths_of_parts_of_a_mask_may_be_those_of_oysters_that_touch():
    assert "do oysters touch" in said(900.0, "plain", novelty=0.5, parts=True)[0]
    assert "do oysters touch" not in said(0.9, "plain", novelty=0.5, parts=True)[0]


def test_a_scale_by_which_all_oysters_are_specks_is_a_doubt():
    (only,) = said(scale="plain", novelty=0.5, oysters=0, small=57)
    assert only.startswith("all 57 oysters are too small to count: is the scale in another unit")
    assert said(scale="plain", novelty=0.5, oysters=1, small=57) == []
    assert said(novelty=0.5, oysters=0, small=57) == []


def test_copies_are_a_doubt():
    (only,) = doubts("m", [picture(0.1)] * 3, math.nan, "", [("b", "a"), ("c", "a")])
    assert only.startswith(
        "2 files are copies of others and counted as often, which makes intervals too narrow: b is a"
    )


def test_quadrats_that_images_cut_are_a_doubt():
    pictures = [picture(0.1, area_m2=area) for area in (0.25, 0.24, 0.11)]
    (only,) = doubts("m", pictures, 80.0, "quadrat", (), 0.25)
    assert only.startswith("1 of 3 quadrats reach beyond their images")


def test_a_method_without_a_test_of_novelty_is_a_doubt():
    (only,) = said()
    assert only.startswith("m has no test of whether images are unlike its training data")
    assert list(doubts("m", [], math.nan, "")) == []
    assert list(doubts("m", [picture(0.1), picture()], math.nan, "")) == []


def test_a_method_that_has_learnt_from_rendered_reefs_alone_is_a_doubt():
    (only,) = doubts("m", [picture(0.1)], math.nan, "", rendered=True)
    assert only.startswith("m was trained on rendered reefs only: it may count several times as many")
    assert "dead" not in only
    (only,) = doubts("m", [picture(0.1, live=1)], math.nan, "", rendered=True)
    assert "in real images, and take live ones for dead; train" in only
    assert list(doubts("m", [], math.nan, "", rendered=True)) == []


def test_one_scale_for_images_of_several_sizes_is_a_doubt():
    upright = picture(0.1, width=480, height=640)
    large = picture(0.1, width=3456, height=2304)
    same = [picture(0.1), upright]
    assert list(doubts("m", same, 80.0, "plain")) == []
    (only,) = doubts("m", [*same, large], 80.0, "plain")
    assert only.startswith("one --mm-per-px was taken for images of 2 sizes (640 x 480, 3456 x 2304 px)")
    assert list(doubts("m", [*same, large], 80.0, "quadrat")) == []
