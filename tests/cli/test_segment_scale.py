"""Scales of oysterbench segment that do not go together, and numbers without an interval, each told in one line."""

from __future__ import annotations

import pytest

from tests.helpers.command import run
from tests.helpers.people_pictures import discs, write

DISCS = ("--method", "tests.helpers.people_pictures:Discs")


@pytest.fixture
def reef(tmp_path, monkeypatch):
    """Ten images that show the same."""
    monkeypatch.chdir(tmp_path)
    for k in range(10):
        pixels = discs((40, 40), (100, 60))
        pixels[0, k] = 1  # no copy of another
        write(tmp_path / "reef" / f"{k}.png", pixels)
    return tmp_path / "reef"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--quadrat", "0.5"), "--quadrat: expected --corners FILE as well"),
        (("--corners", "c.csv"), "--corners: expected --quadrat M as well"),
        (("--altitude", "1"), "--altitude: expected --calibration FILE as well"),
        (("--calibration", "c.yaml"), "--calibration: expected --altitude M as well"),
        (
            ("--altitude", "0,4", "--calibration", "c.yaml"),
            "--altitude: expected metres, such as 0.4, or a CSV file, got 0,4",
        ),
        (("--camera", "cam0"), "--camera: expected --calibration FILE as well"),
        (("--min-mm", "25"), "--min-mm: expected a scale as well"),
        (("--mm-per-px", "1", "--quadrat", "1", "--corners", "c"), "expected at most one scale"),
    ],
)
def test_options_of_a_scale_that_do_not_belong_together_are_refused(reef, options, said):
    done = run("segment", reef, *DISCS, *options)
    assert done.returncode == 2
    assert said in done.stderr


def test_a_number_without_an_interval_is_named(reef):
    said = run("segment", reef, *DISCS).stdout.splitlines()
    assert "Cover: where all 10 images have the same value, resampling gives no 95% interval" in said
    assert any(line.startswith("Oysters per image: 2.0 [") for line in said)
    assert not any(line.startswith("Cover: 0") and "[" in line for line in said)
