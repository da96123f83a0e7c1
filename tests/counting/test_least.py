"""Specks in a mask are no oysters, and what is left out is said."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from oysterbench.annotations.image import read_plane
from oysterbench.counting.least import Least
from oysterbench.counting.measure import measure
from oysterbench.counting.oysters import oysters_of
from oysterbench.counting.run import Counting, Settings
from oysterbench.counting.scale import PlainScale, QuadratScale
from oysterbench.counting.sources import find_sources
from oysterbench.counting.store import Store
from oysterbench.methods.images import Detections, Segmentation
from tests.helpers.image_methods import Light
from tests.helpers.people_pictures import Discs, discs, write

SHAPE = (480, 640)


@pytest.fixture
def mask():
    """(H, W) bool: a shell of 40 x 25 px, three specks of 3 x 9 px, one of them cut by the edge."""
    drawn = np.zeros(SHAPE, bool)
    drawn[200:225, 300:340] = True
    for y, x in ((50, 50), (100, 600), (0, 400)):
        drawn[y : y + 3, x : x + 9] = True
    return drawn


def counted(prediction, scale=None, least=None):
    found = oysters_of(prediction, "m", SHAPE, 0.5)
    return measure(found, "a", "a.jpg", SHAPE, scale, least or Least())


def test_specks_of_a_mask_neither_count_nor_cover_and_their_number_is_known(mask):
    picture, rows = counted(Segmentation("a", oyster=mask))
    assert (picture.oysters, picture.small, picture.cut, picture.parts) == (1, 3, 0, True)
    assert picture.cover == pytest.approx(1000 / (480 * 640))
    assert [(row.counted, row.small) for row in rows] == [(False, True), (False, True), (False, True), (True, False)]


def test_a_method_that_tells_oysters_apart_is_held_to_no_size_unless_one_is_given(mask):
    numbers = ndimage.label(mask)[0]
    prediction = Detections("a", np.ones(4), numbers=numbers)
    assert counted(prediction)[0].oysters == 4
    assert counted(prediction, least=Least(area_px=28))[0].oysters == 1
    assert counted(prediction, least=Least(area_px=27))[0].oysters == 4
    boxes = Detections("a", np.ones(2), boxes=np.array([[9, 9, 3, 9], [50, 50, 30, 20.0]]))
    assert counted(boxes, least=Least(area_px=28))[0].oysters == 1


def test_with_a_scale_what_is_shorter_than_the_smallest_oyster_measured_is_a_speck(mask):
    for mm_per_px, oysters in ((0.5, 0), (1.0, 1), (2.7, 1), (2.8, 4)):
        picture, _ = counted(Segmentation("a", oyster=mask), PlainScale(mm_per_px))
        assert (picture.oysters, picture.small) == (oysters, 4 - oysters), mm_per_px
    assert counted(Segmentation("a", oyster=mask), PlainScale(1.0), Least(length_mm=41.0))[0].oysters == 0
    assert counted(Segmentation("a", oyster=mask), PlainScale(1.0), Least(length_mm=0.0))[0].oysters == 4


def test_in_a_quadrat_only_specks_within_it_are_said_to_be_left_out(mask):
    square = np.array([[20, 20], [420, 20], [420, 420], [20, 420.0]])
    picture, rows = counted(Segmentation("a", oyster=mask), QuadratScale(0.4, square))
    assert (picture.oysters, picture.small) == (1, 1)
    assert sum(not row.counted for row in rows) == 3


def test_larger_images_of_the_same_bottom_leave_the_same_out(mask):
    prediction = Segmentation("a", oyster=np.kron(mask, np.ones((4, 4), bool)))
    found = oysters_of(prediction, "m", (1920, 2560), 0.5)
    picture, _ = measure(found, "a", "a.jpg", (1920, 2560), None, Least())
    assert (picture.oysters, picture.small) == (1, 3)


def test_a_mask_of_more_parts_than_can_be_numbered_is_a_failure_of_its_image_alone(tmp_path):
    class Specks(Light):
        name = "specks"

        def predict(self, image):
            chess = np.zeros(image.pixels.shape[:2], bool)
            chess[::2, ::2] = image.pixels.any()
            return Segmentation(image.name, oyster=chess)

    write(tmp_path / "in" / "a.png", discs((300, 300), shape=(520, 520)))
    write(tmp_path / "in" / "b.png", discs())
    sources = find_sources([tmp_path / "in"]).sources
    made = Counting(sources, Specks(), {}, Store(tmp_path / "out"), Settings()).run()
    assert [one.name for one in made.pictures] == ["b"]
    assert "at most 65535 oysters in an image, got 67600 connected parts" in made.failures["a"]


def test_masks_hold_what_counts_and_nothing_else(tmp_path):
    write(tmp_path / "in" / "a.png", discs((40, 40), (100, 60), radius=4) | discs((130, 90)))
    sources = find_sources([tmp_path / "in"]).sources
    square = np.array([[70, 10], [155, 10], [155, 115], [70, 115.0]])

    def numbers(out, **settings):
        store = Store(tmp_path / out)
        Counting(sources, Discs(), {}, store, Settings(**settings)).run()
        kept = set(np.unique(read_plane(store.mask("a"))).tolist()) - {0}
        assert kept == {row.number for row in store.oysters("a") if row.counted}
        return len(kept), len(store.oysters("a"))

    assert numbers("all") == (3, 3)
    assert numbers("large", least=Least(area_px=100)) == (1, 3)
    assert numbers("inside", scale=lambda source, name: QuadratScale(0.4, square)) == (2, 3)
