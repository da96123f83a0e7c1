"""The recording for Rerun: every part of a sequence is in it, once for each time that it was measured."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import oysterbench
from oysterbench.core.errors import MissingExtraError, OysterbenchError
from oysterbench.core.ros import EPOCH_NS
from oysterbench.core.trajectory import write_tum
from oysterbench.evaluate.slam import SlamSettings
from oysterbench.report.viewer.estimates import estimated_paths
from oysterbench.report.viewer.recording import curve_entity, load_rerun, save_recording, show_recording

CAM = "/world/base_link/cam_left"


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


def logged(path: Path, home: Path) -> dict[str, int]:
    """Rows by entity, as Rerun's own program reads them."""
    program = Path(sys.executable).parent / "rerun"
    environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home), "NO_COLOR": "1"}
    command = [str(program), "rrd", "print", str(path)]
    text = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
    rows: dict[str, int] = {}
    for count, entity in re.findall(r"^Chunk\(\w+\) with (\d+) rows? .*? - (/\S*) - ", text, re.M):
        rows[entity] = rows.get(entity, 0) + int(count)
    return rows


def test_everything_is_in_the_recording_as_often_as_it_was_measured(sequence, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra rerun)")
    write_tum(tmp_path / "mine.tum", sequence.truth())
    told = []
    estimates = estimated_paths(sequence, [tmp_path / "mine.tum"], SlamSettings())
    save_recording(sequence, tmp_path / "out.rrd", estimates, progress=lambda done, total: told.append((done, total)))
    rows = logged(tmp_path / "out.rrd", tmp_path)
    expected = {
        f"{CAM}/image": 20, "/world/base_link/cam_right/image": 20, f"{CAM}/depth": 4, f"{CAM}/instance": 4,
        f"{CAM}/class": 4 + 1, "/sonar/fls": 10, "/world/base_link/fls/cloud": 10 + 1, "/world/oysters": 1,
        "/world/paths/truth": 1, "/world/paths/mine": 1, "/curves/pressure": 40 + 1, "/curves/angular_rate/gyro_x": 201,
        "/curves/DVL_velocity/velocity_z": 16 + 1, "/curves/alt_range": 10 + 1, "/curves/true_speed": 100 + 1,
    }  # fmt: skip
    assert {entity: rows.get(entity) for entity in expected} == expected
    assert rows["/world/base_link"] == 100 + 1
    assert "/viewport" in rows, "the blueprint"
    assert told[-1][0] == told[-1][1] > 5
    assert sorted(path.name for path in tmp_path.glob("*.rrd*")) == ["out.rrd"]


def test_a_part_has_what_was_measured_in_it(sequence, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra rerun)")
    save_recording(sequence, tmp_path / "out.rrd", span_ns=(EPOCH_NS + 500_000_000, EPOCH_NS + 1_000_000_000))
    rows = logged(tmp_path / "out.rrd", tmp_path)
    assert (rows[f"{CAM}/image"], rows[f"{CAM}/depth"], rows["/curves/pressure"]) == (5, 1, 10 + 1)


def test_a_recording_that_fails_leaves_nothing(sequence, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra rerun)")

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_recording(sequence, tmp_path / "out.rrd", progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_without_a_display_a_file_is_suggested(sequence, monkeypatch):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra rerun)")
    monkeypatch.setattr(sys, "platform", "linux")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(OysterbenchError, match=r"no display .* --out hand-made\.rrd"):
        show_recording(sequence)


def test_without_rerun_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'oysterbench\[rerun\]'"):
        load_rerun()


def test_a_curve_has_a_place_without_unit_or_blanks():
    assert curve_entity("angular rate, deg/s", "gyro_x") == "curves/angular_rate/gyro_x"
    assert curve_entity("pressure, kPa") == "curves/pressure"
