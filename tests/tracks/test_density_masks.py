"""What the density track takes from the predictions of image methods: the same as from their files."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from oysterbench.mapping.predicted import components
from oysterbench.methods.images import Detections, Segmentation
from oysterbench.tracks import density
from oysterbench.tracks.images import PictureSequence

NAME, SHAPE = "one/cam/5", (480, 640)


@pytest.fixture
def seen_of(tmp_path, monkeypatch):
    """Return a function: the oysters that are mapped from a prediction for an image."""

    def call(prediction):
        picture = SimpleNamespace(name=NAME, classes=np.zeros(SHAPE, np.uint8))
        known = {"name": "one", "names": (NAME,), "digest_given": lambda: ""}
        labelled = SimpleNamespace(images=lambda: iter([(picture, None)]), **known)
        monkeypatch.setattr(density, "read_predictions", lambda folder, names: [prediction])
        adapter, sequence = SimpleNamespace(name="mine"), PictureSequence(labelled, [], None)
        job = SimpleNamespace(sequence=sequence, adapter=adapter, folder=lambda out: out)
        (seen,) = density._seen(job, SimpleNamespace(finished=True, failure=None), tmp_path, "cam", 0.5)
        return seen

    return call


def test_the_states_that_a_method_tells_are_kept(seen_of):
    numbers = np.zeros(SHAPE, np.uint16)
    for k in range(3):
        numbers[50 * k : 50 * k + 20, 100:120] = k + 1
    live = np.array([0.9, 0.1, np.nan])
    assert seen_of(Detections(NAME, np.array([0.7, 0.8, 0.9]), numbers=numbers, live=live)).states == {
        1: "live",
        2: "dead",
    }
    assert seen_of(Detections(NAME, np.ones(3), numbers=numbers)).states == {}


@pytest.mark.parametrize("of", ["oyster", "probability"])
def test_specks_of_a_mask_are_no_oysters(seen_of, of):
    mask = np.zeros(SHAPE, bool)
    mask[100:105, 100:105] = mask[200:220, 200:220] = True
    given = mask if of == "oyster" else np.where(mask, 0.8, 0.1)
    found = seen_of(Segmentation(NAME, **{of: given}))
    filed = components(5, "cam", mask, None if of == "oyster" else given)
    np.testing.assert_array_equal(found.numbers, filed.numbers)
    assert (int((found.numbers > 0).sum()), found.scores) == (400, filed.scores)
