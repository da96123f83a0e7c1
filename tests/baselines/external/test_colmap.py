"""The adapter to COLMAP: its task, and, where it is built, what it reaches."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems.launch import Launch
from oysterbench.methods.systems.manifest import split_reference
from oysterbench_baselines.external.colmap.configure import command, lens_of


def test_the_task_holds_the_camera_and_the_options(dive_file, tmp_path):
    system, _, options = split_reference("colmap[rate_hz=2]")
    given = tmp_path / "given"
    launch = Launch(
        method="colmap",
        about=system.description.methods["colmap"],
        options=options,
        given=given,
        source=tmp_path,
        build=tmp_path / "place" / "build",
        folder=tmp_path,
        out=tmp_path / "out.tum",
        number=3,
    )
    sequence = oysterbench.open(dive_file)
    sequence.cameras = {name: replace(one, time_offset_s=0.03) for name, one in sequence.cameras.items()}
    launch.__dict__["sequence"] = sequence
    words = command(launch)
    assert words[0] == str(tmp_path / "place" / "venv" / "bin" / "python")
    assert words[-2:] == [str(given), str(tmp_path / "out.tum")]
    task = json.loads((tmp_path / "task.json").read_text())
    (name, camera), *_ = sequence.cameras.items()
    assert (task["camera"], task["rate_hz"], task["seed"]) == (name, 2.0, 3)
    assert task["camera_params"][:2] == [camera.matrix[0, 0], camera.matrix[1, 1]]
    assert len(task["camera_params"]) == 8
    assert task["mapper"] == "incremental"
    assert task["shift_ns"] == -30_000_000


def test_the_lens_is_that_of_the_camera(dive_file):
    """In its own image coordinates, in which the centre of the first pixel is at (0.5, 0.5)."""
    camera = replace(next(iter(oysterbench.open(dive_file).cameras.values())), distortion_model="plumb_bob")
    fx, fy, cx, cy = (camera.matrix[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    for given, model, used in (
        ([0.1, 0.2], "OPENCV", [0.1, 0.2, 0.0, 0.0]),
        ([0.1, 0.2, 0.01, 0.02, 0.0], "OPENCV", [0.1, 0.2, 0.01, 0.02]),
        ([0.1, 0.2, 0.01, 0.02, 0.3], "FULL_OPENCV", [0.1, 0.2, 0.01, 0.02, 0.3, 0.0, 0.0, 0.0]),
    ):
        found = lens_of(replace(camera, distortion=np.array(given)))
        assert found == (model, [fx, fy, cx + 0.5, cy + 0.5, *used])
    fisheye = replace(camera, distortion_model="equidistant", distortion=np.array([0.1, 0.2, 0.3, 0.4]))
    assert lens_of(fisheye) == ("OPENCV_FISHEYE", [fx, fy, cx + 0.5, cy + 0.5, 0.1, 0.2, 0.3, 0.4])
    with pytest.raises(MethodError, match="expected at most five coefficients"):
        lens_of(replace(camera, distortion=np.full(8, 0.1)))
