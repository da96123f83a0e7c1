"""The settings of ORB-SLAM3: the authors' own for EuRoC with the calibration of the sequence; and its vocabulary."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import invert
from oysterbench.core.helpers import module_command
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import Sequence
from oysterbench_baselines.external.common.yaml import opencv_matrix, replace_block, replace_values

SETTINGS, VOCABULARY = "settings.yaml", "vocabulary.txt"
EXAMPLES = {"mono": "Monocular", "mono_inertial": "Monocular-Inertial", "stereo_inertial": "Stereo-Inertial"}
COEFFICIENTS = {"plumb_bob": ("k1", "k2", "p1", "p2"), "equidistant": ("k1", "k2", "k3", "k4")}
EXTRACTOR = ("nFeatures", "scaleFactor", "nLevels", "iniThFAST", "minThFAST")
"""Options that are keys of the settings under `ORBextractor`."""

TAUGHT_ON = (("slam-mini", "mini-01"), ("slam-train", "train-02"))
"""Split and sequence of the pictures that the vocabulary is trained on: none of slam-val and slam-stress. Results on
slam-mini are with a vocabulary that knows its pictures."""

EVERY = 4
"""One picture in four: those between show the same."""


def command(launch: Launch) -> list[str]:
    """Write the settings; the command line."""
    first = next(iter(launch.cameras.values()))
    mode = next(mode for mode in sorted(EXAMPLES, key=len, reverse=True) if f"_{mode}" in launch.method)
    example = launch.source / "Examples" / EXAMPLES[mode] / "EuRoC.yaml"
    text = settings(example.read_text(encoding="utf-8"), launch.sequence, mode, launch.options)
    (launch.folder / SETTINGS).write_text(text, encoding="utf-8")
    words = launch.options["vocabulary"] or launch.build.parent / VOCABULARY
    shift_s = 0.0 - first.time_offset_s
    program = [launch.build / "orb_slam3", mode, launch.folder / SETTINGS, words]
    return [str(word) for word in (*program, launch.given, launch.out, shift_s, launch.number)]


def settings(authors: str, sequence: Sequence, mode: str, options: Mapping[str, Any]) -> str:
    """The authors' file for a mode with the calibration and the rates of a sequence, and the options."""
    cameras = list(sequence.cameras.values())[: 2 if mode.startswith("stereo") else 1]
    model = cameras[0].distortion_model
    if model not in COEFFICIENTS or any(camera.distortion_model != model for camera in cameras):
        raise MethodError(f"ORB-SLAM3: expected cameras of one model of {', '.join(COEFFICIENTS)}, got {model}")
    first, unit = cameras[0], sequence.imu_calibration
    values: dict[str, Any] = {"Camera.width": first.width, "Camera.height": first.height}
    values["Camera.fps"] = round(first.rate_hz)
    if "Camera.newWidth" in authors:  # the authors shrink EuRoC's; these stay as they are
        values |= {"Camera.newWidth": first.width, "Camera.newHeight": first.height}
    if model == "equidistant":
        authors = authors.replace(".p1:", ".k3:").replace(".p2:", ".k4:")
        values["Camera.type"] = "KannalaBrandt8"
    more = []
    for number, camera in enumerate(cameras, start=1):
        K = camera.matrix
        coefficients = np.append(camera.distortion, np.zeros(5))
        named = dict(zip(COEFFICIENTS[model], coefficients, strict=False))
        named |= {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        values |= {f"Camera{number}.{key}": float(value) for key, value in named.items()}
        if model == "plumb_bob" and coefficients[4]:
            more.append(f"Camera{number}.k3: {float(coefficients[4])!r}")
        if model == "equidistant" and len(cameras) > 1:  # what both see; points of the rest are matched in vain
            more += [f"Camera{number}.overlappingBegin: 0", f"Camera{number}.overlappingEnd: {camera.width - 1}"]
    if "inertial" in mode:
        values |= {
            "IMU.NoiseGyro": unit.gyro_noise_density,
            "IMU.NoiseAcc": unit.accel_noise_density,
            "IMU.GyroWalk": unit.gyro_random_walk,
            "IMU.AccWalk": unit.accel_random_walk,
            "IMU.Frequency": float(unit.rate_hz),
        }
        if options.get("fastInit"):
            more.append("IMU.fastInit: 1")
    values |= {f"ORBextractor.{key}": options[key] for key in EXTRACTOR if key in options}
    text = replace_values(authors, values)
    if "inertial" in mode:
        text = replace_block(text, "IMU.T_b_c1", opencv_matrix(invert(unit.T_base_imu) @ first.T_base_cam))
    if mode.startswith("stereo"):
        text = replace_block(text, "Stereo.T_c1_c2", opencv_matrix(invert(first.T_base_cam) @ cameras[1].T_base_cam))
    return text + "".join(f"\n{line}" for line in more) + "\n"


def prepare(place: Path, announce: Callable[[str], None]) -> None:
    """Train the vocabulary: the published one is a large file that mirrors of the source may lack. The same pictures
    give the same words."""
    with tempfile.TemporaryDirectory(dir=place) as scratch:
        pictures = []
        for split, name in TAUGHT_ON:
            announce(f"rendering {name} of {split}, on which the vocabulary is trained, where it is not here")
            files = json.loads(oysterbench("render", split, "--sequence", name, "--json"))["files"]
            folder = Path(scratch) / name
            oysterbench("export", files[name], "--format", "euroc", "--out", str(folder), "--no-truth")
            pictures += sorted((folder / "mav0" / "cam0" / "data").glob("*.png"))[::EVERY]
        announce(f"training the vocabulary on {len(pictures)} pictures")
        trainer = [str(place / "build" / "train_vocabulary"), str(place / VOCABULARY), "-"]
        listed = "\n".join(map(str, pictures))
        subprocess.run(trainer, input=listed, text=True, check=True, stdout=subprocess.DEVNULL)


def oysterbench(*words: str) -> str:
    """What a command of this project's prints. Raises MethodError with its last line where it fails."""
    done = subprocess.run(module_command("oysterbench", *words), capture_output=True, text=True, check=False)
    if done.returncode:
        raise MethodError(f"oysterbench {' '.join(words)}: {(done.stderr.splitlines() or ['failed'])[-1]}")
    return done.stdout
