"""Some of the hostile files in every run of the tests; thousands by the tools' own commands."""

from __future__ import annotations

import gc

import cv2
import numpy as np
import pytest

from tests.fuzz import sequences, uploads
from tests.fuzz.watch import FAULTS, run

SOME, MANY = (2, range(20)), (3, range(600))


@pytest.mark.parametrize(
    ("kind", "seed", "numbers"),
    [
        (sequences.Sequences, *SOME),
        pytest.param(uploads.Uploads, *SOME, marks=pytest.mark.slow),
        pytest.param(sequences.Sequences, *MANY, marks=pytest.mark.slow),
        pytest.param(uploads.Uploads, *MANY, marks=pytest.mark.slow),
    ],
)
def test_hostile_files_are_read_or_refused_in_a_line(tmp_path, kind, seed, numbers):
    cv2.setNumThreads(0)
    draw = kind(tmp_path, seed).draw
    found = [run(number, *draw(number)) for number in numbers]
    assert [outcome for outcome in found if outcome.what in FAULTS] == []
    assert {outcome.what for outcome in found} > {"refused"}, "some are read, for all that was changed"


@pytest.mark.parametrize("number", [1688, 3732])
def test_what_once_ended_in_a_traceback_is_refused(tmp_path, number):
    """A ping of other ranges than its calibration's, and a picture of 1e300 rows, which only the viewer had noticed."""
    assert run(number, *sequences.Sequences(tmp_path, 1).draw(number)).what == "refused in part"


def test_a_refusal_tells_no_address_of_the_readers_memory(tmp_path):
    """As numpy does of a header that it cannot evaluate."""
    outcome = run(3810, *uploads.Uploads(tmp_path, 1).draw(3810))
    assert outcome.what == "refused"
    assert "malformed node" in outcome.says
    assert "0x" not in outcome.says


def test_the_memory_of_a_case_is_its_own_whatever_was_loaded_before():
    """Not that of the process it is forked from, which other tests have filled."""
    loaded, taken = 300_000_000, 100_000_000
    held = np.ones(loaded, np.uint8)
    empty = run(0, "", lambda: ("read", ""))
    filled = run(1, "", lambda: ("read", str(np.ones(taken, np.uint8).sum())))
    assert held.nbytes == loaded
    assert empty.memory_bytes < 0.5 * taken
    assert 0.8 * taken < filled.memory_bytes < 1.5 * taken


def test_garbage_of_the_process_that_a_case_is_forked_from_is_not_taken_off_its_memory():
    class Cycle:
        def __init__(self):
            self.itself, self.held = self, np.ones(100_000_000, np.uint8)

    def case():
        gc.collect()
        return "read", str(np.ones(100_000_000, np.uint8).sum())

    gc.disable()
    try:
        Cycle()
        assert run(0, "", case).memory_bytes > 80_000_000
    finally:
        gc.enable()


def test_memory_that_was_freed_and_is_kept_for_use_is_not_taken_off_it():
    pieces = [np.ones(100_000, np.uint8) for _ in range(3000)]
    last = np.ones(100_000, np.uint8)  # without it, the end of the heap would be given back
    del pieces
    assert run(0, "", lambda: ("read", str(np.ones(100_000_000, np.uint8).sum()))).memory_bytes > 80_000_000
    assert last.all()
