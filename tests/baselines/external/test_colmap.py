"""The adapter to COLMAP: its task, and, where it is built, what it reaches."""

from __future__ import annotations

import json

import oysterbench
from oysterbench.methods.systems.launch import Launch
from oysterbench.methods.systems.manifest import split_reference
from oysterbench_baselines.external.colmap.configure import command


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
