"""What several tests stand on: a very small split, rendered once per run of the tests."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import pytest

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.methods.interfaces import slam
from oysterbench.simulation.generate import generate_split
from tests.helpers.paths import SHARED_DATA
from tests.helpers.tiny import make_split

# Where the tests run in the background, SIGINT comes ignored, and programs that they start and interrupt inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Workers of pytest-xdist have the width of a terminal, and tables of pipes heed it.
os.environ.pop("COLUMNS", None)
# What is imported while tests are collected stays: to look through it again and again is a fifth of the time of that.
gc.disable()


def pytest_collection_finish():
    """From here on garbage is collected as ever, and what was imported is not searched for it."""
    gc.collect()  # warns of what was left open
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def tiny_split():
    return make_split()


@pytest.fixture(scope="session")
def tiny_file(tiny_split, tmp_path_factory) -> Path:
    """The only sequence of the tiny split, rendered in this process."""
    return generate_split(tiny_split, tmp_path_factory.mktemp("tiny"), workers=1)["tiny-01"]


@pytest.fixture
def home(tmp_path, monkeypatch) -> Path:
    """An empty OYSTERBENCH_HOME."""
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def inputs_here(monkeypatch):
    """Inputs of methods are written in this process, not in one each, whose start takes most of the time of a run."""

    def write(sequence, form, out, processes):
        try:
            slam.write_input(sequence.path, form, out)
        except OysterbenchError as error:
            raise MethodError(str(error)) from None

    monkeypatch.setattr(slam.SequencePath, "write_input", write)


@pytest.fixture(scope="module")
def browser():
    """One tab of Chromium."""
    from tests.helpers.browser import browsing

    with browsing() as found:
        yield found


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of data that is not part of the project; tests that need it skip where it is absent."""
    folder = SHARED_DATA
    if not folder.is_dir():
        pytest.skip(f"shared data is absent: {folder} (set OYSTERBENCH_SHARED_DATA)")
    return folder


@pytest.fixture(scope="session")
def dive_file(tmp_path_factory) -> Path:
    """A hand-made dive with every kind of sensor."""
    from tests.helpers.hand_made_dive import write_dive

    return write_dive(tmp_path_factory.mktemp("dive") / "hand-made.mcap")
