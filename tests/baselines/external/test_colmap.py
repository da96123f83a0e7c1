"""The adapter to COLMAP: its task, and, where it is built, what it reaches."""

from __future__ import annotations

import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems.launch import Launch
from oysterbench.methods.systems.manifest import split_reference
from oysterbench_baselines.external.colmap import configure
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


def test_pictures_are_neighbours_in_the_order_of_time_whatever_their_names(tmp_path, monkeypatch):
    """COLMAP pairs those that are close in the order of their names."""
    stamps = [700_000_000, 900_000_000, 1_100_000_000, 10_300_000_000]
    data = tmp_path / "mav0" / "cam0" / "data"
    data.mkdir(parents=True)
    for stamp in stamps:
        (data / f"{stamp}.png").write_text(str(stamp))
    rows = [f"{stamp},{stamp}.png" for stamp in stamps]
    (data.parent / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *rows]))
    task = dict.fromkeys(("seed", "max_num_features", "peak_threshold", "camera_model", "overlap"), 1)
    task |= {"frame_rate_hz": 5.0, "rate_hz": 5.0, "shift_ns": 5, "camera_params": [1.0], "mapper": "incremental"}
    (tmp_path / "task.json").write_text(json.dumps({**task, "init_min_tri_angle": 4.0}))
    pictures: dict[str, str] = {}

    def extract(database, folder, names, *_):
        pictures.update({name: (folder / name).read_text() for name in names})

    def mapping(database, folder, *_):
        place = MagicMock(translation=[0.0] * 3, rotation=SimpleNamespace(quat=[0.0, 0.0, 0.0, 1.0]))
        cam = MagicMock(**{"return_value.inverse.return_value": place})
        images = {k: SimpleNamespace(name=name, has_pose=True, cam_from_world=cam) for k, name in enumerate(pictures)}
        return {0: MagicMock(images=images)}

    library = MagicMock(extract_features=extract, incremental_mapping=mapping)
    monkeypatch.setitem(sys.modules, "pycolmap", library)
    script = runpy.run_path(str(Path(configure.__file__).with_name("reconstruct.py")))
    script["main"](str(tmp_path / "task.json"), str(tmp_path), str(tmp_path / "out.tum"))
    assert [pictures[name] for name in sorted(pictures)] == list(map(str, stamps))
    written = [line.split()[0] for line in (tmp_path / "out.tum").read_text().splitlines()]
    assert written == ["0.700000005", "0.900000005", "1.100000005", "10.300000005"]
