"""What the tests of the data sets stand on."""

from __future__ import annotations

import shutil

import pytest


@pytest.fixture
def own_dive(dive_file, tmp_path):
    """A copy of the hand-made dive, which a test may take away."""
    return shutil.copy(dive_file, tmp_path / "dive.mcap")
