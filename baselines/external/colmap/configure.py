"""COLMAP reads the folder as it is: its options go to `reconstruct.py`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from oysterbench.methods.systems.launch import Launch

MODELS = {"plumb_bob": "OPENCV", "equidistant": "OPENCV_FISHEYE"}


def command(launch: Launch) -> list[str]:
    """Write options and camera as JSON; the command line of the script, under the interpreter that has pycolmap."""
    name, camera = next(iter(launch.cameras.items()))
    K = camera.matrix
    distortion = np.append(camera.distortion, np.zeros(4))[:4]
    task = {
        **launch.options,
        "camera": name,
        "camera_model": MODELS[camera.distortion_model],
        "camera_params": [float(value) for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *distortion)],
        "frame_rate_hz": camera.rate_hz,
        "seed": launch.number,
    }
    (launch.folder / "task.json").write_text(json.dumps(task, indent=1), encoding="utf-8")
    script = Path(__file__).with_name("reconstruct.py")
    words = [launch.build.parent / "venv" / "bin" / "python", script]
    return [str(word) for word in (*words, launch.folder / "task.json", launch.given, launch.out)]
