"""The runner on one small dive."""

from __future__ import annotations

import pytest

from oysterbench.evaluate.slam.scoring import SlamSettings
from oysterbench.tracks.slam import TRACK, SlamSequence
from tests.helpers.track_runs import finished_of

NAME = "hand-made"


@pytest.fixture
def run_apart(dive_file, tmp_path):
    """Run methods on the hand-made dive; the list of what was finished."""

    def call(*methods, **options):
        options = {"limit_s": 60.0, **options}
        return finished_of(TRACK, [SlamSequence(NAME, dive_file)], methods, SlamSettings(), tmp_path / "out", **options)

    return call


@pytest.fixture
def run(run_apart, inputs_here):
    """The same without a process for each input."""
    return run_apart
